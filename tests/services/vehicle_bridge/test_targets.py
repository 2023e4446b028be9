"""What the bridge makes of a setpoint, of a hover, and of a way back inside the fence: numbers by hand."""

from math import nan
from typing import Any

import pytest

from jezero.base.frames import Vec3
from jezero.schemas.commands import Hover, Phase, Release, Setpoint
from jezero.schemas.state import StatusCode
from jezero.services.vehicle_bridge.admission import Grant
from jezero.services.vehicle_bridge.authority import (
    hover_target,
    released_target,
    setpoint_refusal,
    setpoint_target,
    stopping_target,
)
from jezero.services.vehicle_bridge.motion_limits import inward_target
from jezero.services.vehicle_bridge.vehicle import ResetHistory, Target, VehicleSnapshot

S = 1_000_000_000
T_NS = 10 * S


def vehicle(**fields: Any) -> VehicleSnapshot:
    return VehicleSnapshot(**{"t_ns": T_NS, "timer_ns": T_NS, "pos_ned_m": (0.0, 0.0, -5.0), "height_m": 5.0, **fields})


def setpoint(**fields: Any) -> Setpoint:
    given = {"t_ns": T_NS, "control_id": "c", "sequence": 8, "phase": Phase.GO_TO, "pos_ned_m": (1.0, 2.0, -3.0)}
    return Setpoint(**{**given, "reset_counter": 4, **fields})


