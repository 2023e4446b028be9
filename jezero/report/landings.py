"""The landings of a flight's log: estimates, measurements and truth as arrays over time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import nan, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.base.config import load_config
from jezero.base.frames import Vec3, add, quat_from_euler, quat_rotate, rotate_yaw, subtract
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording import Entry
from jezero.schemas import topics
from jezero.schemas.estimate import Relative
from jezero.schemas.goals import LandFeedback
from jezero.schemas.rows import Topic
from jezero.schemas.sensors import RoverOdometry, Uwb
from jezero.schemas.state import Odometry, StatusCode, Truth
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.trilateration import trilaterate

VARIANCES = (0, 6, 11)
"""Indices of the position's variances in the upper triangle of a 6 x 6 covariance."""
AFTER_NS = 1_000_000_000
"""Time after the disarm that the figures include."""
ESTIMATE_AGE_MAX_NS = 1_000_000_000
"""A position that is older than this at disarm is not the touchdown."""


@dataclass(frozen=True)
class Series:
    """Values over time.

    Attributes:
        t_s: (n,) times from the start of the landing.
        values: (n, k) values.
    """

    t_s: Array
    values: Array

    def __len__(self) -> int:
        return len(self.t_s)

    def at(self, t_s: Array) -> Array:
        """(m, k) values at given times: linear between the samples, constant before the first and after the last."""
        return np.column_stack([np.interp(t_s, self.t_s, column) for column in self.values.T])

    def where(self, keep: npt.NDArray[np.bool_]) -> "Series":
        """The samples for which `keep` is true."""
        return Series(self.t_s[keep], self.values[keep])

    def upwards(self) -> "Series":
        """The same with north, east and up in its first three columns instead of north, east and down."""
        values = self.values.copy()
        values[:, 2] *= -1.0
        return Series(self.t_s, values)


@dataclass(frozen=True)
class RecordedLanding:
    """One landing. All positions are in m, NED; relative ones are vehicle minus rover.

    Attributes:
        start_ns: vehicle time of the start, at which all other times are 0.
        end_s: end of the landing, or of the log if that ends earlier.
        disarmed_s: time of the disarm; None if the landing did not end on the ground.
        phases: (name, start, end) in s, consecutive.
        relative: (n, 3) estimated relative position.
        std: (n, 3) standard deviations of that estimate.
        valid: (n,) whether that estimate was valid.
        rover: (n, 4) estimated rover position in the vehicle's world frame, and whether it was valid.
        std_rover: (n,) largest standard deviation of that position on any axis.
        uwb: (n, 3) relative position from each round of UWB ranges alone.
        tag: (n, 3) relative position from the tags of each image alone.
        uav: (n, 3) the autopilot's position, in its own world frame.
        std_uav: (n,) standard deviation of its horizontal position; NaN where it is unknown.
        true_relative: (n, 3) true relative position; like the other true values, empty in a recording without truth.
        true_rover: (n, 3) true position of the rover, in the simulator's frame.
        true_uav: (n, 3) true position of the vehicle, in the simulator's frame.
        path_rover_body_m: (n, 3) path to the touchdown: forward, right and down from the platform's centre. The true
            one; in a recording without truth, that of the valid estimates.
        touchdown_rover_body_m: (2,) position on this path at disarm; None if the landing did not end on the ground.
        std_touchdown_m: standard deviation of an estimated touchdown, the larger one of both axes; None for a true one.
    """

    start_ns: int
    end_s: float
    disarmed_s: float | None
    phases: tuple[tuple[str, float, float], ...]
    relative: Series
    std: Array
    valid: npt.NDArray[np.bool_]
    rover: Series
    std_rover: Array
    uwb: Series
    tag: Series
    uav: Series
    std_uav: Array
    true_relative: Series
    true_rover: Series
    true_uav: Series
    path_rover_body_m: Array
    touchdown_rover_body_m: tuple[float, float] | None
    std_touchdown_m: float | None

    @property
    def has_truth(self) -> bool:
        """Whether the recording has the truth, as only a simulator publishes it."""
        return len(self.true_relative) > 1

    @property
    def by_estimate(self) -> bool:
        """Whether it was a landing on the rover; else it was one on a spot, without an estimate."""
        return bool(self.valid.any())


