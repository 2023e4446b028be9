"""Where the autopilot goes by itself when it lands, with a position or without, and when it meets an edge."""

import pytest

from jezero.base.frames import Vec3
from jezero.services.autopilot.config import ControlConfig, NavigatorConfig
from jezero.services.autopilot.control import Kinematics
from jezero.services.autopilot.modes import Mode
from jezero.services.autopilot.navigator import Navigator

LEANS_EAST = (0.0, 0.2)
S = 1_000_000


def at(north_m: float, east_m: float, down_m: float) -> Kinematics:
    still: Vec3 = (0.0, 0.0, 0.0)
    return Kinematics((north_m, east_m, down_m), still, still, 0.0)


def landing() -> Navigator:
    navigator = Navigator(NavigatorConfig(), ControlConfig())
    navigator.activate(Mode.LAND, at(1.0, 2.0, -0.5), (1.0, 2.0, -0.5), 0)
    return navigator


def test_it_goes_up_and_to_where_it_leans_and_lands_there() -> None:
    navigator = landing()
    assert navigator.leave_contact(Mode.LAND, at(1.0, 2.0, -0.5), LEANS_EAST, 0)
    assert navigator.setpoint(Mode.LAND, at(1.0, 2.0, -0.5), S).pos_ned_m == (1.0, 3.0, -1.0)
    setpoint = navigator.setpoint(Mode.LAND, at(1.0, 2.9, -1.0), 2 * S)
    assert setpoint.pos_ned_m == (1.0, 3.0, None)
    assert setpoint.vel_ned_mps[2] == ControlConfig().mpc_land_speed_mps


def test_it_lands_where_it_is_when_it_does_not_get_there() -> None:
    navigator = landing()
    navigator.leave_contact(Mode.LAND, at(1.0, 2.0, -0.5), LEANS_EAST, 0)
    assert navigator.setpoint(Mode.LAND, at(1.0, 2.0, -0.5), 3_900_000).pos_ned_m[2] is not None
    assert navigator.setpoint(Mode.LAND, at(1.0, 2.0, -0.5), 4_000_000).pos_ned_m[2] is None


def test_it_tries_three_times_for_each_landing() -> None:
    navigator, here = landing(), at(1.0, 2.0, -0.5)
    assert [navigator.leave_contact(Mode.LAND, here, LEANS_EAST, 5 * S * k) for k in range(4)] == [
        True,
        True,
        True,
        False,
    ]
    navigator.activate(Mode.LAND, here, here.pos_ned_m, 0)
    assert navigator.leave_contact(Mode.LAND, here, LEANS_EAST, 30 * S)


def test_it_does_not_try_again_on_its_way() -> None:
    navigator, here = landing(), at(1.0, 2.0, -0.5)
    assert navigator.leave_contact(Mode.LAND, here, LEANS_EAST, 0)
    assert not navigator.leave_contact(Mode.LAND, here, LEANS_EAST, S)


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.TAKEOFF, Mode.RETURN, Mode.OFFBOARD])
def test_who_does_not_land_leaves_the_edge_and_goes_on(mode: Mode) -> None:
    navigator, here = landing(), at(1.0, 2.0, -0.5)
    navigator.activate(mode, here, here.pos_ned_m, 0)
    before = navigator.setpoint(mode, here, 0)
    assert all(navigator.leave_contact(mode, here, LEANS_EAST, S * k) for k in range(5))
    assert navigator.setpoint(mode, here, 0) == before


def test_without_a_position_it_goes_there_by_velocity_and_stops() -> None:
    """Its velocity is wrong by 0.3 m/s: it stands when it leans over the edge."""
    navigator = Navigator(NavigatorConfig(), ControlConfig())
    here = Kinematics((1.0, 2.0, -0.5), (0.3, 0.0, 0.1), (0.0, 0.0, 0.0), 0.0)
    navigator.activate(Mode.DESCEND, here, here.pos_ned_m, 0)
    assert navigator.leave_contact(Mode.DESCEND, here, LEANS_EAST, 0)
    assert navigator.setpoint(Mode.DESCEND, here, S).vel_ned_mps == pytest.approx((0.3, 0.4, -0.2))
    assert navigator.setpoint(Mode.DESCEND, here, 3 * S).vel_ned_mps == (0.3, 0.0, 0.0)
    setpoint = navigator.setpoint(Mode.DESCEND, here, 5 * S)
    assert setpoint.vel_ned_mps == (None, None, ControlConfig().mpc_land_speed_mps)
    assert setpoint.pos_ned_m == (None, None, None)


def test_losing_its_position_it_brakes_and_then_keeps_its_lean() -> None:
    control = ControlConfig(mpc_acc_hor_mps2=2.0, mpc_xy_vel_p_acc=4.0)
    navigator, still = Navigator(NavigatorConfig(), control), (0.0, 0.0, 0.0)
    down_mps = control.mpc_land_speed_mps
    fast, slow = (Kinematics(still, (north_mps, 0.0, 0.0), still, 0.0) for north_mps in (3.0, 0.4))
    navigator.activate(Mode.DESCEND, fast, still, 10 * S)
    assert navigator.setpoint(Mode.DESCEND, fast, 10 * S).vel_ned_mps == pytest.approx((2.5, 0.0, down_mps))
    assert navigator.setpoint(Mode.DESCEND, slow, 12 * S).vel_ned_mps == (0.0, 0.0, down_mps)
    assert navigator.setpoint(Mode.DESCEND, fast, 14 * S).vel_ned_mps == (None, None, down_mps)


def test_losing_its_position_in_hover_it_keeps_its_lean() -> None:
    navigator, still = Navigator(NavigatorConfig(), ControlConfig()), (0.0, 0.0, 0.0)
    hovers = Kinematics(still, (0.1, 0.1, 0.0), still, 0.0)
    navigator.activate(Mode.DESCEND, hovers, still, 10 * S)
    assert navigator.setpoint(Mode.DESCEND, hovers, 10 * S).vel_ned_mps[:2] == (None, None)


def test_without_a_position_who_slides_does_not_leave() -> None:
    navigator = Navigator(NavigatorConfig(), ControlConfig())
    here = Kinematics((1.0, 2.0, -0.5), (2.0, 0.0, 0.1), (0.0, 0.0, 0.0), 0.0)
    navigator.activate(Mode.DESCEND, here, here.pos_ned_m, 0)
    assert not navigator.leave_contact(Mode.DESCEND, here, LEANS_EAST, 0)


def test_the_place_aside_moves_along_with_the_estimate() -> None:
    navigator = landing()
    navigator.leave_contact(Mode.LAND, at(1.0, 2.0, -0.5), LEANS_EAST, 0)
    navigator.on_position_reset((10.0, 0.0, 0.0))
    assert navigator.setpoint(Mode.LAND, at(11.0, 2.0, -0.5), S).pos_ned_m == (11.0, 3.0, -1.0)
