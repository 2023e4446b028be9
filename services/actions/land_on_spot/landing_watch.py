"""What ends a landing that can't succeed.

The approach of every landing ends when the wind stays above its limit. A landing on the rover also ends by a wrong
estimate, out of bounds, too late, or when it is interrupted again and again.
"""

from math import hypot

from jezero.base.frames import Vec3, altitude_m, subtract
from jezero.schemas.goals import LandPhase
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.config import RoverLandingConfig
from jezero.services.actions.motion.behaviour import Done, VehicleState

ABOVE_LIMIT_S = 3.0
"""A wind that is above the limit for a shorter time is a gust, in which the vehicle waits over the platform."""


class WindLimit:
    """Compares the estimated mean wind with the limit while a landing is flown.

    Args:
        max_mps: the limit.
        force: the goal is flown in any wind.

    Attributes:
        reason: reason to end an approach, because the wind has stayed above the limit; "" without one.
    """

    def __init__(self, max_mps: float, force: bool) -> None:
        self._max_mps = max_mps
        self._force = force
        self._below_ns: int | None = None
        self.reason = ""

    def update(self, t_ns: int, state: VehicleState) -> None:
        """Add the newest estimate, in every step of the landing."""
        reason = wind_refusal(state.wind_ned_mps, state.std_gust_mps, self._max_mps)
        if self._force or not reason or self._below_ns is None:
            self._below_ns = t_ns
        self.reason = reason if t_ns - self._below_ns > ABOVE_LIMIT_S * NS_PER_S else ""


def wind_refusal(wind_ned_mps: Vec3 | None, std_gust_mps: float | None, max_mps: float) -> str:
    """Reason not to land in the estimated mean wind, or ""; an unknown wind is none."""
    if wind_ned_mps is None or hypot(*wind_ned_mps[:2]) <= max_mps:
        return ""
    return (
        f"{wind_words(wind_ned_mps, std_gust_mps)}, and a landing is limited to {max_mps:g} m/s (wind_max_mps): "
        "wait for less wind, or use force"
    )


def wind_words(wind_ned_mps: Vec3 | None, std_gust_mps: float | None) -> str:
    """The estimated wind for people."""
    if wind_ned_mps is None:
        return "the wind is unknown"
    mean_mps = hypot(*wind_ned_mps[:2])
    gusts = "" if std_gust_mps is None else f" with gusts to {mean_mps + std_gust_mps:.1f} m/s"
    return f"the wind is {mean_mps:.1f} m/s{gusts}"


LANDED_S = 0.5
"""The autopilot's detection of the ground counts after this time."""
TOO_FAST_S = 1.0
"""An estimate may exceed the rover's top speed for this time, while the filter settles."""
CONTRADICTED_S = 3.0
"""Time in which a contradiction between the inputs may end."""
INTERRUPTIONS_MAX = 3
"""A descent that is interrupted more often than this won't succeed."""
TOUCHDOWN_PHASES: tuple[LandPhase, ...] = ("descent", "contact")
OUT_OF_SIGHT_PHASES: tuple[LandPhase, ...] = ("hold", "search")
ADVICE: dict[LandPhase, str] = {
    "approach": "the vehicle does not get steadily over the platform: check the wind and the rover's speed",
    "descent": "the vehicle does not stay in the descent's cone: check the wind and the rover's speed and turns",
    "contact": "the vehicle lifts off the platform again: check the wind and the platform's slope",
    "go_around": "contacts fail again and again: check the wind and the platform's slope",
}
"""What to check when most of the time was spent in a phase with the rover in sight."""