def resets() -> ResetHistory:
    """A position that was moved 2 m north between the counters 3 and 4."""
    history = ResetHistory()
    history.update(0, 3, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    history.update(S, 4, (2.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    return history


def grant(*phases: Phase) -> Grant:
    return Grant("c", "g", "go_to", phases or (Phase.GO_TO,), T_NS, sequence=7)


@pytest.mark.parametrize(
    ("fields", "refusal"),
    [
        ({}, ""),
        ({"control_id": "another"}, "its control is not in charge"),
        ({"sequence": 7}, "sequence 7 after 7"),
        ({"t_ns": T_NS - 3 * S // 10}, ""),
        ({"t_ns": T_NS - 3 * S // 10 - 1}, "0.300 s old; accepted are -0.05 to 0.3 s"),
        ({"t_ns": T_NS + S // 20}, ""),
        ({"t_ns": T_NS + S // 20 + 1}, "-0.050 s old"),
        ({"phase": Phase.TAKEOFF}, "the phase takeoff of the goal go to while the vehicle "),
        ({"phase": Phase.LANDING}, "the phase landing of the goal go to while the vehicle hovers"),
        ({"pos_ned_m": None}, "neither a position nor a velocity"),
        ({"pos_ned_m": None, "vel_ned_mps": (1.0, 0.0, 0.0)}, ""),
        ({"pos_ned_m": None, "vel_ned_mps": (1.0, 0.0, 0.0), "reset_counter": 9}, ""),
        ({"reset_counter": 3}, ""),
        ({"reset_counter": 9}, "reset counter 9 is unknown; the present one is 4"),
        ({"pos_ned_m": (1.0, nan, 0.0)}, "a number that is not finite"),
        ({"acc_ned_mps2": (0.0, 0.0, nan)}, "a number that is not finite"),
        ({"yaw_rad": nan}, "a number that is not finite"),
        ({"yaw_rate_rps": nan}, "a number that is not finite"),
    ],
)
def test_a_setpoint_is_flown_when_it_is_the_owners_young_and_in_a_phase_of_its_goal(
    fields: dict[str, Any], refusal: str
) -> None:
    found = setpoint_refusal(setpoint(**fields), StatusCode.HOVER, grant(), vehicle(), resets())
    assert found.startswith(refusal) and bool(found) is bool(refusal)
    assert setpoint_refusal(setpoint(**fields), StatusCode.HOVER, None, vehicle(), resets())


@pytest.mark.parametrize(
    ("counter", "pos_ned_m"), [(4, (1.0, 2.0, -3.0)), (3, (3.0, 2.0, -3.0)), (9, (1.0, 2.0, -3.0))]
)
def test_a_setpoint_from_before_a_reset_moves_along_with_the_position(counter: int, pos_ned_m: Vec3) -> None:
    made = setpoint(reset_counter=counter, vel_ned_mps=(0.5, 0.0, 0.0), yaw_rad=0.7, yaw_rate_rps=0.1)
    assert setpoint_target(made, None, vehicle(), resets()) == Target(pos_ned_m, (0.5, 0.0, 0.0), None, 0.7, 0.1)
    before = Target(None, None, None, 0.4)
    assert setpoint_target(setpoint(), before, vehicle(), resets()).yaw_rad == 0.4, "without a heading it stays"


@pytest.mark.parametrize(
    ("vel_ned_mps", "height_m", "stops_ned_m"),
    [
        ((2.0, -4.0, 0.0), 5.0, (1.0, -2.0, -5.0)),
        ((0.0, 0.0, 2.0), 5.0, (0.0, 0.0, -4.0)),
        ((0.0, 0.0, 2.0), 1.4, (0.0, 0.0, -4.6)),
        ((0.0, 0.0, 2.0), 0.5, (0.0, 0.0, -5.0)),
        ((0.0, 0.0, 2.0), None, (0.0, 0.0, -5.0)),
        ((0.0, 0.0, -2.0), 0.5, (0.0, 0.0, -6.0)),
    ],
)
def test_a_hover_begins_where_the_vehicle_comes_to_rest_and_a_descent_a_metre_above_the_ground(
    vel_ned_mps: Vec3, height_m: float | None, stops_ned_m: Vec3
) -> None:
    """Half a second of the velocity."""
    stopping = stopping_target(Target(None, None, None, 0.4), vehicle(vel_ned_mps=vel_ned_mps, height_m=height_m))
    assert stopping.pos_ned_m == pytest.approx(stops_ned_m)
    assert stopping.vel_ned_mps is None and stopping.yaw_rad == 0.4


def test_a_hover_is_at_the_requested_point_or_where_the_vehicle_stops() -> None:
    stopping = Target((1.0, 1.0, -2.0), None, None, 0.4)
    assert hover_target(Hover(), stopping) == (stopping, "hovering here")
    target, text = hover_target(Hover(hover_pos=(3.0, 4.0, -5.0)), stopping)
    assert (target, text) == (Target((3.0, 4.0, -5.0), None, None, 0.4), "hovering at (3.00, 4.00, -5.00)")


@pytest.mark.parametrize(
    ("counter", "hover_pos_ned_m", "expected_m"),
    [
        (4, (5.0, 0.0, -3.0), (5.0, 0.0, -3.0)),
        (3, (5.0, 0.0, -3.0), (7.0, 0.0, -3.0)),
        (9, (5.0, 0.0, -3.0), (1.0, 1.0, -2.0)),
        (4, None, (1.0, 1.0, -2.0)),
    ],
)
def test_the_hover_after_a_goal_is_its_point_moved_by_resets_since(
    counter: int, hover_pos_ned_m: Vec3 | None, expected_m: Vec3
) -> None:
    release = Release(control_id="c", outcome="succeeded", hover_pos_ned_m=hover_pos_ned_m, reset_counter=counter)
    stopping = Target((1.0, 1.0, -2.0), None, None, 0.4)
    assert released_target(release, stopping, resets()) == Target(expected_m, None, None, 0.4)


HERE, INSIDE = (10.0, 0.0, -5.0), (4.0, 0.0, -5.0)


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        (Target(HERE, None, None, 0.0), Target((9.0, 0.0, -5.0), None, None, 0.0)),
        (Target((12.0, 3.0, -5.0), None, None, 0.0), Target((9.0, 3.0, -5.0), None, None, 0.0)),
        (Target((8.5, 0.0, -5.0), None, None, 0.0), None),
        (Target(None, (0.0, 2.0, 0.0), None, 0.0), Target(None, (-1.0, 2.0, 0.0), None, 0.0)),
        (Target(None, (3.0, 0.0, 0.0), None, 0.0), Target(None, (-1.0, 0.0, 0.0), None, 0.0)),
        (Target(None, (-2.0, 0.0, 0.0), None, 0.0), None),
        (Target((10.5, 0.0, -5.0), (-1.6, 0.0, 0.0), None, 0.0), None),
    ],
)
def test_a_target_outside_the_fence_leads_in_with_a_metre_per_second_at_least(
    target: Target, expected: Target | None
) -> None:
    found = inward_target(target, HERE, INSIDE)
    assert found is target if expected is None else found == expected


def test_close_to_the_fence_a_target_leads_in_more_slowly_and_not_at_all_at_the_point_inside() -> None:
    waits = Target(HERE, None, None, 0.0)
    assert inward_target(waits, HERE, (9.8, 0.0, -5.0)).pos_ned_m == pytest.approx((9.8, 0.0, -5.0))
    assert inward_target(waits, HERE, HERE) is waits
