"""The places of a return, best first."""

import pytest

from jezero.frames import Vec3
from jezero.schemas.estimate import RoverEstimate
from jezero.services.actions.return_home.places import Place, ground_places, rover_place
from jezero.vehicle_config import VehicleLimitsConfig

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
    assert rover_place(estimate, 10.0, LIMITS) == reason


@pytest.mark.parametrize("pos_ned_m", [(-9646.0, 16649.0, -0.5), (5.0, 6.0, -157.0)])
@pytest.mark.parametrize("valid", [False, True])
def test_a_rover_beyond_the_limits_is_no_place_however_well_it_is_known(pos_ned_m: Vec3, valid: bool) -> None:
    place = rover_place(rover(valid=valid, std_m=2.9, pos_ned_m=pos_ned_m), 10.0, LIMITS)
    assert isinstance(place, str) and "beyond the limits of 500 m and 120 m" in place


def test_the_takeoff_point_comes_before_the_nearest_rally_point() -> None:
    places = ground_places("no rover", HERE, (1.0, 2.0, 0.0), [(0.0, 0.0), (30.0, 50.0)])
    assert [(place.kind, place.pos_ned_m) for place in places] == [
        ("takeoff_point", (1.0, 2.0, 0.0)),
        ("rally_point", (30.0, 50.0, 0.0)),
    ]


def test_without_a_takeoff_point_the_nearest_rally_point_says_why() -> None:
    (place,) = ground_places("no rover", HERE, None, [(0.0, 0.0)])
    assert place.kind == "rally_point"
    assert place.reason == "no rover; nobody knows where the vehicle took off"


def test_without_any_place_the_vehicle_lands_where_it_is() -> None:
    (place,) = ground_places("no rover", HERE, None, [])
    assert (place.kind, place.pos_ned_m) == ("here", (30.0, 40.0, 0.0))
    assert "no rally point" in place.reason
