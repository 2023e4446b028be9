"""The estimator proper: measurements in, where the vehicle is relative to the rover out."""

from collections.abc import Sequence
from math import inf, isfinite

import msgspec
import numpy as np

from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.config import Trust, Tuning
from jezero.services.estimator.kalman import Kalman, Moment
from jezero.services.estimator.locating import UwbWindow
from jezero.services.estimator.measurements import (
    Kind,
    Location,
    Measurement,
    OdometryFix,
    TagFix,
    UwbRound,
    is_linear,
)
from jezero.services.estimator.motion import (
    POS_ROVER,
    POS_UAV,
    SIZE,
    STD_UNKNOWN_M,
    VEL_ERROR,
    VEL_ROVER,
    VEL_UAV,
    YAW,
    YAW_RATE,
    Array,
    MotionModel,
    initial,
)
from jezero.services.estimator.timeline import REFUSED_SHARE, Timeline

LOCATED_STD_M = 0.1 * STD_UNKNOWN_M
YAW_STD_MAX_RAD = 0.3
STD_RELOCATED_M = 0.5
KINDS: tuple[Kind, ...] = ("odometry", "rover", "altimeter", "uwb", "tag")
WATCHED: tuple[Kind, ...] = ("rover", "uwb", "tag")
CONTRADICTED_S = 0.5
REFUSED_MIN = 5
"""An input is contradicted when so many of its measurements or more were refused."""
RIVALS_NS = 3 * NS_PER_S
"""Two inputs that were both believed anew within this time contradict each other."""


def _relative() -> Array:
    T = np.zeros((6, SIZE))
    T[0:3, POS_UAV] = T[3:6, VEL_UAV] = np.eye(3)
    T[0:3, POS_ROVER] = T[3:6, VEL_ROVER] = -np.eye(3)
    return T


RELATIVE_T = _relative()


class Estimate(msgspec.Struct, frozen=True, gc=False):
    """The vehicle relative to the rover; the fields are those of `schemas.estimate.Relative`.

    Attributes:
        vel_rover_mps: in the velocity frame of the autopilot's odometry.
    """

    t_ns: int
    pos_rel_m: Array
    vel_rel_mps: Array
    cov: Array
    vel_rover_mps: Array
    yaw_rover_rad: float
    yaw_rate_rover_rps: float


