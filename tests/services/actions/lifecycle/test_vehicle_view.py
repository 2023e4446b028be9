"""The state of the vehicle that a behaviour gets."""

from typing import Any

from msgspec.structs import replace

from jezero.base.frames import Vec3
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Odometry, StatusCode
from jezero.schemas.topics import ALTIMETER, ODOMETRY, STATUS
from jezero.services.actions.lifecycle.vehicle_view import VehicleView
from tests.services.actions.test_behaviours import a_status


def odometry(t_ns: int, pos_uav_ned_m: Vec3) -> Odometry:
    return Odometry(
        t_ns=t_ns,
        epoch_id=1,
        pos_uav_ned_m=pos_uav_ned_m,
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        rates_uav_frd_rps=(0.0, 0.0, 0.0),
    )


class Box:
    """The newest messages of a bus."""

    def __init__(self, **latest: Any) -> None:
        self._latest = latest

    def latest(self, topic: Any) -> Any:
        return self._latest.get(topic.name)


def test_a_behaviour_flies_by_the_odometry_of_its_own_topic_and_by_that_in_the_status_until_there_is_one() -> None:
    """The status has ten a second, the topic fifty."""
    view = VehicleView(1, None, ())
    old, new = odometry(100, (0.0, 0.0, -3.0)), odometry(180, (0.4, 0.0, -3.0))
    status = replace(a_status(StatusCode.GO_TO), odometry=old)
    both = {ODOMETRY.name: new, STATUS.name: status}
    assert view.odometry(Box(**both)) == new  # type: ignore[arg-type]
    assert view.odometry(Box(**{STATUS.name: status})) == old  # type: ignore[arg-type]
    assert view.odometry(Box(**{ODOMETRY.name: new})) == new  # type: ignore[arg-type]
    assert view.odometry(Box()) is None  # type: ignore[arg-type]


def test_a_goal_that_is_planned_from_elsewhere_does_not_know_the_height_there() -> None:
    """The altimeter measures where the vehicle is."""
    odometry_here = odometry(1000, (0.0, 0.0, -3.0))
    box = Box(**{ALTIMETER.name: Altimeter(t_ns=1000, range_m=3.0), STATUS.name: a_status(StatusCode.HOVER)})
    here, there = VehicleView(1, None, ()), VehicleView(1, None, (), (10.0, 0.0, -8.0))
    assert here.state(1000, box, odometry_here).height_m == 3.0  # type: ignore[arg-type]
    assert there.state(1000, box, odometry_here).height_m is None  # type: ignore[arg-type]
