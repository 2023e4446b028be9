"""Filter of the relative position: initialization, delayed measurements, and reset after lasting rejection."""

from collections import deque
from collections.abc import Iterator, Sequence
from math import inf, isfinite, sqrt
from typing import ClassVar

import msgspec
import numpy as np

from jezero.base.arrays import Array
from jezero.base.vehicle_config import PlatformConfig
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.config import Tuning, ValidityConfig
from jezero.services.estimator.consistency import ConsistencyMonitor
from jezero.services.estimator.deck import DeckMonitor
from jezero.services.estimator.innovations import Observer
from jezero.services.estimator.kalman import FilterState, Kalman, UpdateResult
from jezero.services.estimator.measurement_history import ACCEPTED_FRACTION_MIN, MeasurementHistory
from jezero.services.estimator.measurements import (
    INPUT_KINDS,
    AltimeterMeasurement,
    Kind,
    Measurement,
    OdometryMeasurement,
    RoverOdometryMeasurement,
    TagMeasurement,
    UwbMeasurement,
    can_linearize_ranges,
)
from jezero.services.estimator.motion import (
    CLIMB_ROVER,
    POS_ROVER,
    POS_UAV,
    SIZE,
    STD_UNKNOWN_M,
    UWB_BIAS,
    VEL_ERROR,
    VEL_ROVER,
    VEL_UAV,
    YAW,
    YAW_RATE,
    MotionModel,
    heave_acc_mps2,
    initial_state,
)
from jezero.services.estimator.uwb_initialization import UwbWindow

FOUND_STD_MAX_M = 0.1 * STD_UNKNOWN_M
YAW_STD_MAX_RAD = 0.3
STD_TAG_RESET_M = 0.5
STD_HEADING_RESET_RAD = 0.1
MONITORED_KINDS: tuple[Kind, ...] = ("rover", "uwb", "tag")
REJECTION_WINDOW_S = 0.5
REJECTED_MEASUREMENTS_MIN = 5
"""Fewer measurements in the window are not enough to decide that an input is rejected."""
ODOMETRY_KEPT = 32
"""Number of the autopilot's last positions that are kept: more than half a second of them."""
INPUT_CONFLICT_NS = 3 * NS_PER_S
"""Two inputs contradict each other when the filter was reset to both within this time."""


def _relative() -> Array:
    T = np.zeros((6, SIZE))
    T[0:3, POS_UAV] = T[3:6, VEL_UAV] = np.eye(3)
    T[0:3, POS_ROVER] = T[3:6, VEL_ROVER] = -np.eye(3)
    return T


RELATIVE_T = _relative()
NO_ERROR = np.zeros((3, SIZE))


class FilterEstimate(msgspec.Struct, frozen=True, gc=False):
    """Estimate of the vehicle relative to the rover; fields as in `schemas.estimate.Relative`.

    Attributes:
        acc_down_rover_mps2: vertical acceleration of a platform that heaves, positive down; 0 for a still one.
        vel_rover_mps: (3,) with the error of the autopilot's velocity added, as in the autopilot's odometry.
    """

    t_ns: int
    pos_rel_m: Array
    vel_rel_mps: Array
    cov: Array
    vel_rover_mps: Array
    acc_down_rover_mps2: float
    yaw_rover_rad: float
    yaw_rate_rover_rps: float


