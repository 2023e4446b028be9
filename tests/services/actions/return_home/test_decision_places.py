"""The places of a return, best first."""

import pytest
from msgspec.structs import replace

from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleLimitsConfig
from jezero.schemas.estimate import RoverEstimate
from jezero.services.actions.motion.behaviour import Refusal
from jezero.services.actions.return_home.decision import Place, ground_places, rover_place

HERE = (30.0, 40.0, -10.0)
LIMITS = VehicleLimitsConfig()


def rover(*, valid: bool, std_m: float, pos_ned_m: Vec3 = (5.0, 6.0, -0.5)) -> RoverEstimate:
    return RoverEstimate(
        t_ns=0,
        epoch_id=1,
        valid=valid,
        reason="" if valid else "nothing measured by UWB for 9 s",
        pos_rover_ned_m=pos_ned_m,
        vel_rover_ned_mps=(0.0, 0.0, 0.0),
        yaw_rover_rad=0.0,
        std_pos_m=std_m,
    )


def test_a_rover_in_sight_and_one_that_its_odometry_knows_well_enough_are_places() -> None:
    for estimate in (rover(valid=True, std_m=0.1), rover(valid=False, std_m=9.9)):
        place = rover_place(estimate, 10.0, LIMITS)
        assert isinstance(place, Place)
        assert (place.kind, place.pos_ned_m) == ("rover", (5.0, 6.0, -0.5))


@pytest.mark.parametrize(
    ("estimate", "reason"),
    [(None, "the estimator is silent"), (rover(valid=False, std_m=10.1), "nothing measured by UWB for 9 s")],
)
def test_a_rover_that_nobody_knows_is_no_place_but_a_reason(estimate: RoverEstimate | None, reason: str) -> None:
    assert rover_place(estimate, 10.0, LIMITS) == Refusal(reason)


@pytest.mark.parametrize("pos_ned_m", [(-9646.0, 16649.0, -0.5), (5.0, 6.0, -157.0)])
@pytest.mark.parametrize("valid", [False, True])
def test_a_rover_beyond_the_limits_is_no_place_however_well_it_is_known(pos_ned_m: Vec3, valid: bool) -> None:
    place = rover_place(rover(valid=valid, std_m=2.9, pos_ned_m=pos_ned_m), 10.0, LIMITS)
    assert isinstance(place, Refusal) and "beyond the limits of 500 m and 120 m" in place.reason


def test_a_driving_rover_has_its_velocity_over_ground() -> None:
    place = rover_place(replace(rover(valid=True, std_m=0.1), vel_rover_ned_mps=(0.4, -0.3, 0.1)), 10.0, LIMITS)
    assert isinstance(place, Place) and place.vel_ned_mps == (0.4, -0.3, 0.0)


def test_the_takeoff_point_comes_before_all_rally_points_nearest_first() -> None:
    places = ground_places(HERE, (1.0, 2.0, 0.0), [(0.0, 0.0), (30.0, 50.0)])
    assert places == [
        Place("takeoff_point", (1.0, 2.0, 0.0)),
        Place("rally_point", (30.0, 50.0, 0.0)),
        Place("rally_point", (0.0, 0.0, 0.0)),
    ]


def test_places_that_are_missing_are_said() -> None:
    assert ground_places(HERE, None, []) == [
        Refusal("nobody knows where the vehicle took off"),
        Refusal("there is no rally point"),
    ]
