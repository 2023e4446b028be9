"""The time from the first contact to the landing: pressing down, going around, and the detection of the landing.

A vehicle that has touched something must neither slide over an edge nor tip over it. Its thrust goes down at once, as
its weight alone keeps it in place, and its motion over the surface and its tilt are watched until it has landed.
"""

from collections import deque
from math import degrees, exp, hypot, sqrt
from typing import Literal, NamedTuple

from jezero.base.detectors import SLOPE_SINE_MAX, is_tilted_by_contact
from jezero.base.frames import Quat, Vec3, quat_conjugate, quat_rotate, tilt_from_quat
from jezero.base.vehicle_config import AirframeConfig, PlanetConfig, VehicleConfig
from jezero.schemas.estimate import DeckMotion
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.landing_watch import wind_words
from jezero.services.actions.land_on_spot.platform import PlatformState
from jezero.services.actions.motion.behaviour import Done, VehicleState

PUSH_ACC_MPS2 = 5.0
"""Downward acceleration that is fed forward once the vehicle has touched down: it takes half of the thrust at once."""
TOUCHED_MPS = 0.15
"""A vehicle that is slower than this downwards although it is pushed stands on something."""
SLIDE_S = 0.2
"""A slide is measured over this time. The vehicle's own velocity would not show it: a vehicle that turns upright on its
first foot moves by half a metre per second, and its feet stay where they are.
"""
OUTWARD_MIN_MPS = 0.2
"""A slower motion away from the middle is noise of the estimate."""
PREDICTION_S = 0.3
"""The vehicle goes around when it would leave its place within this time: a climb takes about as long to begin."""
LEAN_S = 0.4
"""A shorter tilt than this is the way from the first foot to all four."""
LYING_TILT_RAD = 1.2
"""A vehicle with a larger tilt lies on its side: its rotors can't lift it any more."""
LEVEL_SHARE, LEVEL_ACC_MAX_MPS2 = 0.8, 4.0
"""Share and largest part of the thrust against the wind that is cancelled in contact. The autopilot's integral, which
makes that thrust, is limited, and the autopilot may add a share to what is fed forward for its own delay. What is
cancelled too much would tip the vehicle over downwind; what is cancelled too little leans it into the wind.
"""
LEVEL_TIME_CONSTANT_S = 0.5
"""A vehicle that stands upright loses the tilt that it had in the wind with this time constant."""
BELOW_M, BELOW_SIGMAS = 0.2, 2.0
"""A vehicle that touches the platform can't be lower than its surface by this and this number of standard deviations:
it is beside the platform, or the estimate is wrong."""
Problem = Literal["", "slides", "leans", "below"]


class OnSurface(NamedTuple):
    """Where the vehicle touches a surface.

    Attributes:
        offset_ned_m: (2,) middle of the feet from the middle of the place where the vehicle should stand.
        std_m: standard deviation of the offset.
    """

    offset_ned_m: tuple[float, float]
    std_m: float = 0.0


def is_below(platform: PlatformState | None) -> bool:
    """Whether the estimate says that the vehicle is lower than a vehicle that touches the platform can be."""
    return platform is not None and platform.height_m < -BELOW_M - BELOW_SIGMAS * platform.std_height_m