class RelativeFilter:
    """Initializes the filter, fuses measurements in order, and resets it to an input that it keeps rejecting.

    Args:
        deck_moves: whether the platform heaves all the time, see `EstimatorConfig`.

    Attributes:
        consistency: what contradicts what, and which input is left out for it.
        deck: whether the platform heaves and tilts, and how much.
    """

    def __init__(
        self, tuning: Tuning, validity: ValidityConfig, platform: PlatformConfig, *, deck_moves: bool = False
    ) -> None:
        self._tuning, self._validity = tuning, validity
        self._heaves = deck_moves
        self._kalman = Kalman(MotionModel(tuning, heaves=deck_moves))
        self._history: MeasurementHistory | None = None
        self._window = UwbWindow(platform)
        self.consistency = ConsistencyMonitor(platform.height_m)
        self.deck = DeckMonitor(always=deck_moves)
        self._downs_m: deque[tuple[int, float]] = deque(maxlen=ODOMETRY_KEPT)
        """Times and heights of the vehicle by the autopilot, positive down."""
        self._prior: tuple[Array, float] | None = None
        self._reset_at_ns: dict[Kind, int] = {}
        self._rejected_inputs: tuple[Kind, ...] = ()

    def set_tuning(self, tuning: Tuning) -> None:
        """Change the noise settings; the state stays."""
        self._tuning = tuning
        self._kalman.set_motion_model(MotionModel(tuning, heaves=self._heaves))

    def observe_innovations(self, observer: Observer) -> None:
        """Call `observer` with each innovation from now on."""
        self._kalman.observer = observer

    def restart(self, prior: tuple[Array, float] | None = None) -> None:
        """Reset the filter.

        Args:
            prior: position of the rover (3,) in the frame of `OdometryMeasurement`, and its standard deviation; None
                when unknown.
        """
        self._history = None
        self._window.clear()
        self.consistency.restart()
        self._reset_at_ns.clear()
        self._rejected_inputs = ()
        self._prior = prior

    def add(self, measurements: Sequence[Measurement]) -> None:
        """Fuse new measurements, in any order."""
        if self._history is None and not self._start(measurements):
            return
        assert self._history is not None
        history = self._history
        measurements = self._without_left_out(measurements)
        rounds = [m for m in measurements if type(m) is UwbMeasurement]
        for uwb in rounds:
            self._window.add(uwb)
        self._watch_deck(history, measurements)
        history.add([*measurements, *self._initial_tag_reset(measurements)])
        if rounds:
            self._reset_by_uwb(history)
        self._check_consistency(history, measurements)
        if any(measurement.kind in MONITORED_KINDS for measurement in measurements):
            self._reset_to_rejected_input(history)
        if not isfinite(history.kalman.x.sum() + history.kalman.P.sum()):
            self.restart(self._prior)

    def _watch_deck(self, history: MeasurementHistory, measurements: Sequence[Measurement]) -> None:
        """Follow the platform's height by the tags, and change the motion model when the deck begins to move."""
        deck, kalman = self.deck, history.kalman
        for measurement in measurements:
            if isinstance(measurement, OdometryMeasurement):
                self._downs_m.append((measurement.t_ns, float(measurement.pos_vel[2])))
            elif isinstance(measurement, TagMeasurement):
                std_m = sqrt(float(measurement.measurement_cov_m2()[2, 2]))
                self._add_height(measurement.t_ns, float(measurement.pos_rel_m[2]), std_m)
        if deck.moves:
            std_mps = sqrt(max(float(kalman.P[CLIMB_ROVER, CLIMB_ROVER]), 0.0))
            deck.add_motion(kalman.t_ns, float(kalman.x[CLIMB_ROVER]), std_mps)
        if deck.moves != self._heaves:
            self._heaves = deck.moves
            self.set_tuning(self._tuning)
            if self._heaves:
                history.add([HeaveBegin(kalman.t_ns)])

    def _add_height(self, t_ns: int, down_rel_m: float, std_m: float) -> None:
        """Add the height of the vehicle relative to the platform, positive down, at a time of the last half second."""
        if self._downs_m:
            down_m = min(self._downs_m, key=lambda sample: abs(sample[0] - t_ns))[1]
            self.deck.add_height(t_ns, down_m - down_rel_m, std_m)

    # -- estimate ------------------------------------------------------------------------------------------

    @property
    def estimate(self) -> FilterEstimate | None:
        """Newest estimate; None before the first odometry."""
        if self._history is None:
            return None
        kalman = self._history.kalman
        x = kalman.x
        relative = RELATIVE_T @ x
        return FilterEstimate(
            t_ns=kalman.t_ns,
            pos_rel_m=relative[0:3],
            vel_rel_mps=relative[3:6],
            cov=RELATIVE_T @ kalman.P @ RELATIVE_T.T,
            vel_rover_mps=x[VEL_ROVER] + x[VEL_ERROR],
            acc_down_rover_mps2=heave_acc_mps2(x) if self._heaves else 0.0,
            yaw_rover_rad=float(x[YAW]),
            yaw_rate_rover_rps=float(x[YAW_RATE]),
        )

    @property
    def std_pos_m(self) -> float:
        """Standard deviation of the relative position's worst axis; infinite before initialization."""
        return inf if self._history is None else self._history.kalman.std_pos_rel_m

    @property
    def located(self) -> bool:
        """Whether the rover's position is known at least roughly."""
        return self.std_pos_m < FOUND_STD_MAX_M

    @property
    def inputs(self) -> tuple[Kind, ...]:
        """Kinds of measurements fused in the last second."""
        if self._history is None:
            return ()
        since_ns, used_ns = self._kalman.t_ns - NS_PER_S, self._history.used_ns
        return tuple(kind for kind in INPUT_KINDS if kind in used_ns and used_ns[kind] > since_ns)

    @property
    def fused_ns(self) -> int:
        """Time of the newest fused UWB or tag measurement, 0 before the first."""
        used_ns = {} if self._history is None else self._history.used_ns
        return max(used_ns.get("uwb", 0), used_ns.get("tag", 0))

    @property
    def rejected_inputs(self) -> tuple[Kind, ...]:
        """Inputs of which nearly all measurements of the last half second failed the gate."""
        return self._rejected_inputs

    @property
    def has_input_conflict(self) -> bool:
        """Whether the filter was recently reset to UWB and to the tag, so that the two contradict each other."""
        times = list(self._reset_at_ns.values())
        now_ns = 0 if self._history is None else self._history.kalman.t_ns
        return len(times) == 2 and all(now_ns - t_ns < INPUT_CONFLICT_NS for t_ns in times)

    # -- contradictions ------------------------------------------------------------------------------------

    def _check_consistency(self, history: MeasurementHistory, measurements: Sequence[Measurement]) -> None:
        monitor, kalman = self.consistency, history.kalman
        monitor.follow_motion(measurements, kalman)
        if not self.located:
            return
        left_out = monitor.tag_left_out, monitor.speed_left_out
        error_rad = monitor.check_motion(measurements, kalman, self._window)
        if error_rad is not None:
            history.add([HeadingReset(kalman.t_ns, -error_rad, STD_HEADING_RESET_RAD)])
            self._reset_by_uwb(history, force=True)
        newly_left_out = left_out != (monitor.tag_left_out, monitor.speed_left_out)
        if newly_left_out or (monitor.uwb_left_out and "uwb" in self.inputs):
            self.restart(self._prior)
            return
        for measurement in measurements:
            if isinstance(measurement, AltimeterMeasurement):
                monitor.check_height(measurement, kalman)
            elif isinstance(measurement, TagMeasurement):
                error_rad = monitor.heading_error_rad(measurement, kalman)
                if error_rad is not None:
                    history.add([HeadingReset(kalman.t_ns, -error_rad, STD_HEADING_RESET_RAD)])
                    self._reset_to_tag(history, measurement)

    def _without_left_out(self, measurements: Sequence[Measurement]) -> Sequence[Measurement]:
        """The measurements that may be used."""
        monitor = self.consistency
        return measurements if not monitor.left_out else [used for m in measurements for used in _admitted(monitor, m)]

    def _judge_uwb(self, history: MeasurementHistory, since_ns: int) -> None:
        """Leave out the part of UWB that contradicts the tag, and start again without it."""
        recent = [entry.measurement for entry in history.entries if entry.measurement.t_ns >= since_ns]
        rounds = [m for m in recent if isinstance(m, UwbMeasurement)]
        tags = [m for m in recent if isinstance(m, TagMeasurement)]
        pairs = [(tag, min(rounds, key=lambda uwb: abs(uwb.t_ns - tag.t_ns))) for tag in tags] if rounds else []
        self.consistency.judge_uwb(pairs, float(history.kalman.x[YAW]))
        self.restart(self._prior)

    def _reset_to_tag(self, history: MeasurementHistory, tag: TagMeasurement) -> None:
        cov_m2 = STD_TAG_RESET_M**2 * np.eye(3)
        history.add([PositionReset(history.kalman.t_ns, tag.pos_rel_m, cov_m2, tag.error_jacobian())])

    # -- finding the rover ---------------------------------------------------------------------------------

    def _start(self, measurements: Sequence[Measurement]) -> bool:
        """Initialize the state at the first odometry; False while there is none."""
        first = next((m for m in measurements if isinstance(m, OdometryMeasurement)), None)
        if first is None:
            return False
        x, P = initial_state(first.pos_vel[0:3], self._tuning)
        self._history = MeasurementHistory(self._kalman, FilterState(first.t_ns, x, P), self._validity.gate)
        if self._prior is not None:
            pos_rover_m, std_m = self._prior
            self._history.add(
                [PositionReset(first.t_ns, first.pos_vel[0:3] - pos_rover_m, std_m**2 * np.eye(3), NO_ERROR)]
            )
        return True

    def _initial_tag_reset(self, measurements: Sequence[Measurement]) -> list[Measurement]:
        """Position reset by the first tag measurement, while the rover's position is unknown."""
        tag = next((m for m in measurements if type(m) is TagMeasurement), None)
        if tag is None or self.located:
            return []
        return [PositionReset(tag.t_ns, tag.pos_rel_m, tag.measurement_cov_m2(), tag.error_jacobian())]

    def _reset_by_uwb(
        self, history: MeasurementHistory, *, force: bool = False, std_bias_m: float | None = None
    ) -> bool:
        """Reset the position by trilateration when the ranges cannot be linearised; always when `force`.

        Args:
            std_bias_m: of the error that all ranges share, which is forgotten; None to keep it. Ranges that the filter
                rejects may have another error than before: if it were kept, ranges that are right again would count as
                wrong.
        """
        kalman = history.kalman
        if not force and can_linearize_ranges(kalman):
            return False
        if float(kalman.P[YAW, YAW]) > YAW_STD_MAX_RAD**2:
            return False
        vel_rel_mps = kalman.x[VEL_UAV] - kalman.x[VEL_ROVER]
        found = self._window.position(kalman.t_ns, vel_rel_mps, float(kalman.x[YAW]))
        if found is None:
            return False
        pos_rel_m, cov_m2 = found
        jacobian = np.zeros((3, SIZE))
        jacobian[:, UWB_BIAS] = pos_rel_m / max(float(np.linalg.norm(pos_rel_m)), 1e-3)
        history.add([PositionReset(kalman.t_ns, pos_rel_m, cov_m2, jacobian, std_bias_m)])
        return True

    def _is_rejected(self, history: MeasurementHistory, kind: Kind, span_s: float) -> bool:
        if not history.rejected.get(kind):
            return False
        t_ns = history.kalman.t_ns
        statistics = history.statistics(kind, t_ns - int(span_s * NS_PER_S))
        if statistics is None or statistics.measurements < REJECTED_MEASUREMENTS_MIN:
            return False
        long_enough = t_ns - statistics.first_ns > 0.8 * span_s * NS_PER_S
        return long_enough and statistics.used < ACCEPTED_FRACTION_MIN * statistics.offered

    def _reset_to_rejected_input(self, history: MeasurementHistory) -> None:
        """Reset to an input that has been rejected for longer than the time-out."""
        self._rejected_inputs = tuple(k for k in MONITORED_KINDS if self._is_rejected(history, k, REJECTION_WINDOW_S))
        t_ns, span_s = history.kalman.t_ns, self._validity.rejection_timeout_s
        span_ns = int(span_s * NS_PER_S)
        for kind in self._rejected_inputs:
            if not self._is_rejected(history, kind, span_s):
                continue
            if kind == "rover":  # UWB measurements were rotated by its heading, so the whole state is wrong
                self.restart(self._prior)
                return
            if kind == "uwb" and t_ns - history.used_ns.get("tag", -span_ns) < span_ns:
                self._judge_uwb(history, t_ns - span_ns)
            elif kind == "uwb" and self._reset_by_uwb(history, force=True, std_bias_m=self._tuning.std_uwb_bias_m):
                self._reset_at_ns[kind] = t_ns
            elif kind == "tag":
                statistics = history.statistics(kind, t_ns - int(span_s * NS_PER_S))
                assert statistics is not None and isinstance(statistics.newest, TagMeasurement)
                tag = statistics.newest
                if t_ns - history.used_ns.get("uwb", -span_ns) < span_ns:
                    self._judge_uwb(history, t_ns - span_ns)
                    return
                history.add(
                    [PositionReset(tag.t_ns, tag.pos_rel_m, STD_TAG_RESET_M**2 * np.eye(3), tag.error_jacobian())]
                )
                self._reset_at_ns[kind] = t_ns


