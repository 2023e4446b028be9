"""Errors of a replayed estimate against the truth, beside those of the recorded one."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np

from jezero.base.arrays import Array
from jezero.base.codec import BadPayloadError, decode
from jezero.base.frames import subtract
from jezero.recording import Recording
from jezero.schemas.estimate import Relative
from jezero.schemas.state import Truth
from jezero.schemas.topics import RELATIVE, TRUTH


class Errors(msgspec.Struct, frozen=True):
    """Errors of the relative position, vehicle minus rover.

    Attributes:
        rms_m: (3,) root of the mean square error to north, east and down.
        rms_3d_m: root of the mean square distance from the truth.
        compared: number of estimates of which these are the errors.
        valid: number of valid estimates.
        estimates: number of all estimates.
    """

    rms_m: tuple[float, float, float]
    rms_3d_m: float
    compared: int
    valid: int
    estimates: int


def relative_errors(
    before: Iterable[tuple[str, bytes]], after: Iterable[tuple[str, bytes]], files: Sequence[Path]
) -> tuple[Errors, Errors] | None:
    """Errors of what an estimator published, and of what it publishes in a replay, at the same times.

    Args:
        before: topic and encoded message of all that it published.
        after: the same of the replay.
        files: recordings with the truth.

    Returns:
        Errors of those estimates that are valid in both; None if there are none, or no truth, as in recordings of real
        vehicles.

    Raises:
        RecordingError: a recording can't be read.
    """
    truth_ns, truth_m = true_relative(files)
    if not len(truth_ns):
        return None
    both = [_estimates(published) for published in (before, after)]
    inside = [
        {each.t_ns: each for each in estimates if each.valid and truth_ns[0] <= each.t_ns <= truth_ns[-1]}
        for estimates in both
    ]
    common_ns = sorted(inside[0].keys() & inside[1].keys())
    if not common_ns:
        return None
    true_m = np.column_stack([np.interp(np.array(common_ns, float), truth_ns, axis) for axis in truth_m.T])
    return (_errors(both[0], inside[0], common_ns, true_m), _errors(both[1], inside[1], common_ns, true_m))


def has_valid_estimates(published: Iterable[tuple[str, bytes]]) -> bool:
    """Whether an estimator published an estimate that may be used for flying."""
    return any(each.valid for each in _estimates(published))


def _estimates(published: Iterable[tuple[str, bytes]]) -> list[Relative]:
    """The estimates without those that their readers reject, as those of an estimator of one's own may be."""
    estimates = []
    for topic, message in published:
        if topic == RELATIVE.name:
            with suppress(BadPayloadError):
                estimates.append(decode(Relative, message))
    return estimates


def _errors(
    estimates: Sequence[Relative], valid: Mapping[int, Relative], times_ns: Sequence[int], true_m: Array
) -> Errors:
    """Errors at some times from the true positions of these times."""
    square_m2 = (np.array([valid[t_ns].pos_uav_rel_rover_ned_m for t_ns in times_ns]) - true_m) ** 2
    north_m, east_m, down_m = np.sqrt(square_m2.mean(axis=0)).tolist()
    rms_3d_m = float(np.sqrt(square_m2.sum(axis=1).mean()))
    return Errors((north_m, east_m, down_m), rms_3d_m, len(times_ns), len(valid), len(estimates))


def true_relative(files: Sequence[Path]) -> tuple[Array, Array]:
    """(n,) vehicle times in ns and (n, 3) true positions, vehicle minus platform, NED; both empty without truth."""
    truths: list[Truth] = [entry.message for file in files for entry in Recording(file).messages(TRUTH)]
    offsets_m = [subtract(truth.pos_uav_ned_m, truth.pos_rover_ned_m) for truth in truths]
    return np.array([truth.t_ns for truth in truths], float), np.array(offsets_m, float).reshape(-1, 3)
