"""Initial conditions of one landing, drawn from its seed."""

from math import cos, pi, sin, sqrt
from random import Random
from typing import Annotated, Literal
from zlib import crc32

import msgspec
from msgspec import Meta

from jezero.base.frames import Vec3
from jezero.schemas.goals import LandOnSpotGoal

CaseName = Literal["uwb+tag", "uwb", "tag", "none"]
RoverName = Literal["still", "drive", "turn", "zigzag", "fast"]
CASES: tuple[CaseName, ...] = ("uwb+tag", "uwb", "tag", "none")
MOTIONS: dict[RoverName, tuple[float, float, float | None]] = {
    "still": (0.0, 0.0, None),
    "drive": (0.5, 0.0, None),
    "turn": (1.0, 0.2, None),
    "zigzag": (0.8, 0.4, 2.0),
    "fast": (4.0, 0.0, None),
}
"""Speed in m/s and yaw rate in rad/s of the rover, and the time in s after which it turns the other way."""

ALTITUDE_RANGE_M = (4.0, 8.0)
ROVER_DISTANCE_MAX_M = 8.0
ROVER_DISTANCE_MIN_M = 1.5
"""The vehicle stands beside the rover before it takes off."""
FOOTPRINT_HALF_SIDE_PER_M = 0.6
"""Half of the short side of the camera's footprint per metre of altitude."""
POSITION_ERROR_RANGE_M = (1.0, 3.0)
TAG_HIDDEN_DURATION_S = 1.0
TAG_HIDDEN_START_RANGES_S = ((2.0, 6.0), (7.0, 11.0))
"""The tag disappears once at a time within each of these ranges, counted from the goal."""
DISTURBED_RANGE_S = (2.0, 9.0)
Share = Annotated[float, Meta(ge=0.0, le=1.0)]


class Conditions(msgspec.Struct, frozen=True, kw_only=True):
    """Conditions that all landings of one benchmark share.

    Attributes:
        case: sensors that the landing may use; "none" lands on a spot on the ground instead of the rover.
        rover: the rover's motion, see MOTIONS.
        tags: "projected" calculates the corners that a detector would find, "rendered" renders images and detects tags.
        uwb_std_m: standard deviation of the ranges; None takes the shipped setting, or 0.1 m in the case "uwb".
        uwb_outliers: share of the ranges without line of sight; None takes 0, or 0.1 in the case "uwb".
        uwb_bias_m: constant error of the ranges, one for all anchors or one for each; empty for none.
        anchors_rotated: the anchors stand one place farther than configured, as on a rover whose yaw is 90° wrong.
        camera_delay_s: time from exposure to the published image; None takes the shipped setting.
        hide_tag: whether the tag disappears twice, for a second each.
        tag_until_m: height above the platform below which no image arrives; None for none.
        wind_mps: speed of the mean wind.
        std_gust_mps: standard deviation of each horizontal component of the gusts.
        wind_change_mps: speed to which the mean wind changes during the landing, from another direction; None keeps it.
        tilt_deg: tilt of the platform; the seed draws its direction.
        sea: (3,) height in m and period in s of the waves that move the rover, and the tilt of the deck in degrees, as
            in the simulator's `SeaConfig`; None for none. The seed draws the waves and their direction.
        rocks: whether the rover drives over many rocks, and leans and heaves with the ground.
        tag_side_m: side of the landing board's big tag as it was printed; None prints it as configured.
        rover_compass_deg: constant error of the rover's compass, clockwise.
        compass_step_deg: angle by which the vehicle's compass jumps during the landing; the seed draws when.
    """

    case: CaseName
    rover: RoverName = "still"
    tags: Literal["projected", "rendered"] = "projected"
    uwb_std_m: float | None = None
    uwb_outliers: Share | None = None
    uwb_bias_m: tuple[float, ...] = ()
    anchors_rotated: bool = False
    camera_delay_s: float | None = None
    hide_tag: bool = False
    tag_until_m: float | None = None
    wind_mps: float = 3.0
    std_gust_mps: float = 0.6
    wind_change_mps: float | None = None
    tilt_deg: float = 0.0
    sea: tuple[float, float, float] | None = None
    rocks: bool = False
    tag_side_m: float | None = None
    rover_compass_deg: float = 0.0
    compass_step_deg: float = 0.0


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """Initial conditions of one landing.

    Attributes:
        seed: seed of the trial and of the whole stack.
        conditions: the benchmark's conditions.
        altitude_m: altitude of the vehicle above its take-off point when the goal is sent.
        pos_rover_ned_m: (2,) initial position of the rover, north and east of the vehicle's take-off point.
        yaw_rover_rad: initial yaw of the rover.
        wind_from_deg: direction from which the wind blows, clockwise from north.
        rover_position_error_m: (2,) error, north and east, of the rover's position in the goal of the case "tag".
        tag_hidden_start_s: times from the goal at which the tag disappears.
        sea_from_deg: direction from which the waves come, clockwise from north.
        tilt_towards_deg: direction of the platform's low side, clockwise from the rover's front.
        disturbed_s: time from the goal at which the compass jumps and the wind changes.
        wind_change_from_deg: direction from which the changed wind blows.
    """

    seed: int
    conditions: Conditions
    altitude_m: float
    pos_rover_ned_m: tuple[float, float]
    yaw_rover_rad: float
    wind_from_deg: float
    rover_position_error_m: tuple[float, float]
    tag_hidden_start_s: tuple[float, ...]
    tilt_towards_deg: float
    disturbed_s: float
    wind_change_from_deg: float
    sea_from_deg: float

    def goal(self, pos_rover_ned_m: Vec3) -> LandOnSpotGoal:
        """The landing's goal.

        Args:
            pos_rover_ned_m: (3,) position of the platform when the goal is sent, NED.
        """
        case = self.conditions.case
        north_m, east_m, down_m = pos_rover_ned_m
        spot_ned_m: Vec3 | None = None
        if case == "tag":
            spot_ned_m = (north_m + self.rover_position_error_m[0], east_m + self.rover_position_error_m[1], down_m)
        elif case == "none":
            spot_ned_m = self.spot_ned_m
        return LandOnSpotGoal(landing_spot_ned_m=spot_ned_m, use_uwb="uwb" in case, use_tag="tag" in case)

    @property
    def spot_ned_m(self) -> Vec3:
        """(3,) landing spot of the case "none": on the ground, opposite the rover at the same distance."""
        return (-self.pos_rover_ned_m[0], -self.pos_rover_ned_m[1], 0.0)