def landings(entries: Sequence[Entry]) -> list[RecordedLanding]:
    """All landings of a log in their order, also those that were aborted in the air."""
    by_topic: dict[str, list[Any]] = {}
    for entry in entries:
        by_topic.setdefault(entry.topic, []).append(entry.message)
    return [_landing(by_topic, start_ns, end_ns) for start_ns, end_ns in _spans(by_topic)]


def _spans(by_topic: dict[str, list[Any]]) -> Iterator[tuple[int, int]]:
    """(start, end) in vehicle time of each period in status 8 or 9."""
    start_ns: int | None = None
    for status in by_topic.get(topics.STATUS.name, ()):
        lands = status.code in (StatusCode.LANDING, StatusCode.LANDING_DONE)
        if lands and start_ns is None:
            start_ns = status.t_ns
        elif not lands and start_ns is not None:
            yield start_ns, status.t_ns
            start_ns = None
    if start_ns is not None:
        yield start_ns, by_topic[topics.STATUS.name][-1].t_ns


def _landing(by_topic: dict[str, list[Any]], start_ns: int, end_ns: int) -> RecordedLanding:
    def within(topic: Topic[Any], after_ns: int = 0) -> list[Any]:
        return [m for m in by_topic.get(topic.name, ()) if start_ns <= m.t_ns <= end_ns + after_ns]

    def series(messages: list[Any], values: Sequence[Sequence[float]], size: int = 3) -> Series:
        t_s = np.array([(m.t_ns - start_ns) / NS_PER_S for m in messages], dtype=float)
        return Series(t_s, np.array(values, dtype=float).reshape(len(messages), size))

    disarmed_ns = next((m.t_ns for m in within(topics.STATUS, AFTER_NS) if not m.armed and m.landed), None)
    relative = within(topics.RELATIVE)
    rover = within(topics.ROVER_ESTIMATE)
    tag = within(topics.ESTIMATE_TAG)
    odometry = within(topics.ODOMETRY, AFTER_NS)
    truth = within(topics.TRUTH)
    vehicle = load_config(VehicleConfig, "vehicle")
    standing_m = (0.0, 0.0, vehicle.airframe.height_stand_m)
    uwb = list(_uwb_positions(within(topics.UWB), within(topics.ROVER_ODOMETRY), odometry, vehicle))
    path, touchdown_m, std_touchdown_m = _touchdown(relative, truth, disarmed_ns)
    return RecordedLanding(
        start_ns=start_ns,
        end_s=((disarmed_ns or end_ns) - start_ns) / NS_PER_S,
        disarmed_s=None if disarmed_ns is None else (disarmed_ns - start_ns) / NS_PER_S,
        phases=_phases(within(topics.feedback_of(topics.LAND_ON_SPOT)), start_ns, disarmed_ns or end_ns),
        relative=series(relative, [m.pos_uav_rel_rover_ned_m for m in relative]),
        std=np.array([_std_m(m) for m in relative]).reshape(-1, 3),
        valid=np.array([m.valid and bool(m.goal_id) for m in relative], dtype=bool),
        rover=series(rover, [(*m.pos_rover_ned_m, float(m.valid)) for m in rover], 4),
        std_rover=np.array([m.std_pos_m for m in rover], dtype=float),
        uwb=series([m for m, _ in uwb], [place_m for _, place_m in uwb]),
        tag=series(tag, [add(m.pos_uav_rel_rover_ned_m, standing_m) for m in tag]),
        uav=series(odometry, [m.pos_uav_ned_m for m in odometry]),
        std_uav=np.array([nan if m.std_pos_m is None else m.std_pos_m for m in odometry], dtype=float),
        true_relative=series(truth, [subtract(m.pos_uav_ned_m, m.pos_rover_ned_m) for m in truth]),
        true_rover=series(truth, [m.pos_rover_ned_m for m in truth]),
        true_uav=series(truth, [m.pos_uav_ned_m for m in truth]),
        path_rover_body_m=path,
        touchdown_rover_body_m=touchdown_m,
        std_touchdown_m=std_touchdown_m,
    )


