"""The monitor of a flight: when something holds a vehicle near the ground, and when it only looks so; time-outs."""

from math import radians
from typing import Any

import pytest
from msgspec.structs import replace

from jezero.base.frames import quat_from_euler
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.units import NS_PER_S
from jezero.services.vehicle_bridge.flight_monitor import Disarming, EngagementTimer, FlightMonitor
from jezero.services.vehicle_bridge.vehicle import OFFBOARD, AutopilotCommand, Target, VehicleSnapshot

CLIMB = Target(None, (0.0, 0.0, -1.0), None, 0.0)
PUSH = Target(None, (0.0, 0.0, 0.5), None, 0.0)
BEGIN_S = 7.0


def at(
    seconds: float,
    *,
    tilt_rad: float = 0.1,
    height_m: float = 0.4,
    speed_mps: float = 0.0,
    mode: str = OFFBOARD,
    telemetry_age_s: float = 0.0,
    armed: bool = True,
    landed: bool = False,
) -> VehicleSnapshot:
    return VehicleSnapshot(
        t_ns=int(seconds * NS_PER_S),
        timer_ns=int(seconds * NS_PER_S),
        armed=armed,
        landed=landed,
        pos_ned_m=(0.0, 0.0, -height_m),
        vel_ned_mps=(speed_mps, 0.0, 0.0),
        q_ned_from_frd=quat_from_euler(tilt_rad, 0.0, 0.0),
        height_m=height_m,
        mode=mode,
        telemetry_age_s=telemetry_age_s,
    )


def reason_after(seconds: float, target: Target | None = CLIMB, *, flying: bool = True, **vehicle: Any) -> str:
    """Reason to cut the motors of a vehicle that has been in the same state for this time; its timer began before."""
    monitor = FlightMonitor(router_timeout_s=10.0)
    monitor.update(at(BEGIN_S), None, flying=False)
    for tenth in range(1, round(10 * seconds) + 1):
        monitor.update(at(BEGIN_S + tenth / 10, **vehicle), target, flying=flying)
    return monitor.kill_reason(at(BEGIN_S + seconds, **vehicle))


@pytest.mark.parametrize(
    "target",
    [
        CLIMB,
        Target(None, (0.4, 0.0, 0.0), None, 0.0),
        Target((0.0, 0.0, -3.0), None, None, 0.0),
        Target((0.0, 0.0, -1.0), (0.0, 0.0, 0.0), None, 0.0),
    ],
    ids=["climb", "sideways", "position", "a path that waits for the vehicle"],
)
def test_a_vehicle_near_the_ground_that_does_not_move_to_its_target_is_wedged(target: Target) -> None:
    assert reason_after(4.5, target) == ""
    reason = reason_after(5.5, target)
    assert reason.startswith("motors cut: the vehicle is wedged near the ground, tilted by 6 degrees, and has not")
    assert "free it from what holds it" in reason


def test_a_vehicle_that_hangs_below_the_edge_of_a_high_platform_is_wedged() -> None:
    assert "wedged near the ground" in reason_after(5.5, height_m=0.9)


@pytest.mark.parametrize(
    ("target", "vehicle"),
    [
        (CLIMB, {"height_m": 1.1}),
        (CLIMB, {"speed_mps": 0.15}),
        (CLIMB, {"mode": "POSCTL"}),
        (CLIMB, {"telemetry_age_s": 1.5}),
        (PUSH, {}),
        (Target((0.0, 0.0, 1.0), None, None, 0.0), {}),
        (Target((0.2, 0.0, -0.4), None, None, 0.0), {}),
        (Target(None, (0.2, 0.0, -0.2), None, 0.0), {}),
        (CLIMB, {"landed": True}),
        (CLIMB, {"armed": False}),
        (None, {}),
    ],
    ids=[
        "in the air",
        "moving slowly",
        "following somebody else",
        "telemetry missing",
        "pushed down on a slope",
        "pushed to a point below",
        "in place against the wind",
        "following slowly",
        "standing by the land detector",
        "with its motors off",
        "nothing commanded",
    ],
)
def test_what_only_looks_like_a_wedge_is_none(target: Target | None, vehicle: dict[str, Any]) -> None:
    assert reason_after(20.0, target, **vehicle) == ""


def test_a_vehicle_that_somebody_else_flies_is_left_alone() -> None:
    assert reason_after(20.0, flying=False) == ""


@pytest.mark.parametrize("unknown", ["pos_ned_m", "height_m"])
def test_a_vehicle_whose_place_is_unknown_is_not_known_to_be_wedged(unknown: str) -> None:
    monitor = FlightMonitor(router_timeout_s=10.0)
    for second in range(21):
        monitor.update(replace(at(second), **{unknown: None}), CLIMB, flying=True)
    assert monitor.kill_reason(at(20.0)) == ""