class RelativeFilter:
    """Keeps the filter located, in time and away from wrong locks."""

    def __init__(self, tuning: Tuning, trust: Trust) -> None:
        self._tuning, self._trust = tuning, trust
        self._kalman = Kalman(MotionModel(tuning))
        self._timeline: Timeline | None = None
        self._window = UwbWindow()
        self._rough: tuple[Array, float] | None = None
        self._relocked: dict[Kind, int] = {}
        self._contradicted: tuple[Kind, ...] = ()

    def tune(self, tuning: Tuning) -> None:
        """Other noises from now on."""
        self._tuning = tuning
        self._kalman.use(MotionModel(tuning))

    def restart(self, rough: tuple[Array, float] | None = None) -> None:
        """Forget everything.

        Args:
            rough: vehicle-independent position of the rover (3,) in the frame of `OdometryFix`, and its standard
                deviation.
        """
        self._timeline = None
        self._window.clear()
        self._relocked.clear()
        self._contradicted = ()
        self._rough = rough

    def add(self, measurements: Sequence[Measurement]) -> None:
        """Fuse what arrived, in any order."""
        if self._timeline is None and not self._start(measurements):
            return
        assert self._timeline is not None
        timeline = self._timeline
        rounds = [m for m in measurements if type(m) is UwbRound]
        for uwb in rounds:
            self._window.add(uwb)
        timeline.add([*measurements, *self._first_location(measurements)])
        if rounds:
            self._locate_by_uwb(timeline)
        if any(measurement.kind in WATCHED for measurement in measurements):
            self._break_wrong_lock(timeline)
        if not isfinite(timeline.kalman.x.sum() + timeline.kalman.P.sum()):
            self.restart(self._rough)

    # -- what is known -------------------------------------------------------------------------------------

    @property
    def estimate(self) -> Estimate | None:
        """None before the first odometry."""
        if self._timeline is None:
            return None
        kalman = self._timeline.kalman
        x = kalman.x
        relative = RELATIVE_T @ x
        return Estimate(
            t_ns=kalman.t_ns,
            pos_rel_m=relative[0:3],
            vel_rel_mps=relative[3:6],
            cov=RELATIVE_T @ kalman.P @ RELATIVE_T.T,
            vel_rover_mps=x[VEL_ROVER] + x[VEL_ERROR],
            yaw_rover_rad=float(x[YAW]),
            yaw_rate_rover_rps=float(x[YAW_RATE]),
        )

    @property
    def std_pos_m(self) -> float:
        """Of the relative position's worst axis; infinite before it is known at all."""
        return inf if self._timeline is None else self._timeline.kalman.std_pos_rel_m

    @property
    def located(self) -> bool:
        """Whether the rover's place is known, be it roughly."""
        return self.std_pos_m < LOCATED_STD_M

    @property
    def inputs(self) -> tuple[Kind, ...]:
        """Kinds of measurements fused in the last second."""
        if self._timeline is None:
            return ()
        since_ns, used_ns = self._kalman.t_ns - NS_PER_S, self._timeline.used_ns
        return tuple(kind for kind in KINDS if used_ns.get(kind, -1) > since_ns)

    @property
    def fused_ns(self) -> int:
        """Time of the newest UWB or tag measurement that was fused, 0 before the first."""
        used_ns = {} if self._timeline is None else self._timeline.used_ns
        return max(used_ns.get("uwb", 0), used_ns.get("tag", 0))

    @property
    def contradicted(self) -> tuple[Kind, ...]:
        """Inputs of which nearly all measurements of the last half second were refused."""
        return self._contradicted

    @property
    def rivals(self) -> bool:
        """Whether UWB and tag were both believed anew a short time ago."""
        times = list(self._relocked.values())
        now_ns = 0 if self._timeline is None else self._timeline.kalman.t_ns
        return len(times) == 2 and all(now_ns - t_ns < RIVALS_NS for t_ns in times)

    # -- finding the rover ---------------------------------------------------------------------------------

    def _start(self, measurements: Sequence[Measurement]) -> bool:
        """Begin at the first odometry."""
        first = next((m for m in measurements if isinstance(m, OdometryFix)), None)
        if first is None:
            return False
        x, P = initial(first.pos_vel[0:3], self._tuning)
        self._timeline = Timeline(self._kalman, Moment(first.t_ns, x, P), self._trust.gate)
        if self._rough is not None:
            pos_rover_m, std_m = self._rough
            self._timeline.add([Location(first.t_ns, first.pos_vel[0:3] - pos_rover_m, std_m**2 * np.eye(3))])
        return True

    def _first_location(self, measurements: Sequence[Measurement]) -> list[Measurement]:
        """While nothing is known: the first picture of a tag says where the rover is."""
        tag = next((m for m in measurements if type(m) is TagFix), None)
        if tag is None or self.located:
            return []
        return [Location(tag.t_ns, tag.pos_rel_m, tag.noise_m2() + self._cov_by_attitude(tag))]

    def _cov_by_attitude(self, tag: TagFix) -> Array:
        arm_m = float(np.linalg.norm(tag.arm_m))
        std = max(self._tuning.std_tilt_rad, self._tuning.std_heading_rad) * arm_m
        return std * std * np.eye(3)

    def _locate_by_uwb(self, timeline: Timeline, *, anew: bool = False) -> bool:
        """Start from trilateration where the ranges can't be linearised."""
        kalman = timeline.kalman
        if not anew and is_linear(kalman):
            return False
        if float(kalman.P[YAW, YAW]) > YAW_STD_MAX_RAD**2:
            return False
        vel_rel_mps = kalman.x[VEL_UAV] - kalman.x[VEL_ROVER]
        found = self._window.position(kalman.t_ns, vel_rel_mps, float(kalman.x[YAW]))
        if found is None:
            return False
        timeline.add([Location(kalman.t_ns, *found)])
        return True

    def _is_refused(self, timeline: Timeline, kind: Kind, span_s: float) -> bool:
        if not timeline.refused.get(kind):
            return False
        t_ns = timeline.kalman.t_ns
        tally = timeline.tally(kind, t_ns - int(span_s * NS_PER_S))
        if tally is None or tally.measurements < REFUSED_MIN:
            return False
        long_enough = t_ns - tally.first_ns > 0.8 * span_s * NS_PER_S
        return long_enough and tally.used < REFUSED_SHARE * tally.offered

    def _break_wrong_lock(self, timeline: Timeline) -> None:
        """Believe an input that has been contradicted for too long."""
        self._contradicted = tuple(k for k in WATCHED if self._is_refused(timeline, k, CONTRADICTED_S))
        t_ns, span_s = timeline.kalman.t_ns, self._trust.relock_s
        for kind in self._contradicted:
            if not self._is_refused(timeline, kind, span_s):
                continue
            if kind == "rover":  # its heading turns all that UWB has told
                self.restart(self._rough)
                return
            if kind == "uwb" and self._locate_by_uwb(timeline, anew=True):
                self._relocked[kind] = t_ns
            elif kind == "tag":
                tally = timeline.tally(kind, t_ns - int(span_s * NS_PER_S))
                assert tally is not None and isinstance(tally.newest, TagFix)
                tag = tally.newest
                timeline.add([Location(tag.t_ns, tag.pos_rel_m, STD_RELOCATED_M**2 * np.eye(3))])
                self._relocked[kind] = t_ns