def _admitted(monitor: ConsistencyMonitor, measurement: Measurement) -> Iterator[Measurement]:
    """The part of a measurement that may be used, if there is one."""
    if isinstance(measurement, UwbMeasurement):
        if not monitor.uwb_left_out:
            anchor_m = monitor.anchor_left_out
            yield measurement if anchor_m is None else measurement.without(anchor_m)
    elif isinstance(measurement, TagMeasurement):
        if not monitor.tag_left_out:
            yield measurement
    elif isinstance(measurement, RoverOdometryMeasurement) and monitor.speed_left_out:
        yield msgspec.structs.replace(measurement, speed_known=False)
    else:
        yield measurement


# -- resets, which the history keeps in order with the measurements --------------------------------------


class HeaveBegin(msgspec.Struct, frozen=True, gc=False):
    """The platform is found to heave; see `Kalman.begin_heave`."""

    kind: ClassVar[Kind] = "locate"
    t_ns: int

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> UpdateResult:
        kalman.begin_heave()
        return UpdateResult(1, 1)


class HeadingReset(msgspec.Struct, frozen=True, gc=False):
    """Turn of the rover's heading against its compass; for the fields see `Kalman.reset_rover_heading`."""

    kind: ClassVar[Kind] = "locate"
    t_ns: int
    turn_rad: float
    std_rad: float

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> UpdateResult:
        kalman.reset_rover_heading(self.turn_rad, self.std_rad)
        return UpdateResult(1, 1)


class PositionReset(msgspec.Struct, frozen=True, gc=False):
    """Measured relative position that replaces the former estimate; fields as in `Kalman.reset_rover_position`.

    Attributes:
        std_uwb_bias_m: deviation of the error that all UWB ranges share, which is forgotten first; None to keep it.
    """

    kind: ClassVar[Kind] = "locate"
    t_ns: int
    pos_rel_m: Array
    cov_m2: Array
    error_jacobian: Array
    std_uwb_bias_m: float | None = None

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> UpdateResult:
        if self.std_uwb_bias_m is not None:
            kalman.reset_uwb_bias(self.std_uwb_bias_m)
        kalman.reset_rover_position(self.pos_rel_m, self.cov_m2, self.error_jacobian)
        return UpdateResult(3, 3)
