"""What protects every flight, whatever the action.

Before it starts, a goal is refused whose planned flight the battery doesn't hold (`battery_refusal`), or whose way
leaves the fence (`fence_refusal`). While it flies, `FlightProtection` ends it when the autopilot was wrong about where
the vehicle is (`ResetWatch`), when it leads into the ground (`GroundProximity`), or when the vehicle runs away from its
setpoints (`RunawayDetector`).
"""

from collections import deque
from collections.abc import Sequence
from math import degrees
from typing import Literal, NamedTuple

from jezero.base.detectors import COMPASS_CHECK, heading_step_rad
from jezero.base.fence import way_refusal
from jezero.base.frames import Vec3, add, distance, horizontal, norm, subtract
from jezero.base.vehicle_config import BatteryConfig, VehicleConfig
from jezero.runtime.service import Inbox
from jezero.schemas.commands import Phase
from jezero.schemas.state import Battery, Odometry
from jezero.schemas.topics import STATUS
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.lifecycle.vehicle_view import known_fence
from jezero.services.actions.motion.behaviour import Move, Plan, VehicleState
from jezero.services.actions.motion.limits import high_or_far_refusal

# -- before the flight --

BATTERY_RESOLUTION = 0.01
"""The autopilot reports whole percents, so that half of one may be missing."""
LANDING_MPS, DISARM_S = 0.5, 2.0
"""Mean speed of a landing, which is slow near the ground, and the time until the motors are off."""
WAY_HOME_MIN_S = 20.0
"""A return takes at least this time: the vehicle climbs to a safe height, flies to its place, comes down and lands."""


def battery_refusal(flight_s: float, landing_from_m: float, battery: Battery | None, config: BatteryConfig) -> str:
    """Reason why the battery doesn't hold a flight, or ""; a battery that nobody knows holds every flight.

    Args:
        flight_s: planned duration of the flight.
        landing_from_m: height from which the vehicle must still land after it; 0 for no landing.
    """
    if battery is None or battery.remaining is None or battery.critical is None:
        return ""
    home_s = max(landing_from_m / LANDING_MPS + DISARM_S, WAY_HOME_MIN_S) if landing_from_m > 0.0 else 0.0
    used = config.used(flight_s + home_s)
    least = max(battery.remaining - 0.5 * BATTERY_RESOLUTION, 0.0)
    if least - used >= battery.critical:
        return ""
    home = f" and {home_s:.0f} s for the way home after it" if home_s else ""
    return (
        f"the battery is too low: {flight_s:.0f} s of flight{home} use {_percent(used)}, only {_percent(least)} are "
        f"sure to be there, and {_percent(battery.critical)} must be left for the autopilot's return: charge the "
        "battery, or fly a shorter way"
    )


def _percent(fraction: float) -> str:
    return f"{100.0 * fraction:.1f} %"


FENCE_UNKNOWN = "the vehicle's fence is not known yet: send the goal again in a second"


def fence_refusal(way_ned_m: Sequence[Vec3], plan: Plan, inbox: Inbox) -> str:
    """Reason why a goal leaves the fence, or ""; an unknown way is not judged."""
    status, fence = inbox.latest(STATUS), known_fence(inbox)
    if status is None or not status.fence_id:
        return ""
    if fence is None:
        return FENCE_UNKNOWN
    return way_refusal(fence, way_ned_m, from_ground=plan.do_takeoff, to_ground=plan.lands)


# -- in flight --


class FlightProtection:
    """All protections of one goal's flight.

    Args:
        odometry: at the start of the flight.
        lands: the goal ends on the ground; it goes on after a step of the autopilot's position.
    """

    def __init__(self, vehicle: VehicleConfig, odometry: Odometry, *, lands: bool) -> None:
        self._limits = vehicle.limits
        self._resets = None if lands else ResetWatch(odometry)
        self._ground = GroundProximity(vehicle)
        self._runaway = RunawayDetector()

    def problem(self, t_ns: int, odometry: Odometry, state: VehicleState, move: Move) -> str:
        """Add the newest state and setpoint; returns the reason why the goal must end, or ""."""
        return (
            self._moved_beyond(move, state.shift_ned_m)
            or (self._resets.problem(odometry, move) if self._resets else "")
            or self._ground.problem(t_ns, state, move)
            or self._runaway.problem(t_ns, state, move)
        )

    def _moved_beyond(self, move: Move, shift_ned_m: Vec3) -> str:
        """Reason why the goal's points are beyond the limits after a step of the autopilot's position, or ""."""
        point_ned_m = move.pos_ned_m
        if point_ned_m is None or not any(shift_ned_m) or high_or_far_refusal(point_ned_m, self._limits):
            return ""
        beyond = high_or_far_refusal(add(point_ned_m, shift_ned_m), self._limits)
        return f"the autopilot corrected its position, and with it the goal's: {beyond}" if beyond else ""


