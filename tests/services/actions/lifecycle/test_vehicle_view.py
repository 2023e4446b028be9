"""The state of the vehicle that a behaviour gets."""

from collections.abc import Mapping
from math import radians
from typing import Any

import pytest
from msgspec.structs import replace

from jezero.base.frames import Quat, Vec3, quat_from_euler
from jezero.schemas.estimate import Relative, RoverEstimate
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Battery, Odometry, StatusCode
from jezero.schemas.topics import ALTIMETER, ODOMETRY, RELATIVE, ROVER_ESTIMATE, STATUS
from jezero.services.actions.lifecycle.vehicle_view import VehicleView, hovering_at
from jezero.services.actions.motion.behaviour import VehicleState
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


S = 1_000_000_000
T_NS = 100 * S
HERE = odometry(T_NS, (1.0, 2.0, -3.0))
LEVEL, ROLLED = (1.0, 0.0, 0.0, 0.0), quat_from_euler(radians(60.0), 0.0, 0.0)


def state(view: VehicleView, latest: Mapping[str, Any], of: Odometry = HERE, behind_ns: int = 0) -> VehicleState:
    return view.state(T_NS, Box(**latest), of, behind_ns)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("age_s", "range_m", "q_ned_from_frd", "height_m"),
    [
        (0.0, 4.0, LEVEL, 4.0),
        (0.29, 4.0, LEVEL, 4.0),
        (0.31, 4.0, LEVEL, None),
        (-0.29, 4.0, LEVEL, 4.0),
        (-0.31, 4.0, LEVEL, None),
        (0.0, None, LEVEL, None),
        (0.0, 4.0, ROLLED, 2.0),
    ],
)
def test_the_height_is_that_of_a_young_reading_of_the_altimeter_along_the_vertical(
    age_s: float, range_m: float | None, q_ned_from_frd: Quat, height_m: float | None
) -> None:
    altimeter = Altimeter(t_ns=T_NS - int(age_s * S), range_m=range_m)
    found = state(VehicleView(1, None, ()), {ALTIMETER.name: altimeter}, replace(HERE, q_ned_from_frd=q_ned_from_frd))
    assert found.height_m == (None if height_m is None else pytest.approx(height_m))


@pytest.mark.parametrize(("age_s", "expected_s"), [(-0.1, 0.0), (0.2, 0.2), (9.0, 0.5)])
def test_the_age_of_the_state_is_that_of_its_odometry_up_to_half_a_second(age_s: float, expected_s: float) -> None:
    old = replace(HERE, t_ns=T_NS - int(age_s * S))
    assert state(VehicleView(1, None, ()), {}, old).age_s == pytest.approx(expected_s)


def test_positions_are_those_of_the_world_as_it_was_at_the_begin() -> None:
    view = VehicleView(1, None, (ROVER_ESTIMATE,))
    view.begin(replace(HERE, reset_offset_ned_m=(10.0, 0.0, 0.0)))
    stepped = replace(HERE, pos_uav_ned_m=(4.0, 2.0, -3.0), reset_offset_ned_m=(13.0, 0.0, -1.0))
    rover = rover_estimate(reset_offset_ned_m=(13.0, 0.0, -1.0))
    found = state(view, {ROVER_ESTIMATE.name: rover}, stepped)
    assert found.shift_ned_m == (3.0, 0.0, -1.0)
    assert found.pos_uav_ned_m == (1.0, 2.0, -2.0)
    assert found.rover is not None
    assert found.rover.pos_rover_ned_m == (7.0 - 3.0, 8.0, 0.0 + 1.0)
    assert found.rover.reset_offset_ned_m == (10.0, 0.0, 0.0)


def test_status_gives_arming_landing_wind_and_battery_and_without_one_nothing_is_known() -> None:
    battery = Battery(voltage_v=15.0, remaining=0.5)
    status = replace(
        a_status(StatusCode.GO_TO),
        armed=True,
        landed=True,
        wind_ned_mps=(1.0, 2.0, 0.0),
        std_gust_mps=0.5,
        battery=battery,
    )
    found = state(VehicleView(1, None, ()), {STATUS.name: status})
    assert (found.armed, found.landed, found.battery) == (True, True, battery)
    assert (found.wind_ned_mps, found.std_gust_mps) == ((1.0, 2.0, 0.0), 0.5)
    found = state(VehicleView(1, None, ()), {STATUS.name: replace(status, armed=False, landed=False)})
    assert (found.armed, found.landed) == (False, False)
    found = state(VehicleView(1, None, ()), {})
    assert (found.armed, found.landed, found.battery, found.wind_ned_mps, found.std_gust_mps) == (
        False,
        False,
        *(None,) * 3,
    )