class ContactWatcher:
    """Decides whether a contact becomes a landing or a go-around.

    Args:
        room_m: distance from the middle of the place up to which the vehicle may stand.
        planet: has the gravity.
    """

    def __init__(self, room_m: float, planet: PlanetConfig) -> None:
        self._room_m = room_m
        self._planet = planet
        self._begin_ns = self._upright_ns = 0
        self._free_down_ned = (0.0, 0.0)
        self._touched = False
        self._path: deque[tuple[int, float, float]] = deque()
        """Times and offsets of the last SLIDE_S."""

    def begin(self, t_ns: int, free_down_ned: tuple[float, float]) -> None:
        """Start to watch a contact.

        Args:
            free_down_ned: (2,) the tilt in the air, before the contact.
        """
        self._begin_ns = self._upright_ns = t_ns
        self._free_down_ned = free_down_ned
        self._touched = False
        self._path.clear()

    def push_acc_ned_mps2(self, down_mps: float) -> Vec3:
        """(3,) acceleration, fed forward, that takes the thrust away once the vehicle has touched down.

        Args:
            down_mps: downward speed of the vehicle relative to the surface.
        """
        self._touched = self._touched or down_mps < TOUCHED_MPS
        if not self._touched:
            return (0.0, 0.0, 0.0)
        level_acc = level_acc_ned_mps2(self._free_down_ned, self._planet)
        return (*level_acc, PUSH_ACC_MPS2 * self._planet.gravity_ratio)

    def update(
        self, t_ns: int, surface: OnSurface | None, state: VehicleState, platform: PlatformState | None = None
    ) -> Problem:
        """Judge the newest state of a vehicle in contact; one that lies on its side has no problem that a climb solves.

        Args:
            surface: None while the place isn't measured.
            platform: None for a landing elsewhere, and while the platform isn't measured.
        """
        if tilt_from_quat(state.q_ned_from_frd) > LYING_TILT_RAD:
            return ""
        if is_below(platform):
            return "below"
        if self._slides(t_ns, surface):
            return "slides"
        remaining = exp(-(t_ns - self._begin_ns) / NS_PER_S / LEVEL_TIME_CONSTANT_S)
        north, east = self._free_down_ned
        if not is_tilted_by_contact(state.down_ned, (remaining * north, remaining * east), SLOPE_SINE_MAX):
            self._upright_ns = t_ns
        return "leans" if t_ns - self._upright_ns > LEAN_S * NS_PER_S else ""

    def _slides(self, t_ns: int, surface: OnSurface | None) -> bool:
        """Whether the feet have moved towards the edge, and would soon leave the place."""
        path = self._path
        if surface is None:
            path.clear()
            return False
        north_m, east_m = surface.offset_ned_m
        path.append((t_ns, north_m, east_m))
        while len(path) > 2 and t_ns - path[1][0] >= SLIDE_S * NS_PER_S:
            path.popleft()
        begin_ns, begin_north_m, begin_east_m = path[0]
        passed_s = (t_ns - begin_ns) / NS_PER_S
        if passed_s < SLIDE_S:
            return False
        offset_m = hypot(north_m, east_m)
        outward_m = (north_m * (north_m - begin_north_m) + east_m * (east_m - begin_east_m)) / max(offset_m, 1e-9)
        outward_mps = outward_m / passed_s
        ahead_m = offset_m - surface.std_m + PREDICTION_S * outward_mps
        return outward_mps > OUTWARD_MIN_MPS and ahead_m > self._room_m


def level_acc_ned_mps2(down_ned: tuple[float, float], planet: PlanetConfig) -> tuple[float, float]:
    """(2,) acceleration, fed forward, that cancels most of the horizontal thrust of a vehicle tilted against the wind.

    Args:
        down_ned: (2,) the tilt in the air, see `VehicleState.down_ned`.
    """
    north, east = down_ned
    per_sine_mps2 = LEVEL_SHARE * planet.gravity_mps2 / sqrt(max(1.0 - north * north - east * east, 0.25))
    per_sine_mps2 = min(per_sine_mps2, LEVEL_ACC_MAX_MPS2 * planet.gravity_ratio / max(hypot(north, east), 1e-9))
    return per_sine_mps2 * north, per_sine_mps2 * east


def feet_from_uav_ned_m(state: VehicleState, airframe: AirframeConfig) -> tuple[float, float]:
    """(2,) horizontal vector from the vehicle's position to the middle of its feet."""
    north, east = state.down_ned
    return airframe.height_stand_m * north, airframe.height_stand_m * east


def foot_drop_m(q_ned_from_frd: Quat, airframe: AirframeConfig) -> float:
    """How much lower the lowest foot of a tilted vehicle is than the feet of a level one at the same position."""
    forward, right, down = quat_rotate(quat_conjugate(q_ned_from_frd), (0.0, 0.0, 1.0))
    forward_m, right_m = airframe.feet_frd_m
    return abs(forward) * forward_m + abs(right) * right_m + (down - 1.0) * airframe.height_stand_m


CLIMB_MPS, CLIMB_M, CLIMB_S = 1.5, 1.5, 4.0
"""Speed, height over the surface and longest duration of the climb of a go-around."""


class GoArounds:
    """The go-arounds of one landing: the climb, their number, and the reason when there were too many.

    Attributes:
        climbing: whether the vehicle climbs after a bad contact.
    """

    def __init__(self, maximum: int) -> None:
        self._maximum = maximum
        self._problems: list[Problem] = []
        self._begin_ns = 0
        self._slope_deg = 0.0
        self.climbing = False

    def begin(self, t_ns: int, problem: Problem, state: VehicleState) -> None:
        """Start the climb."""
        self._problems.append(problem)
        self._begin_ns = t_ns
        self._slope_deg = degrees(hypot(*state.down_ned))
        self.climbing = True

    def is_high(self, t_ns: int, height_m: float | None) -> bool:
        """Whether the climb is over; it ends `climbing`."""
        high = height_m is not None and height_m > CLIMB_M
        if high or t_ns - self._begin_ns > CLIMB_S * NS_PER_S:
            self.climbing = False
        return not self.climbing

    def abort_reason(self, state: VehicleState) -> str:
        """Reason to end the landing after the last permitted go-around, or ""."""
        number = len(self._problems)
        if number <= self._maximum:
            return ""
        if self._problems[-1] == "leans":
            return (
                f"the vehicle was tilted by {self._slope_deg:.0f} degrees on what it touched, in spite of "
                f"{self._maximum} go-arounds: land where it is level"
            )
        if self._problems[-1] == "below":
            return (
                "by the estimate the vehicle came below the platform's surface, which can't be, in spite of "
                f"{self._maximum} go-arounds: check the UWB ranges, and the positions of the anchors in vehicle.toml"
            )
        return (
            f"the vehicle slid on what it touched, in spite of {self._maximum} go-arounds: "
            f"{wind_words(state.wind_ned_mps, state.std_gust_mps)}; "
            "wait for less wind, or land elsewhere"
        )


