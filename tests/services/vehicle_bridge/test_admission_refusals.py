"""Refusals of hovers, releases and goals, from the status and the vehicle's state alone."""

from typing import Any

import pytest

from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.commands import Acquire, Hover, Release
from jezero.schemas.state import StatusCode
from jezero.services.vehicle_bridge.admission import (
    Grant,
    acquire_refusal,
    force_disarm_refusal,
    hover_refusal,
    leaves_limits,
    odometry_min_hz,
    release_refusal,
)
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot

S = 1_000_000_000
T_NS = 100 * S
ROBOT = VehicleConfig()
AIRBORNE: dict[str, Any] = {"armed": True, "pos_ned_m": (0.0, 0.0, -5.0)}


def vehicle(**fields: Any) -> VehicleSnapshot:
    return VehicleSnapshot(**{"t_ns": T_NS, "timer_ns": T_NS, **AIRBORNE, **fields})


def agrees(found: str, expected: str) -> bool:
    """Whether a refusal has the expected words, or there is none where "" is expected."""
    return expected in found if expected else found == ""


# -- hovers ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "fields", "killing", "expected"),
    [
        (StatusCode.HOVER, {}, False, ""),
        (StatusCode.GO_TO, {}, False, ""),
        (StatusCode.GO_TO, {"telemetry_age_s": 5.0}, False, ""),
        (StatusCode.GO_TO, {"landed": True}, False, ""),
        (StatusCode.ABORT, {}, False, ""),
        (StatusCode.ABORT, {"landed": True}, False, "stands on the ground and is being disarmed"),
        (StatusCode.LANDING_DONE, {}, False, "stands on the ground and is being disarmed"),
        (StatusCode.IDLE, {"armed": False}, False, "stands on the ground: take off first"),
        (
            StatusCode.IDLE,
            {"armed": None, "not_ready_reason": "no news"},
            False,
            "has not reported the vehicle's state",
        ),
        (StatusCode.IDLE, {"armed": None, "not_ready_reason": "no news"}, False, "yet: no news"),
        (StatusCode.EXTERNAL, {}, False, ""),
        (StatusCode.EXTERNAL, {"armed": False}, False, "in the air only, and the vehicle is under other command: why"),
        (StatusCode.EXTERNAL, {"armed": None}, False, "in the air only"),
        (StatusCode.EXTERNAL, {"landed": True}, False, "in the air only"),
        (StatusCode.EXTERNAL, {}, True, "in the air only"),
        (StatusCode.EXTERNAL, {"telemetry_age_s": 0.9}, False, ""),
        (StatusCode.EXTERNAL, {"telemetry_age_s": 1.14}, False, "without telemetry, which has been missing for 1.1 s"),
        (StatusCode.EXTERNAL, {"pos_ned_m": None}, False, "can't be taken back without telemetry"),
    ],
)
def test_a_vehicle_hovers_on_request_in_the_air_unless_its_motors_are_being_cut(
    code: StatusCode, fields: dict[str, Any], killing: bool, expected: str
) -> None:
    assert agrees(hover_refusal(Hover(), code, "why", killing, vehicle(**fields), ROBOT.limits), expected)


@pytest.mark.parametrize(
    ("pos_ned_m", "expected"),
    [
        ((0.0, 0.0, -0.6), ""),
        ((0.0, 0.0, -0.4), "z = -0.4 is 0.4 m up, below the limit of 0.5 m"),
        ((0.0, 0.0, 0.0), "z = 0 is not above the ground: z points down, 5 m up is −5"),
        ((0.0, 0.0, -119.0), ""),
        ((0.0, 0.0, -121.0), "121 m up is above the limit of 120 m"),
        ((300.0, 399.0, -5.0), ""),
        ((300.0, -401.0, -5.0), "501 m away is beyond the limit of 500 m"),
        ((0.0, float("nan"), -5.0), "is not a point"),
    ],
)
def test_a_hover_point_is_within_the_limits_of_the_vehicle(pos_ned_m: Vec3, expected: str) -> None:
    request = Hover(hover_pos=pos_ned_m)
    assert agrees(hover_refusal(request, StatusCode.HOVER, "", False, vehicle(), ROBOT.limits), expected)
    for code in (StatusCode.GO_TO, StatusCode.EXTERNAL):
        refusal = hover_refusal(request, code, "", False, vehicle(), ROBOT.limits)
        assert refusal.startswith("a hover point can be given only while hovering, and the vehicle ")


NEAR, FAR = Target((0.0, 0.0, -5.0), None, None, 0.0), Target((600.0, 0.0, -5.0), None, None, 0.0)
BY_VELOCITY = Target(None, (1.0, 0.0, 0.0), None, 0.0)


@pytest.mark.parametrize(
    ("before", "after", "leaves"),
    [
        (NEAR, NEAR, False),
        (NEAR, FAR, True),
        (FAR, FAR, False),
        (FAR, NEAR, False),
        (BY_VELOCITY, BY_VELOCITY, False),
        (BY_VELOCITY, FAR, True),
        (FAR, BY_VELOCITY, False),
    ],
)
def test_a_point_leaves_the_limits_once(before: Target, after: Target, leaves: bool) -> None:
    assert leaves_limits(before, after, ROBOT.limits) is leaves


