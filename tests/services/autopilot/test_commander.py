"""Arming, modes, failsafes and the land detector, row by row."""

import pytest
from msgspec.structs import replace

from jezero.services.autopilot.commander import Commander, CommanderState
from jezero.services.autopilot.config import CommanderConfig, FailsafeConfig, LandDetectorConfig
from jezero.services.autopilot.land_detector import LandDetector
from jezero.services.autopilot.modes import Mode

READY = CommanderState(
    t_us=10_000_000,
    arming_refusal="",
    position_invalid_reason="",
    offboard_setpoint_age_s=0.02,
    landed=True,
    tilt_rad=0.0,
)


def at(t_s: float, **changes: object) -> CommanderState:
    return replace(READY, t_us=int(t_s * 1e6), **changes)


def armed(mode: Mode = Mode.OFFBOARD) -> Commander:
    commander = Commander(CommanderConfig(), FailsafeConfig())
    assert commander.set_mode(mode, READY) == ""
    assert commander.arm(READY) == ""
    commander.pop_status_texts()
    return commander


def status_texts(commander: Commander) -> str:
    return " / ".join(text for _, text in commander.pop_status_texts())


def test_a_vehicle_that_is_not_ready_is_not_armed_and_says_why() -> None:
    commander = Commander(CommanderConfig(), FailsafeConfig())
    assert commander.arm(replace(READY, arming_refusal="no GNSS fix yet")) == "no GNSS fix yet"
    assert not commander.armed
    assert status_texts(commander) == "Arming denied: no GNSS fix yet"


@pytest.mark.parametrize(
    ("mode", "offboard_setpoint_age_s", "position_invalid_reason", "refusal"),
    [
        (Mode.OFFBOARD, 0.1, "", ""),
        (Mode.OFFBOARD, 0.6, "", "no offboard setpoints"),
        (Mode.OFFBOARD, float("inf"), "", "no offboard setpoints"),
        (Mode.OFFBOARD, 0.1, "no GNSS fix yet", "no GNSS fix yet"),
        (Mode.HOLD, float("inf"), "", ""),
        (Mode.HOLD, 0.1, "no GNSS fix yet", "no GNSS fix yet"),
        (Mode.LAND, float("inf"), "", ""),
        (Mode.POSITION, float("inf"), "", ""),
    ],
)
def test_modes_are_entered_only_with_what_they_need(
    mode: Mode, offboard_setpoint_age_s: float, position_invalid_reason: str, refusal: str
) -> None:
    commander = Commander(CommanderConfig(), FailsafeConfig())
    now = replace(
        READY, offboard_setpoint_age_s=offboard_setpoint_age_s, position_invalid_reason=position_invalid_reason
    )
    assert commander.set_mode(mode, now) == refusal
    assert commander.mode is (Mode.HOLD if refusal else mode)


def test_offboard_without_setpoints_is_not_armed() -> None:
    commander = Commander(CommanderConfig(), FailsafeConfig())
    commander.set_mode(Mode.OFFBOARD, READY)
    assert "without setpoints" in commander.arm(replace(READY, offboard_setpoint_age_s=0.6))


def test_land_mode_is_not_armed() -> None:
    commander = Commander(CommanderConfig(), FailsafeConfig())
    commander.set_mode(Mode.LAND, READY)
    assert "land" in commander.arm(READY)


def test_a_disarm_in_the_air_is_refused_unless_forced() -> None:
    commander = armed()
    flying = at(11.0, landed=False)
    assert commander.disarm(flying, force=False) == "not landed"
    assert commander.armed
    assert commander.disarm(flying, force=True) == ""
    assert not commander.armed


def test_lost_setpoints_land_the_vehicle_after_a_second_and_not_before() -> None:
    commander = armed()
    commander.update(at(11.0, landed=False, offboard_setpoint_age_s=0.99))
    assert (commander.mode, commander.failsafe) == (Mode.OFFBOARD, False)
    commander.update(at(11.1, landed=False, offboard_setpoint_age_s=1.01))
    assert (commander.mode, commander.failsafe) == (Mode.LAND, True)
    assert "offboard setpoints lost" in status_texts(commander)


def test_setpoints_that_come_back_do_not_end_the_failsafe() -> None:
    commander = armed()
    commander.update(at(11.0, landed=False, offboard_setpoint_age_s=1.5))
    commander.update(at(12.0, landed=False, offboard_setpoint_age_s=0.01))
    assert (commander.mode, commander.failsafe) == (Mode.LAND, True)
    assert commander.set_mode(Mode.OFFBOARD, at(12.1, landed=False)) == ""
    assert (commander.mode, commander.failsafe) == (Mode.OFFBOARD, False)