class LandingWatch:
    """Watches one landing on the rover."""

    def __init__(self, settings: RoverLandingConfig, t_ns: int, state: VehicleState) -> None:
        self._bounds, self._timeout_s = settings.bounds, settings.timeout_s
        self._start_ns = t_ns
        self._start_ned_m = state.pos_uav_ned_m
        self._landed_ns: int | None = None
        self._too_fast_ns: int | None = None
        self._contradicted_ns: int | None = None
        self._phase: LandPhase = "approach"
        self._t_ns = t_ns
        self._durations_s: dict[LandPhase, float] = {}
        self._out_of_sight_ns = t_ns
        """Time at which the rover went out of sight last."""
        self._heights_m: list[float] = []
        """Last estimated heights above the platform before the descent was interrupted."""
        self._height_m = 0.0

    def update(self, t_ns: int, state: VehicleState, phase: LandPhase, loss_reason: str) -> Done | None:
        """Add the newest state; returns the end of the landing when it can't go on.

        Args:
            phase: of the landing.
            loss_reason: why the rover was out of sight last.
        """
        self._durations_s[phase] = self._durations_s.get(phase, 0.0) + (t_ns - self._t_ns) / NS_PER_S
        self._t_ns = t_ns
        if phase in OUT_OF_SIGHT_PHASES and self._phase not in OUT_OF_SIGHT_PHASES:
            self._out_of_sight_ns = t_ns
            if self._phase == "descent":
                self._heights_m.append(self._height_m)
        self._phase = phase
        if state.relative is not None and state.relative.valid:
            self._height_m = altitude_m(state.relative.pos_uav_rel_rover_ned_m[2])
        return (
            self._interrupted(state, loss_reason)
            or self._on_ground(t_ns, state)
            or self._out_of_bounds(state.pos_uav_ned_m)
            or self._too_fast(t_ns, state)
            or self._contradicted(t_ns, state)
            or self._too_late(t_ns, state, loss_reason)
        )

    def _interrupted(self, state: VehicleState, loss_reason: str) -> Done | None:
        if len(self._heights_m) <= INTERRUPTIONS_MAX:
            return None
        low_m, high_m = min(self._heights_m), max(self._heights_m)
        return Done(
            "aborted",
            f"the descent was interrupted {len(self._heights_m)} times, {low_m:.1f} to {high_m:.1f} m above the "
            f"platform: {loss_reason}; {_advice_on_sight(state)}",
        )

    def _on_ground(self, t_ns: int, state: VehicleState) -> Done | None:
        """End on the ground during approach, hold or search, where only a wrong height can have led."""
        if not state.landed or self._phase in TOUCHDOWN_PHASES:
            self._landed_ns = None
            return None
        self._landed_ns = t_ns if self._landed_ns is None else self._landed_ns
        if t_ns - self._landed_ns < LANDED_S * NS_PER_S:
            return None
        relative = state.relative
        if relative is None or not relative.valid:
            return Done("aborted", "the vehicle stands on the ground before it has found the platform", then="disarm")
        height_m = altitude_m(relative.pos_uav_rel_rover_ned_m[2])
        source = " and ".join(name for name, used in (("UWB", relative.use_uwb), ("tag", relative.use_tag)) if used)
        reason = (
            f"the vehicle stands on the ground, but {source} say {height_m:.1f} m above the platform: "
            "check the positions of the anchors and the size of the tags in vehicle.toml"
        )
        return Done("aborted", reason, then="disarm")

    def _out_of_bounds(self, pos_uav_ned_m: Vec3) -> Done | None:
        bounds = self._bounds
        north_m, east_m, down_m = subtract(pos_uav_ned_m, self._start_ned_m)
        if hypot(north_m, east_m) > bounds.distance_max_m:
            return Done(
                "aborted",
                f"the landing led {hypot(north_m, east_m):.0f} m away from its start, the bound is "
                f"{bounds.distance_max_m:g} m (distance_max_m)",
            )
        if altitude_m(down_m) > bounds.climb_max_m:
            return Done(
                "aborted",
                f"the landing led {altitude_m(down_m):.0f} m up from its start, the bound is "
                f"{bounds.climb_max_m:g} m (climb_max_m)",
            )
        return None

    def _too_fast(self, t_ns: int, state: VehicleState) -> Done | None:
        relative, max_mps = state.relative, self._bounds.speed_rover_max_mps
        speed_mps = 0.0 if relative is None or not relative.valid else hypot(*relative.vel_rover_ned_mps[:2])
        if speed_mps <= max_mps:
            self._too_fast_ns = None
            return None
        self._too_fast_ns = t_ns if self._too_fast_ns is None else self._too_fast_ns
        if t_ns - self._too_fast_ns < TOO_FAST_S * NS_PER_S:
            return None
        return Done(
            "aborted",
            f"the estimate says that the rover drives at {speed_mps:.1f} m/s, the bound is {max_mps:g} m/s "
            "(speed_rover_max_mps): check the rover's odometry and the positions of the anchors",
        )

    def _contradicted(self, t_ns: int, state: VehicleState) -> Done | None:
        if state.relative is None or not state.relative.contradicted:
            self._contradicted_ns = None
            return None
        self._contradicted_ns = t_ns if self._contradicted_ns is None else self._contradicted_ns
        if t_ns - self._contradicted_ns < CONTRADICTED_S * NS_PER_S:
            return None
        return Done("aborted", state.relative.reason)

    def _too_late(self, t_ns: int, state: VehicleState, loss_reason: str) -> Done | None:
        if t_ns - self._start_ns <= self._timeout_s * NS_PER_S:
            return None
        longest_first = sorted(self._durations_s, key=self._durations_s.__getitem__, reverse=True)
        phases = ", ".join(f"{self._durations_s[phase]:.0f} s {phase}" for phase in longest_first)
        reason = f"not landed after {self._timeout_s:g} s (timeout_s): {phases}"
        if self._phase in OUT_OF_SIGHT_PHASES:
            reason += f"; the rover has been out of sight for {(t_ns - self._out_of_sight_ns) / NS_PER_S:.0f} s"
        elif loss_reason:
            reason += f"; the rover was out of sight {(t_ns - self._out_of_sight_ns) / NS_PER_S:.0f} s ago"
        reason += f": {loss_reason}" if loss_reason else ""
        longest = longest_first[0]
        advice = _advice_on_sight(state) if longest in OUT_OF_SIGHT_PHASES else ADVICE[longest]
        return Done("aborted", f"{reason}; {advice}")


def _advice_on_sight(state: VehicleState) -> str:
    """What to check when the rover is out of sight, by the inputs in use."""
    relative = state.relative
    if relative is None:
        return "check that the estimator runs (`jezero ps`)"
    advice = []
    if relative.use_tag:
        advice.append(
            "check what hides the tags there, such as tags too large or too small to be seen from that height, a "
            "shadow, or the camera's focus"
        )
    if relative.use_uwb:
        advice.append("check that the UWB anchors are powered and within their range")
    return "; ".join(advice)
