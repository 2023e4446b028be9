"""Replays of recorded flights through the estimator, with the innovations of its filter."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jezero.recording.journals import files_with_start
from jezero.recording.mcap_file import RecordingError
from jezero.replay.rebuild import OwnClassError
from jezero.replay.through import Replay, replay_through
from jezero.runtime.journal import class_of
from jezero.runtime.service import Service
from jezero.services.estimator.innovations import Innovation, Sensor
from jezero.tuning.sensors import SENSORS

UNSETTLED = 25.0
"""Innovations are left out where the predicted variance of the state's part exceeds its median by this factor, as after
the start of the filter: they show an error of the state that the sensor has not corrected yet."""


@dataclass(frozen=True)
class ObservedFlight:
    """One recorded flight, replayed.

    Attributes:
        replay: the replay.
        innovations: those of each sensor, in the order of their times, without those before the filter has settled.
    """

    replay: Replay
    innovations: dict[Sensor, list[Innovation]]


def runs_of_files(paths: Iterable[Path], left_out: dict[Path, str]) -> list[Path]:
    """The recordings without those that continue one another or are the same: one path for each run of the estimator.

    Args:
        left_out: gets each recording that can't be read, or has no journal of the estimator, with the reason.
    """
    files: dict[Path, frozenset[Path]] = {}
    for path in paths:
        try:
            files[path] = frozenset(each.resolve() for each in files_with_start(path, "estimator"))
        except RecordingError as error:
            left_out[path] = str(error)
    kept: dict[frozenset[Path], Path] = {}
    for path, own in files.items():
        if not any(own < other for other in files.values()):
            kept.setdefault(own, path)
    return list(kept.values())


def observe(path: Path, changes: Mapping[str, str], own: type[Service] | None = None) -> ObservedFlight:
    """Replay a flight through the estimator and collect the innovations.

    Args:
        path: the recording.
        changes: settings other than recorded, as TOML by name.
        own: class of an estimator of one's own; None: jezero's.

    Raises:
        RecordingError: the recording can't be read, or has no journal of the estimator from its start.
        SettingError: a setting is wrong.
        OwnClassError: `own` can't be replayed, or gives no innovations.
    """
    runs: list[dict[tuple[Sensor, int], Innovation]] = []

    def keep(innovation: Innovation) -> None:
        runs[-1][innovation.sensor, innovation.t_ns] = innovation

    def watch(service: Service) -> None:
        give = getattr(service, "observe_innovations", None)
        if give is None:
            raise OwnClassError(
                f"{class_of(service)} can't be tuned: it has no method observe_innovations(observer), which gives "
                "observer the innovations of its filter (jezero.services.estimator.innovations)"
            )
        runs.append({})
        give(keep)

    replay = replay_through(path, "estimator", changes, own, watch)
    by_sensor: dict[Sensor, list[Innovation]] = {sensor: [] for sensor in SENSORS}
    for found in runs:
        for innovation in sorted(found.values(), key=lambda each: each.t_ns):
            by_sensor[innovation.sensor].append(innovation)
    return ObservedFlight(replay, {sensor: settled(series) for sensor, series in by_sensor.items()})


def settled(innovations: Sequence[Innovation]) -> list[Innovation]:
    """Innovations of one sensor without those before the filter has settled."""
    if not innovations:
        return []
    var_state = np.array([(each.cov - each.cov_noise).trace() / len(each.residual) for each in innovations])
    certain = var_state <= UNSETTLED * np.median(var_state)
    return [each for each, keep in zip(innovations, certain, strict=True) if keep]