def _std_m(relative: Relative) -> list[float]:
    return [sqrt(max(relative.cov[i], 0.0)) for i in VARIANCES]


def _touchdown(
    relative: Sequence[Relative], truth: Sequence[Truth], disarmed_ns: int | None
) -> tuple[Array, tuple[float, float] | None, float | None]:
    """Path over the platform, its point at disarm, and the standard deviation of that point if it is an estimate."""
    estimates = [m for m in relative if m.valid and (disarmed_ns is None or m.t_ns <= disarmed_ns)]
    if truth:
        times_ns = [m.t_ns for m in truth]
        path = [rotate_yaw(subtract(m.pos_uav_ned_m, m.pos_rover_ned_m), -m.yaw_rover_rad) for m in truth]
    else:
        times_ns = [m.t_ns for m in estimates]
        path = [rotate_yaw(m.pos_uav_rel_rover_ned_m, -m.yaw_rover_rad) for m in estimates]
    path_m = np.array(path, dtype=float).reshape(-1, 3)
    if disarmed_ns is None or not path:
        return path_m, None, None
    nearest = min(range(len(path)), key=lambda i: abs(times_ns[i] - disarmed_ns))
    if abs(times_ns[nearest] - disarmed_ns) > ESTIMATE_AGE_MAX_NS:
        return path_m, None, None
    return path_m, path[nearest][:2], None if truth else max(_std_m(estimates[nearest])[:2])


def _phases(feedback: Sequence[Any], start_ns: int, end_ns: int) -> tuple[tuple[str, float, float], ...]:
    """Phases of the landing; consecutive ones of the same name are joined, the last one lasts to the end."""
    changes: list[tuple[str, int]] = []
    for message in feedback:
        content = message.feedback
        if isinstance(content, LandFeedback) and (not changes or changes[-1][0] != content.phase):
            changes.append((content.phase, message.t_ns if changes else start_ns))
    ends_ns = [*(t_ns for _, t_ns in changes), end_ns][1:] if changes else []
    return tuple(
        (name, (t_ns - start_ns) / NS_PER_S, (end_ns - start_ns) / NS_PER_S)
        for (name, t_ns), end_ns in zip(changes, ends_ns, strict=True)
    )


def _uwb_positions(
    rounds: Sequence[Uwb], rover: Sequence[RoverOdometry], odometry: Sequence[Odometry], vehicle: VehicleConfig
) -> Iterator[tuple[Uwb, Vec3]]:
    """Relative position from each round of ranges alone. Source: thesis eqs. 4.11–4.13.

    The rover's attitude is that of its compass and IMU, the vehicle's the autopilot's.
    """
    rover_ns, odometry_ns = [m.t_ns for m in rover], [m.t_ns for m in odometry]
    for uwb in rounds:
        fix = trilaterate([r.pos_anchor_rover_body_m for r in uwb.ranges], [r.range_m for r in uwb.ranges])
        if fix is None or not rover or not odometry:
            continue
        known = rover[min(int(np.searchsorted(rover_ns, uwb.t_ns)), len(rover) - 1)]
        q_ned_from_rover_body = quat_from_euler(known.roll_rover_rad, known.pitch_rover_rad, known.yaw_rover_rad)
        nearest = odometry[min(int(np.searchsorted(odometry_ns, uwb.t_ns)), len(odometry) - 1)]
        mount_ned_m = quat_rotate(nearest.q_ned_from_frd, vehicle.uwb.pos_tag_frd_m)
        center_ned_m = subtract(quat_rotate(q_ned_from_rover_body, fix[0]), mount_ned_m)
        yield uwb, add(center_ned_m, (0.0, 0.0, vehicle.airframe.height_stand_m))