RESETS_MAX_M = 1.0
"""Greatest sum of the horizontal steps of the position within one goal."""


class ResetWatch:
    """Ends a goal whose autopilot was wrong about where the vehicle is, or where it points.

    After a step of the autopilot's position a goal's points move along with it (spec §1). That keeps the vehicle from
    jumping, and lets a goal succeed somewhere else than it was asked to. So a goal only bears small steps.

    Args:
        odometry: at the start of the goal.
    """

    def __init__(self, odometry: Odometry) -> None:
        self._last = odometry
        self._sum_m = 0.0
        self._steps = 0

    def problem(self, odometry: Odometry, move: Move) -> str:
        """Add the newest odometry; returns the reason why the goal must end, or ""."""
        last, self._last = self._last, odometry
        if odometry.reset_counter == last.reset_counter:
            return ""
        if turned_rad := heading_step_rad(last, odometry):
            turned_deg = abs(degrees(turned_rad))
            return (
                f"the autopilot turned its heading by {turned_deg:.0f}° in one step, as the vehicle's motion "
                f"contradicts the compass: {COMPASS_CHECK}"
            )
        step_m = horizontal(subtract(odometry.reset_offset_ned_m, last.reset_offset_ned_m))
        self._sum_m += step_m
        self._steps += step_m > 0.0
        if self._sum_m <= RESETS_MAX_M or move.frame is not None:
            return ""
        steps = "one step" if self._steps == 1 else f"{self._steps} steps"
        return (
            f"the autopilot corrected its position by {self._sum_m:.1f} m in {steps} during the goal, and the goal's "
            f"points moved along; {RESETS_MAX_M:g} m is the limit: check GNSS and the compass, then send the goal again"
        )


CLEARANCE_MIN_M = 0.25
"""Least height of the feet over ground or platform in a flight that is no takeoff or landing."""
BRAKING_MPS2 = 1.5
"""Deceleration of the descent that a hover reaches in the Earth's gravity; above the clearance there must be room for
it."""
STANDING_CLEARANCE_M, STANDING_SPEED_MPS = 0.1, 0.1
"""A vehicle that is lower and slower than this stands, and must not be moved along the ground."""
LOW_MIN_S = 0.15
"""A vehicle that is low for a shorter time isn't judged: single readings may be wrong."""


class GroundProximity:
    """Detects that the flight of a goal leads into the ground, whatever altitude the autopilot has estimated.

    A barometer that is wrong by some metres moves the autopilot's altitude by as much. A target at a safe altitude is
    then in the ground. The laser altimeter shows it in time.

    Args:
        vehicle: has the mounting height of the altimeter, and the gravity.
    """

    def __init__(self, vehicle: VehicleConfig) -> None:
        self._height_altimeter_m = vehicle.height_altimeter_m
        self._braking_mps2 = BRAKING_MPS2 * vehicle.planet.gravity_ratio
        self._low_since_ns: int | None = None

    def problem(self, t_ns: int, state: VehicleState, move: Move) -> str:
        """Add the newest state; returns the reason why the goal must end, or "".

        Without a reading of the altimeter nothing changes: a vehicle that stands is too low for it.
        """
        if move.phase in (Phase.TAKEOFF, Phase.LANDING):
            self._low_since_ns = None
            return ""
        if state.height_m is None:
            return ""
        clearance_m = state.height_m - self._height_altimeter_m
        if not self._is_low(clearance_m, state):
            self._low_since_ns = None
        elif self._low_since_ns is None:
            self._low_since_ns = t_ns
        if self._low_since_ns is None or t_ns - self._low_since_ns < LOW_MIN_S * NS_PER_S:
            return ""
        return (
            f"the altimeter measures only {max(clearance_m, 0.0):.1f} m below the vehicle's feet, and the goal leads "
            "down: is the altitude of the autopilot right, and the ground as high as expected?"
        )

    def _is_low(self, clearance_m: float, state: VehicleState) -> bool:
        """Whether the vehicle can't stop its descent above the least clearance, or stands."""
        down_mps = state.vel_uav_ned_mps[2]
        if clearance_m < STANDING_CLEARANCE_M and norm(state.vel_uav_ned_mps) < STANDING_SPEED_MPS:
            return True
        braking_m = down_mps * down_mps / (2.0 * self._braking_mps2)
        return down_mps > 0.0 and clearance_m < CLEARANCE_MIN_M + braking_m


RUNAWAY_MIN_S = 2.0
"""The error must grow for this time without a break: gusts and overshoots are shorter."""
RUNAWAY_SAMPLE_NS = 200_000_000
RUNAWAY_GROWTH_MIN = 1.0
"""Least growth of the error within RUNAWAY_MIN_S by the vehicle's own motion in calm air; m of a position, m/s of a
velocity."""
GUST_RATIO = 0.4
"""A gust, or the wind on a vehicle that has just taken off, moves it at this ratio of the wind's speed until its
autopilot has tilted it enough."""
WIND_UNKNOWN_MPS = 12.0
"""Speed of a wind that isn't known yet, as during a takeoff, and of any stronger one."""
Quantity = Literal["position", "velocity"]
_UNITS: dict[Quantity, str] = {"position": "m", "velocity": "m/s"}


