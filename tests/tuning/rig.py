"""Innovations made by hand."""

from collections.abc import Sequence

import numpy as np

from jezero.services.estimator.innovations import Innovation, Sensor

PERIOD_NS = 40_000_000


def an_innovation(
    index: int,
    residual: Sequence[float],
    *,
    sensor: Sensor = "altimeter",
    std_state: float = 0.03,
    std_noise: float = 0.04,
    accepted: Sequence[bool] = (),
    setting: float | None = 0.04,
) -> Innovation:
    """An innovation with independent components of equal predicted spread."""
    size = len(residual)
    noise = std_noise**2 * np.eye(size)
    return Innovation(
        sensor=sensor,
        t_ns=index * PERIOD_NS,
        residual=np.array(residual),
        cov=std_state**2 * np.eye(size) + noise,
        cov_noise=noise,
        accepted=np.array(accepted or [True] * size),
        setting=setting,
    )