def draw_trial(seed: int, conditions: Conditions, clear_m: float = 0.0) -> Trial:
    """Draw a trial; the same seed gives the same wind, rover position and yaw in every case.

    Args:
        clear_m: least distance of the rover from a vehicle that starts beside it, of a vehicle with large rotors.
    """
    distance_min_m = max(ROVER_DISTANCE_MIN_M, clear_m)
    rng = Random(crc32(f"landing/{seed}".encode()))
    altitude_m = rng.uniform(*ALTITUDE_RANGE_M)
    share, bearing_rad = rng.random(), rng.uniform(-pi, pi)
    distance_max_m = (
        min(ROVER_DISTANCE_MAX_M, FOOTPRINT_HALF_SIDE_PER_M * altitude_m)
        if conditions.case == "tag"
        else ROVER_DISTANCE_MAX_M
    )
    distance_m = sqrt(distance_min_m**2 + share * max(distance_max_m**2 - distance_min_m**2, 0.0))
    error_m, error_bearing_rad = rng.uniform(*POSITION_ERROR_RANGE_M), rng.uniform(-pi, pi)
    return Trial(
        seed=seed,
        conditions=conditions,
        altitude_m=altitude_m,
        pos_rover_ned_m=(distance_m * cos(bearing_rad), distance_m * sin(bearing_rad)),
        yaw_rover_rad=rng.uniform(-pi, pi),
        wind_from_deg=rng.uniform(-180.0, 180.0),
        rover_position_error_m=(error_m * cos(error_bearing_rad), error_m * sin(error_bearing_rad)),
        tag_hidden_start_s=tuple(rng.uniform(*span) for span in TAG_HIDDEN_START_RANGES_S),
        tilt_towards_deg=rng.uniform(-180.0, 180.0),
        disturbed_s=rng.uniform(*DISTURBED_RANGE_S),
        wind_change_from_deg=rng.uniform(-180.0, 180.0),
        sea_from_deg=rng.uniform(-180.0, 180.0),
    )