class _Sample(NamedTuple):
    """State of the vehicle and its setpoint at one time.

    Attributes:
        quantity: that is commanded.
        setpoint: commanded value.
        actual: value of the vehicle.
        wind_mps: speed of the wind in its gusts.
        leads_back: the command points from the vehicle to the setpoint.
    """

    t_ns: int
    quantity: Quantity
    setpoint: Vec3
    actual: Vec3
    wind_mps: float
    leads_back: bool

    @property
    def error(self) -> float:
        return distance(self.setpoint, self.actual)


class RunawayDetector:
    """Detects a vehicle that runs away from its setpoint, whatever the cause: a wrong heading, wind, a weak rotor.

    A vehicle runs away when for two seconds its error grows in every sample, by its own motion and not by that of the
    setpoint, although the command leads it back, and not slower at the end than at the beginning. So one that brakes
    after a takeover, or is left behind by a platform, doesn't run away.
    """

    def __init__(self) -> None:
        self._samples: deque[_Sample] = deque()
        self._growths: deque[float] = deque()
        """Growth of the error by the vehicle's own motion up to each sample but the first."""

    def problem(self, t_ns: int, state: VehicleState, move: Move) -> str:
        """Add the newest state and setpoint; returns the reason why the goal must end, or ""."""
        newest = _sample(t_ns, state, move)
        if newest is None or not state.armed or state.landed:
            self._clear()
            return ""
        if self._samples:
            last = self._samples[-1]
            if newest.quantity == last.quantity and t_ns - last.t_ns < RUNAWAY_SAMPLE_NS:
                return ""
            growth = distance(last.setpoint, newest.actual) - last.error
            grows = growth > 0.0 and newest.error > last.error and newest.leads_back
            if newest.quantity != last.quantity or not grows:
                self._clear()
            else:
                self._growths.append(growth)
        self._samples.append(newest)
        return self._judge()

    def _judge(self) -> str:
        """Judge the samples of the last two seconds, in each of which the error has grown."""
        first, last = self._samples[0], self._samples[-1]
        if last.t_ns - first.t_ns < RUNAWAY_MIN_S * NS_PER_S:
            return ""
        growths, error_growth = list(self._growths), last.error - first.error
        half = len(growths) // 2
        self._samples.popleft()
        self._growths.popleft()
        grown, slows_down = min(error_growth, sum(growths)), sum(growths[-half:]) < sum(growths[:half])
        # The wind before the error began to grow: the estimate takes the effects of a wrong heading for wind.
        blown_mps = GUST_RATIO * first.wind_mps
        blown = blown_mps * RUNAWAY_MIN_S if last.quantity == "position" else blown_mps
        if grown < RUNAWAY_GROWTH_MIN + blown or slows_down:
            return ""
        unit, duration_s = _UNITS[last.quantity], (last.t_ns - first.t_ns) / NS_PER_S
        return (
            f"the vehicle runs away from its setpoint: its {last.quantity} is {last.error:.1f} {unit} off, and the "
            f"error grew by {grown:.1f} {unit} in {duration_s:.1f} s against the command; check the compass (iron or "
            "currents nearby, its calibration), then GNSS, the rotors and the wind"
        )

    def _clear(self) -> None:
        self._samples.clear()
        self._growths.clear()


def _sample(t_ns: int, state: VehicleState, move: Move) -> _Sample | None:
    """State and setpoint of the quantity that the move commands; None when it commands nothing."""
    wind_mps = WIND_UNKNOWN_MPS
    if state.wind_ned_mps is not None:
        wind_mps = min(horizontal(state.wind_ned_mps) + (state.std_gust_mps or 0.0), WIND_UNKNOWN_MPS)
    if move.pos_ned_m is not None:
        return _Sample(t_ns, "position", move.pos_ned_m, state.pos_uav_ned_m, wind_mps, leads_back=True)
    if move.vel_ned_mps is None:
        return None
    if move.target_ned_m is None:
        return _Sample(t_ns, "velocity", move.vel_ned_mps, state.vel_uav_ned_mps, wind_mps, leads_back=True)
    # Only horizontally: a landing descends on purpose while it waits beside its target.
    (north_m, east_m, _), (to_north_m, to_east_m, _) = state.pos_uav_ned_m, move.target_ned_m
    north_mps, east_mps, _ = move.vel_ned_mps
    leads_back = (to_north_m - north_m) * north_mps + (to_east_m - east_m) * east_mps > 0.0
    return _Sample(t_ns, "position", (to_north_m, to_east_m, 0.0), (north_m, east_m, 0.0), wind_mps, leads_back)
