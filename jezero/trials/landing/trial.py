"""What one landing begins with, drawn from its seed."""

from math import cos, pi, sin, sqrt
from random import Random
from typing import Annotated, Literal
from zlib import crc32

import msgspec
from msgspec import Meta

from jezero.frames import Vec3
from jezero.schemas.actions import LandOnSpotGoal

CaseName = Literal["uwb+tag", "uwb", "tag", "none"]
RoverName = Literal["still", "drive", "turn"]
CASES: tuple[CaseName, ...] = ("uwb+tag", "uwb", "tag", "none")
MOTIONS: dict[RoverName, tuple[float, float]] = {"still": (0.0, 0.0), "drive": (0.5, 0.0), "turn": (1.0, 0.2)}
"""Speed in m/s and yaw rate in rad/s."""

WIND_MPS, STD_GUST_MPS = 3.0, 0.6
UP_M = (4.0, 8.0)
AWAY_MAX_M = 8.0
NEAREST_M = 1.5
"""The vehicle stands beside the rover at first."""
FOOTPRINT_PER_M = 0.6
"""Half of what the camera sees, its short side, per metre of height."""
ROUGH_M = (1.0, 3.0)
HIDDEN_S = 1.0
HIDDEN_FROM_S = ((2.0, 6.0), (7.0, 11.0))
"""After the goal; in each of these spans one disappearance of the tag begins."""
Share = Annotated[float, Meta(ge=0.0, le=1.0)]


class Conditions(msgspec.Struct, frozen=True, kw_only=True):
    """What a benchmark flies; all its landings have it in common.

    Attributes:
        tags: "projected" calculates what a detector would find, "rendered" renders and detects.
        uwb_std_m, uwb_outliers: of the ranges, and the share of them without line of sight; None: the settings' own,
            but for the case uwb 0.1 m and 0.1.
        camera_latency_s: from exposure to picture; None: the settings' own.
        hide_tag: the tag disappears twice for a second.
    """

    case: CaseName
    rover: RoverName = "still"
    tags: Literal["projected", "rendered"] = "projected"
    uwb_std_m: float | None = None
    uwb_outliers: Share | None = None
    camera_latency_s: float | None = None
    hide_tag: bool = False


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """One landing.

    Attributes:
        up_m: of the vehicle over the ground it took off from, when the goal comes.
        pos_rover_ned_m: (2,) north and east of the place where the vehicle took off, at the start.
        wind_from_deg: where it comes from.
        rough_error_m: (2,) by which the rover's position is given wrongly, with the tag alone.
        hidden_s: begins of the tag's disappearances, from the goal's begin.
    """

    seed: int
    conditions: Conditions
    up_m: float
    pos_rover_ned_m: tuple[float, float]
    yaw_rover_rad: float
    wind_from_deg: float
    rough_error_m: tuple[float, float]
    hidden_s: tuple[float, ...]

    def goal(self, pos_rover_ned_m: Vec3) -> LandOnSpotGoal:
        """The goal, from where the rover is when it is sent."""
        case = self.conditions.case
        north_m, east_m, down_m = pos_rover_ned_m
        spot_ned_m: Vec3 | None = None
        if case == "tag":
            spot_ned_m = (north_m + self.rough_error_m[0], east_m + self.rough_error_m[1], down_m)
        elif case == "none":
            spot_ned_m = self.spot_ned_m
        return LandOnSpotGoal(landing_spot_ned_m=spot_ned_m, use_uwb="uwb" in case, use_tag="tag" in case)

    @property
    def spot_ned_m(self) -> Vec3:
        """On the ground, as far away as the rover, but on the other side."""
        return (-self.pos_rover_ned_m[0], -self.pos_rover_ned_m[1], 0.0)


def draw_trial(seed: int, conditions: Conditions) -> Trial:
    """The same seed gives the same wind, place and heading in every case."""
    rng = Random(crc32(f"landing/{seed}".encode()))
    up_m = rng.uniform(*UP_M)
    share, bearing_rad = rng.random(), rng.uniform(-pi, pi)
    farthest_m = min(AWAY_MAX_M, FOOTPRINT_PER_M * up_m) if conditions.case == "tag" else AWAY_MAX_M
    away_m = sqrt(NEAREST_M**2 + share * (farthest_m**2 - NEAREST_M**2))
    wrong_m, wrong_rad = rng.uniform(*ROUGH_M), rng.uniform(-pi, pi)
    return Trial(
        seed=seed,
        conditions=conditions,
        up_m=up_m,
        pos_rover_ned_m=(away_m * cos(bearing_rad), away_m * sin(bearing_rad)),
        yaw_rover_rad=rng.uniform(-pi, pi),
        wind_from_deg=rng.uniform(-180.0, 180.0),
        rough_error_m=(wrong_m * cos(wrong_rad), wrong_m * sin(wrong_rad)),
        hidden_s=tuple(rng.uniform(*span) for span in HIDDEN_FROM_S),
    )
