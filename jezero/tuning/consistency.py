"""Consistency of the innovations of one sensor in several flights."""

from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
import numpy as np

from jezero.base.arrays import Array
from jezero.services.estimator.innovations import Innovation
from jezero.tuning.statistics import (
    ConsistentSetting,
    autocorrelation,
    chi2_band,
    consistent_setting,
    effective_count,
    significant_correlations,
)

COUNT_MIN = 30
"""A sensor with fewer innovations is not judged."""


class Consistency(msgspec.Struct, frozen=True, kw_only=True):
    """Innovations of one sensor against the spread that the filter predicts for them.

    Units are those of the measurement: m, m/s, rad or rad/s.

    Attributes:
        count: number of measurements.
        rejected: share of the measured values that the gate rejects; all else is from those that it accepts.
        mean: mean innovation of each component: ranges in the order of the anchors, north, east and down. None for a
            component of which all values are rejected, also below.
        std: standard deviation of each component.
        std_predicted: root of the mean variance that the filter predicts for each component.
        nis: mean normalised innovation squared, divided by the number of components; 1 is consistent. None when all are
            rejected.
        nis_band: the band in which `nis` lies with a probability of 95 % when the filter is consistent.
        autocorrelation: mean autocorrelation of the normalised innovations from one measurement to the next; 0 is
            white.
        effective_count: number of independent ones among all components of all measurements.
    """

    count: int
    rejected: float
    mean: tuple[float | None, ...]
    std: tuple[float | None, ...]
    std_predicted: tuple[float | None, ...]
    nis: float | None
    nis_band: tuple[float, float]
    autocorrelation: float
    effective_count: float


def judge(flights: Sequence[Sequence[Innovation]]) -> Consistency | None:
    """Judge the innovations of one sensor, by flight and time; None when there are too few."""
    innovations = [each for flight in flights for each in flight]
    if len(innovations) < COUNT_MIN:
        return None
    size = max(len(each.residual) for each in innovations)
    # The mean and the spread of a component, such as an anchor's range, are those of complete measurements.
    whole = [each for each in innovations if len(each.residual) == size]
    fits = np.array([each.accepted for each in whole])
    residual = np.ma.array([each.residual for each in whole], mask=~fits)
    variance = np.ma.array([each.cov.diagonal() for each in whole], mask=~fits)
    accepted = np.concatenate([each.accepted for each in innovations])
    squares = [_normalised_square(each) for each in innovations if each.accepted.any()]
    components = list(_components(flights))
    independent = sum(effective_count(len(z), significant_correlations(z)) for z in components)
    return Consistency(
        count=len(innovations),
        rejected=1.0 - float(accepted.mean()),
        mean=_numbers(residual.mean(axis=0)),
        std=_numbers(residual.std(axis=0)),
        std_predicted=_numbers(np.ma.sqrt(variance.mean(axis=0))),
        nis=sum(square for square, _ in squares) / sum(dof for _, dof in squares) if squares else None,
        nis_band=chi2_band(independent),
        autocorrelation=float(
            np.average([autocorrelation(z) for z in components], weights=[len(z) for z in components])
        ),
        effective_count=independent,
    )


def fit_setting(flights: Sequence[Sequence[Innovation]], effective: float) -> ConsistentSetting | None:
    """The noise setting that makes the innovations of one sensor consistent; None when no setting scales its noise.

    Args:
        flights: innovations by flight and time.
        effective: number of independent ones among all components of all measurements.
    """
    scaled = [each for flight in flights for each in flight if each.setting is not None]
    if not scaled:
        return None
    noise = np.concatenate([each.cov_noise.diagonal() for each in scaled])
    settings = np.concatenate([np.full(len(each.residual), each.setting) for each in scaled])
    return consistent_setting(
        np.concatenate([each.residual for each in scaled]),
        np.concatenate([each.cov.diagonal() for each in scaled]) - noise,
        noise / settings**2,
        float(np.median(settings)),
        effective,
    )


def setting_in_use(flights: Sequence[Sequence[Innovation]]) -> float | None:
    """Median of the setting that the filter used."""
    settings = [each.setting for flight in flights for each in flight if each.setting is not None]
    return float(np.median(settings)) if settings else None


def _normalised_square(innovation: Innovation) -> tuple[float, int]:
    """Normalised innovation squared of the accepted components, and their number."""
    fits = innovation.accepted
    residual = innovation.residual[fits]
    return float(residual @ np.linalg.solve(innovation.cov[np.ix_(fits, fits)], residual)), len(residual)


def _components(flights: Sequence[Sequence[Innovation]]) -> Iterator[Array]:
    """Normalised innovations of each component of each flight, of complete measurements, rejected ones too."""
    size = max(len(each.residual) for flight in flights for each in flight)
    for flight in flights:
        rows = [each.residual / np.sqrt(each.cov.diagonal()) for each in flight if len(each.residual) == size]
        if len(rows) > 2:
            yield from (column for column in np.array(rows).T if column.any())


def _numbers(values: Any) -> tuple[float | None, ...]:
    """The values of a masked array, None where it is masked."""
    return tuple(np.ma.atleast_1d(values).tolist())