FORCE_S = 3.0
"""Duration for which the conditions of a forced disarm must hold. Source: spec §8, which wants 2 s at least; PX4 takes
about as long to detect the ground."""
FORCE_BELOW_M, FORCE_MPS = 0.1, 0.2
"""A forced disarm needs a height that is surely below this, and a relative speed below this although the vehicle is
pushed down."""
FORCE_FEET_MAX_M = 0.1
"""A forced disarm needs an altimeter range, tilt-corrected, of feet lower than this, or none."""
HELD_S, HELD_SINKS_MAX_M, HELD_BELOW_M = 4.0, 1.0, 0.3
"""A vehicle that is pushed down in the air sinks by more than 2 m in HELD_S, as its thrust is taken away; one that a
deck holds moves with the deck. Height by the estimate above which nothing holds the vehicle."""
HEIGHT_SIGMAS = 2.0
"""The height plus this many standard deviations must be below the limit of a forced disarm."""


class TouchdownDetector:
    """Detects that the vehicle stands on the platform, independently of the autopilot. Source: spec §8.

    Two signs must hold: the height over the platform is low, and the vehicle rests there although it is pushed down.
    They count only while the platform is measured, and the altimeter may not contradict them. On a deck that heaves
    the vehicle never stands still, and close to the anchors its height by UWB is uncertain: there it also stands when
    it has sunk by much less than it was pushed down.
    """

    def __init__(self, vehicle: VehicleConfig) -> None:
        self._on_platform_m = 0.5 * vehicle.platform.side_m
        self._range_max_m = vehicle.height_altimeter_m + FORCE_FEET_MAX_M
        self._since_ns: int | None = None
        self._pushed: deque[tuple[int, float]] = deque()
        """Times and heights of the vehicle, positive down, since the push began, for HELD_S at most."""

    def reset(self) -> None:
        """Start again, because the signs so far were no touchdown."""
        self._since_ns = None
        self._pushed.clear()

    def update(
        self,
        t_ns: int,
        platform: PlatformState | None,
        range_m: float | None,
        deck: DeckMotion | None = None,
        down_m: float = 0.0,
    ) -> bool:
        """Add the newest state; returns whether the vehicle has stood on the platform for long enough.

        To be called in every step in which the vehicle is pushed down.

        Args:
            platform: None while the platform isn't measured.
            range_m: of the altimeter, tilt-corrected; None when it measures nothing, as on the ground.
            deck: motion of a platform that heaves; None for a still one.
            down_m: height of the vehicle in the world, positive down.
        """
        altimeter_agrees = range_m is None or range_m < self._range_max_m
        if deck is not None and altimeter_agrees and self._is_held(t_ns, platform, down_m):
            return True
        if platform is None or not altimeter_agrees or not self._has_signs(platform):
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = t_ns
        return t_ns - self._since_ns >= FORCE_S * NS_PER_S

    def _has_signs(self, platform: PlatformState) -> bool:
        low = platform.height_m + HEIGHT_SIGMAS * platform.std_height_m < FORCE_BELOW_M
        rests = platform.speed_mps < FORCE_MPS and abs(platform.vel_ned_mps[2]) < FORCE_MPS
        return low and rests and platform.error_m < self._on_platform_m

    def _is_held(self, t_ns: int, platform: PlatformState | None, down_m: float) -> bool:
        """Whether something holds the vehicle, low over the platform, against a push of HELD_S."""
        pushed = self._pushed
        pushed.append((t_ns, down_m))
        while t_ns - pushed[0][0] > HELD_S * NS_PER_S:
            pushed.popleft()
        if platform is not None and (platform.height_m > HELD_BELOW_M or platform.error_m > self._on_platform_m):
            pushed.clear()
            return False
        return t_ns - pushed[0][0] > 0.9 * HELD_S * NS_PER_S and down_m - pushed[0][1] < HELD_SINKS_MAX_M


DISARM_S = 4.0
"""Time from the contact until the autopilot has found the ground and stopped the motors."""
FALLEN_TILT_RAD = 0.52
"""A vehicle with a larger tilt than this has fallen over."""


def landing_outcome(state: VehicleState) -> Done:
    """End of a landing when the autopilot has detected the ground."""
    tilt_rad = tilt_from_quat(state.q_ned_from_frd)
    if tilt_rad > FALLEN_TILT_RAD:
        return Done("aborted", f"the vehicle fell over: it is tilted by {degrees(tilt_rad):.0f} degrees", "disarm")
    return Done("succeeded", then="disarm")