@pytest.mark.parametrize(
    ("seconds", "vehicle", "cut"),
    [
        (0.4, {"tilt_rad": radians(61.0)}, False),
        (0.6, {"tilt_rad": radians(61.0)}, True),
        (20.0, {"tilt_rad": radians(59.0)}, False),
        (20.0, {"tilt_rad": radians(61.0), "armed": False}, False),
        (2.4, {"tilt_rad": radians(61.0), "telemetry_age_s": 2.0}, False),
        (2.6, {"tilt_rad": radians(61.0), "telemetry_age_s": 2.0}, True),
    ],
    ids=["short", "long", "up to the limit", "with its motors off", "short by the last measurement", "long by it"],
)
def test_a_tilt_beyond_sixty_degrees_for_half_a_second_by_its_measurements_cuts_the_motors(
    seconds: float, vehicle: dict[str, Any], cut: bool
) -> None:
    reason = reason_after(seconds, None, **vehicle)
    assert reason == ("motors cut: tilted by 61 degrees for 0.5 s" if cut else "")


def test_a_tilt_of_a_vehicle_that_somebody_else_flies_cuts_no_motors() -> None:
    assert reason_after(20.0, None, flying=False, tilt_rad=radians(90.0)) == ""


def test_telemetry_that_is_missing_for_a_second_ends_a_goal_and_for_five_seconds_the_stream() -> None:
    monitor = FlightMonitor(router_timeout_s=10.0)
    ends = [bool(monitor.link_reason(at(9.0, telemetry_age_s=age_s))) for age_s in (0.9, 1.1)]
    blind = [bool(monitor.blind_reason(at(9.0, telemetry_age_s=age_s))) for age_s in (4.9, 5.1)]
    assert ends == blind == [False, True]
    assert monitor.link_reason(at(9.0, telemetry_age_s=1.14)) == "no telemetry for 1.1 s"
    reason = monitor.blind_reason(at(9.0, telemetry_age_s=5.14))
    assert reason == "no telemetry for 5.1 s: left to the autopilot's failsafe"


@pytest.mark.parametrize(
    ("lost_s", "vehicle", "lands"),
    [
        (9.9, {}, False),
        (10.1, {}, True),
        (10.1, {"landed": True}, False),
        (10.1, {"armed": False}, False),
        (10.1, {"armed": False, "landed": True}, False),
    ],
)
def test_a_vehicle_in_the_air_lands_when_the_router_is_missing_for_the_set_time(
    lost_s: float, vehicle: dict[str, Any], lands: bool
) -> None:
    monitor = FlightMonitor(router_timeout_s=10.0)
    reason = monitor.router_reason(replace(at(60.0, **vehicle), router_lost_s=lost_s))
    assert reason == ("landing: the bus's router has been missing for 10 s" if lands else "")


def test_offboard_mode_is_commanded_after_a_fifth_of_a_second_of_stream_and_given_up_after_five_seconds() -> None:
    timer = EngagementTimer()
    timer.start(at(BEGIN_S))
    assert [timer.may_command(at(BEGIN_S + since_s)) for since_s in (0.0, 0.15, 0.25)] == [False, False, True]
    assert [timer.is_overdue(at(BEGIN_S + since_s)) for since_s in (0.0, 4.9, 5.1)] == [False, False, True]
    timer.start(at(BEGIN_S + 6.0))
    assert not timer.may_command(at(BEGIN_S + 6.1)), "a second flight has a stream of its own"
    assert not timer.is_overdue(at(BEGIN_S + 6.1))


@pytest.mark.parametrize(
    ("by_force", "landed", "range_m", "forced"),
    [
        (True, False, None, True),
        (True, False, 0.05, True),
        (True, False, 0.5, False),
        (True, True, None, False),
        (True, True, 0.5, False),
        (False, False, None, False),
        (False, True, None, False),
    ],
)
def test_motors_are_stopped_by_force_only_where_the_landing_alone_is_sure_of_the_ground(
    by_force: bool, landed: bool, range_m: float | None, forced: bool
) -> None:
    disarming = Disarming(VehicleConfig())
    disarming.by_force = by_force
    command = disarming.command(replace(at(0.0, landed=landed), range_m=range_m))
    assert command is (AutopilotCommand.FORCE_DISARM if forced else AutopilotCommand.DISARM)


def test_a_disarm_that_is_refused_for_ten_seconds_leaves_the_vehicle_to_the_autopilot_with_its_reason() -> None:
    disarming = Disarming(VehicleConfig())
    assert disarming.overdue_reason(at(0.0), 9.9) == ""
    reason = disarming.overdue_reason(replace(at(0.0), command_failure="disarming denied"), 10.1)
    assert reason == "the autopilot did not disarm within 10 s: disarming denied"
    assert disarming.overdue_reason(at(0.0), 10.1).endswith(": the autopilot gives no reason")