def test_a_plan_from_elsewhere_supposes_a_vehicle_that_hovers_there() -> None:
    there = VehicleView(1, None, (RELATIVE,), (10.0, 0.0, -8.0))
    moving = replace(HERE, vel_uav_ned_mps=(3.0, 0.0, 0.0))
    status = replace(a_status(StatusCode.IDLE), armed=False, landed=True, battery=Battery(voltage_v=15.0))
    box: dict[str, Any] = {ODOMETRY.name: moving, STATUS.name: status, RELATIVE.name: relative_estimate()}
    supposed = there.odometry(Box(**box))  # type: ignore[arg-type]
    assert supposed is not None
    assert (supposed.pos_uav_ned_m, supposed.vel_uav_ned_mps) == ((10.0, 0.0, -8.0), (0.0, 0.0, 0.0))
    found = state(there, box, supposed)
    assert (found.armed, found.landed, found.battery) == (True, False, None)
    assert found.relative is not None
    assert found.relative.pos_uav_rel_rover_ned_m == pytest.approx((10.0, -2.0, -10.0)), "9 m, -2 m and -5 m farther"
    assert found.relative.vel_uav_rel_rover_ned_mps == (-0.5, 0.3, -0.1)


def test_the_status_of_a_vehicle_that_is_supposed_to_hover_elsewhere_is_ready_to_fly_there() -> None:
    moving = replace(HERE, vel_uav_ned_mps=(3.0, 0.0, 0.0), reset_counter=2)
    standing = replace(a_status(StatusCode.IDLE), odometry=moving, ready=False, not_ready_reason="no GNSS")
    supposed = hovering_at(standing, (10.0, 0.0, -8.0))
    assert (supposed.code, supposed.name, supposed.armed, supposed.landed) == (3, "HOVER", True, False)
    assert (supposed.ready, supposed.not_ready_reason) == (True, "")
    assert supposed.odometry == replace(moving, pos_uav_ned_m=(10.0, 0.0, -8.0), vel_uav_ned_mps=(0.0, 0.0, 0.0))
    assert hovering_at(replace(standing, odometry=None), (10.0, 0.0, -8.0)).odometry is None


def test_a_plan_from_elsewhere_takes_the_position_of_the_status_until_odometry_comes() -> None:
    there = VehicleView(1, None, (RELATIVE,), (10.0, 0.0, -8.0))
    status = replace(a_status(StatusCode.HOVER), odometry=HERE)
    found = state(there, {STATUS.name: status, RELATIVE.name: relative_estimate()})
    assert found.relative is not None
    assert found.relative.pos_uav_rel_rover_ned_m == pytest.approx((10.0, -2.0, -10.0)), "9 m, -2 m and -5 m farther"


@pytest.mark.parametrize(
    ("age_s", "epoch_id", "known"), [(0.29, 1, True), (0.31, 1, False), (-0.31, 1, False), (0.1, 2, False)]
)
def test_estimates_that_are_old_or_of_another_epoch_are_none(age_s: float, epoch_id: int, known: bool) -> None:
    t_ns = T_NS - int(age_s * S)
    latest: dict[str, Any] = {
        RELATIVE.name: replace(relative_estimate(), t_ns=t_ns, epoch_id=epoch_id),
        ROVER_ESTIMATE.name: replace(rover_estimate(), t_ns=t_ns, epoch_id=epoch_id),
    }
    for inputs in ((RELATIVE,), (ROVER_ESTIMATE,)):
        found = state(VehicleView(1, None, inputs), latest)
        assert (found.relative is not None, found.rover is not None) == (known, known)
    found = state(VehicleView(1, None, (ALTIMETER,)), latest)
    assert (found.relative, found.rover) == (None, None), "the goal doesn't subscribe to them"


def test_after_a_pause_the_times_of_estimates_are_in_the_goals_own_time() -> None:
    latest: dict[str, Any] = {RELATIVE.name: relative_estimate(), ROVER_ESTIMATE.name: rover_estimate()}
    found = state(VehicleView(1, None, (RELATIVE,)), latest, behind_ns=7 * S)
    assert found.relative is not None and found.rover is not None
    assert (found.relative.t_ns, found.relative.fused_t_ns, found.rover.t_ns) == (
        T_NS - 7 * S,
        T_NS - 8 * S,
        T_NS - 7 * S,
    )
    found = state(VehicleView(1, None, (RELATIVE,)), latest, behind_ns=2 * T_NS)
    assert found.relative is not None and found.rover is not None
    assert (found.relative.t_ns, found.relative.fused_t_ns, found.rover.t_ns) == (0, 0, 0)


def relative_estimate() -> Relative:
    return Relative(
        t_ns=T_NS,
        epoch_id=1,
        valid=True,
        pos_uav_rel_rover_ned_m=(1.0, 0.0, -5.0),
        vel_uav_rel_rover_ned_mps=(2.5, 0.3, -0.1),
        cov=(0.0,) * 21,
        vel_rover_ned_mps=(0.5, -0.3, 0.1),
        yaw_rover_rad=0.0,
        yaw_rate_rover_rps=0.0,
        use_uwb=True,
        use_tag=True,
        fused_t_ns=T_NS - S,
    )


def rover_estimate(reset_offset_ned_m: Vec3 = (0.0, 0.0, 0.0)) -> RoverEstimate:
    return RoverEstimate(
        t_ns=T_NS,
        epoch_id=1,
        valid=True,
        pos_rover_ned_m=(7.0, 8.0, 0.0),
        vel_rover_ned_mps=(0.5, -0.3, 0.1),
        yaw_rover_rad=0.0,
        std_pos_m=1.0,
        reset_offset_ned_m=reset_offset_ned_m,
    )