def test_after_landing_it_disarms_by_itself_in_two_seconds_and_can_be_armed_again() -> None:
    commander = armed()
    commander.update(at(11.0, landed=False, offboard_setpoint_age_s=1.5))
    commander.update(at(15.0))
    commander.update(at(16.9))
    assert commander.armed
    commander.update(at(17.1))
    assert (commander.armed, commander.mode) == (False, Mode.HOLD)
    assert commander.arm(at(18.0)) == ""


def test_after_a_landing_on_request_it_can_be_armed_again() -> None:
    commander = armed()
    commander.update(at(11.0, landed=False))
    commander.set_mode(Mode.LAND, at(12.0, landed=False))
    commander.disarm(at(15.0), force=False)
    assert commander.mode is Mode.HOLD
    assert commander.arm(at(16.0)) == ""


def test_armed_without_taking_off_it_disarms_after_ten_seconds() -> None:
    commander = armed()
    commander.update(at(10.5))
    commander.update(at(20.4))
    assert commander.armed
    commander.update(at(20.6))
    assert not commander.armed


@pytest.mark.parametrize(("tilted_s", "stays_armed"), [(0.4, True), (0.6, False)])
def test_tilting_too_far_for_half_a_second_stops_the_motors(tilted_s: float, stays_armed: bool) -> None:
    commander = armed()
    commander.update(at(11.0, landed=False))
    commander.update(at(11.0 + tilted_s, landed=False, tilt_rad=1.1))
    assert commander.armed is stays_armed


def test_what_has_been_said_is_said_once() -> None:
    commander = armed()
    commander.disarm(READY, force=False)
    assert status_texts(commander) == "Disarmed by external command"
    assert status_texts(commander) == ""


# -- land detector -------------------------------------------------------------------------------------------

STILL = (0.0, 0.0, 0.0)


def run(detector: LandDetector, seconds: float, **state: object) -> None:
    arguments: dict[str, object] = {
        "vel_ned_mps": STILL, "rates_frd_rps": STILL, "vel_setpoint_down_mps": 0.7, "thrust_hover_ratio": 0.1, **state
    }  # fmt: skip
    for _ in range(round(seconds / 0.01)):
        detector.step(0.01, **arguments)  # type: ignore[arg-type]


def flying() -> LandDetector:
    detector = LandDetector(LandDetectorConfig())
    detector.on_takeoff()
    return detector


def test_a_vehicle_that_is_held_down_for_about_a_second_has_landed() -> None:
    detector = flying()
    run(detector, 0.9)
    assert detector.contact and not detector.landed
    run(detector, 0.2)
    assert detector.landed


@pytest.mark.parametrize(
    "state",
    [
        {"vel_ned_mps": (0.0, 0.0, 0.3)},
        {"vel_ned_mps": (1.2, 1.0, 0.0)},
        {"rates_frd_rps": (0.0, 0.0, 0.4)},
        {"rates_frd_rps": (0.03, 0.03, 0.0)},
        {"thrust_hover_ratio": 0.9},
        {"thrust_hover_ratio": 0.9, "vel_setpoint_down_mps": 0.0},
        {"thrust_hover_ratio": 0.9, "vel_setpoint_down_mps": 0.3, "vel_ned_mps": (0.0, 0.0, 0.22)},
    ],
)
def test_a_vehicle_that_moves_turns_or_pulls_has_not_landed(state: dict[str, object]) -> None:
    detector = flying()
    run(detector, 5.0, **state)
    assert not detector.landed


def test_a_vehicle_that_a_rover_turns_has_landed() -> None:
    detector = flying()
    run(detector, 1.1, rates_frd_rps=(0.01, -0.01, 0.2))
    assert detector.landed


def test_a_vehicle_that_shall_climb_is_not_held_down_by_its_own_low_thrust() -> None:
    detector = flying()
    run(detector, 0.9)
    run(detector, 0.01, vel_setpoint_down_mps=-0.5)
    assert not detector.contact
    run(detector, 5.0, vel_setpoint_down_mps=-0.5)
    assert not detector.landed


def test_a_slow_descent_is_no_contact() -> None:
    detector = flying()
    run(detector, 5.0, thrust_hover_ratio=1.0, vel_setpoint_down_mps=0.3, vel_ned_mps=(0.0, 0.0, 0.2))
    assert not detector.contact


def test_movement_starts_the_count_over() -> None:
    detector = flying()
    for _ in range(10):
        run(detector, 0.8)
        run(detector, 0.05, vel_ned_mps=(0.0, 0.0, 0.4))
    assert not detector.landed


def test_what_keeps_it_up_for_longer_than_a_bump_touches_it_until_a_moment_after() -> None:
    detector = flying()
    touching = []
    for seconds, vel_down_mps in ((0.15, 0.0), (0.1, 0.0), (0.15, 0.6), (0.1, 0.6)):
        run(detector, seconds, vel_ned_mps=(0.0, 0.0, vel_down_mps))
        touching.append(detector.touching)
    assert touching == [False, True, True, False]
