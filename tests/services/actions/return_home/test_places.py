"""The places of a return, best first."""

import pytest

from jezero.schemas.estimate import RoverEstimate
from jezero.services.actions.return_home.places import Place, ground_places, rover_place

HERE = (30.0, 40.0, -10.0)


def rover(*, valid: bool, std_m: float) -> RoverEstimate:
    return RoverEstimate(
        t_ns=0,
        epoch_id=1,
        valid=valid,
        reason="" if valid else "nothing measured by UWB for 9 s",
        pos_rover_ned_m=(5.0, 6.0, -0.5),
        vel_rover_ned_mps=(0.0, 0.0, 0.0),
        yaw_rover_rad=0.0,
        std_pos_m=std_m,
    )


def test_a_rover_in_sight_and_one_that_its_odometry_knows_well_enough_are_places() -> None:
    for estimate in (rover(valid=True, std_m=0.1), rover(valid=False, std_m=9.9)):
        place = rover_place(estimate, 10.0)
        assert isinstance(place, Place)
        assert (place.kind, place.pos_ned_m) == ("rover", (5.0, 6.0, -0.5))


@pytest.mark.parametrize(
    ("estimate", "reason"),
    [(None, "the estimator is silent"), (rover(valid=False, std_m=10.1), "nothing measured by UWB for 9 s")],
)
def test_a_rover_that_nobody_knows_is_no_place_but_a_reason(estimate: RoverEstimate | None, reason: str) -> None:
    assert rover_place(estimate, 10.0) == reason


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