# -- releases ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "then", "range_m", "expected"),
    [
        (StatusCode.GO_TO, "hover", None, ""),
        (StatusCode.GO_TO, "disarm", None, "a landing that succeeded ends with then=disarm, and nothing else does"),
        (StatusCode.GO_TO, "force_disarm", None, "a landing that succeeded ends with then=disarm"),
        (StatusCode.LANDING, "hover", None, "a landing that succeeded ends with then=disarm"),
        (StatusCode.LANDING, "disarm", 5.0, ""),
        (StatusCode.LANDING, "force_disarm", None, ""),
        (StatusCode.LANDING, "force_disarm", 5.0, "not disarmed by force: the altimeter measures 5.00 m"),
    ],
)
def test_only_a_landing_ends_with_a_disarm_and_by_force_only_without_a_height(
    code: StatusCode, then: Any, range_m: float | None, expected: str
) -> None:
    release = Release(control_id="c", outcome="succeeded", then=then)
    assert agrees(release_refusal(release, code, vehicle(range_m=range_m), ROBOT), expected)


@pytest.mark.parametrize(("above_m", "refused"), [(0.0, False), (0.09, False), (0.11, True)])
def test_motors_are_stopped_by_force_with_the_feet_up_to_a_tenth_of_a_metre_high_by_the_altimeter(
    above_m: float, refused: bool
) -> None:
    measured = vehicle(range_m=ROBOT.height_altimeter_m + above_m)
    assert bool(force_disarm_refusal(measured, ROBOT)) is refused


# -- goals -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("action", "code", "fields", "expected"),
    [
        ("go_to", StatusCode.HOVER, {}, ""),
        ("go_to", StatusCode.HOVER, {"telemetry_age_s": 0.9}, ""),
        ("go_to", StatusCode.HOVER, {"telemetry_age_s": 1.14}, "telemetry has been missing for 1.1 s: wait for it"),
        ("takeoff", StatusCode.IDLE, {"armed": False}, ""),
        ("takeoff", StatusCode.IDLE, {"armed": False, "not_ready_reason": "no GNSS"}, "not ready to take off: no GNSS"),
        ("land_on_spot", StatusCode.IDLE, {"armed": False}, "land on spot needs a hovering vehicle"),
        ("return_home", StatusCode.IDLE, {"armed": False}, "return home needs a hovering vehicle"),
        ("go_to", StatusCode.EXTERNAL, {}, "the vehicle is under other command: why. Wait until it is disarmed"),
        ("go_to", StatusCode.ABORT, {}, "and the vehicle aborts: try again when that has changed"),
        ("takeoff", StatusCode.LANDING_DONE, {}, "goals are accepted on the ground and in a hover only"),
    ],
)
def test_a_goal_is_refused_in_the_wrong_status_and_without_what_it_needs(
    action: str, code: StatusCode, fields: dict[str, Any], expected: str
) -> None:
    for do_takeoff in (False, True) if action != "go_to" else (False,):
        request = Acquire(goal_id="g", action=action, do_takeoff=do_takeoff)
        assert agrees(acquire_refusal(request, code, None, "why", vehicle(**fields)), expected)


@pytest.mark.parametrize(
    ("action", "code", "hz", "begin", "end"),
    [
        (
            "takeoff",
            StatusCode.IDLE,
            7.0,
            "odometry comes at 7 Hz over udp, and takeoff needs 8 Hz: ",
            "better network",
        ),
        ("takeoff", StatusCode.IDLE, 9.0, "", ""),
        ("go_to", StatusCode.HOVER, 9.0, "", ""),
        ("land_on_spot", StatusCode.HOVER, 14.0, "odometry comes at 14 Hz", ". jezero return lands with 8 Hz"),
        ("land_on_spot", StatusCode.HOVER, 16.0, "", ""),
        ("land_on_spot", StatusCode.HOVER, None, "", ""),
    ],
)
def test_a_goal_is_refused_where_odometry_comes_too_rarely_for_it_and_in_the_air_with_a_way_down(
    action: str, code: StatusCode, hz: float | None, begin: str, end: str
) -> None:
    measured = vehicle(armed=code is StatusCode.HOVER, odometry_hz=hz, line="udp")
    refusal = acquire_refusal(Acquire(goal_id="g", action=action), code, None, "", measured)
    assert refusal.startswith(begin) and refusal.endswith(end) and bool(refusal) is bool(begin)


def test_who_is_in_charge_is_the_first_reason_of_a_refusal() -> None:
    holder = Grant("c", "other", "get_images", (), T_NS)
    request = Acquire(goal_id="g", action="takeoff")
    refusal = acquire_refusal(request, StatusCode.GET_IMAGES, holder, "", vehicle())
    assert refusal == "the goal get images is in charge: wait for it or abort it"


def test_an_action_of_a_package_needs_the_odometry_of_any_flight_and_a_landing_on_the_rover_more() -> None:
    assert odometry_min_hz("somersault") == odometry_min_hz("go_to") == 8.0
    assert odometry_min_hz("land_on_spot") == 15.0
