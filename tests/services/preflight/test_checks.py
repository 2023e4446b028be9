"""The checks of autopilot, services, clock, battery and storage: each verdict with its words."""

from typing import Any

import pytest

from jezero.base.codec import decode, encode
from jezero.schemas.fence import Fence, FenceState, Zone
from jezero.schemas.health import ServiceHealth
from jezero.schemas.preflight import Check
from jezero.schemas.state import Battery, StatusCode
from jezero.schemas.topics import CLOCK, FENCE, STATUS
from jezero.services.preflight.checks import (
    check_autopilot,
    check_battery,
    check_clock,
    check_fence,
    check_services,
    check_storage,
)
from jezero.services.preflight.service import CHECKS
from tests.services.preflight.healthy import clocks, health, readings, status


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_a_healthy_vehicle_passes(check: Any) -> None:
    outcome = check(readings())
    assert outcome.verdict == "passed", outcome.text
    assert f"check_{outcome.name}" == check.__name__


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_before_anything_has_been_heard_only_autopilot_and_clock_fail(check: Any) -> None:
    nothing = readings(
        dict.fromkeys(readings().messages, ()),
        health={},
        heard=frozenset(),
        heard_services=frozenset(),
        parameters=None,
    )
    outcome = check(nothing)
    assert (outcome.verdict == "failed") is (outcome.name in ("autopilot", "clock")), outcome.text


def test_an_autopilot_that_is_not_ready_fails_with_its_reason() -> None:
    waiting = status(ready=False, not_ready_reason="the autopilot has no position")
    outcome = check_autopilot(readings({STATUS.name: (waiting,)}))
    assert (outcome.verdict, outcome.text) == ("failed", "the autopilot has no position")


def test_an_autopilot_that_is_not_ready_without_a_reason_is_named_by_its_state() -> None:
    outcome = check_autopilot(readings({STATUS.name: (status(ready=False, code=int(StatusCode.EXTERNAL)),)}))
    assert (outcome.verdict, outcome.text) == ("failed", "the vehicle is under other command")


def test_a_flying_vehicle_passes_the_check_of_the_autopilot() -> None:
    flying = status(code=int(StatusCode.HOVER), autopilot_mode="OFFBOARD")
    assert "flies, in mode OFFBOARD" in check_autopilot(readings({STATUS.name: (flying,)})).text


def test_a_line_that_carries_too_little_for_a_landing_is_a_warning() -> None:
    narrow = health("vehicle_bridge", "degraded", "odometry comes at 10 Hz, and land on spot needs 15 Hz")
    outcome = check_autopilot(readings(health={**readings().health, "vehicle_bridge": narrow}))
    assert (outcome.verdict, outcome.text) == ("warning", narrow.text)
    others = check_services(readings(health={**readings().health, "vehicle_bridge": narrow}))
    assert others.verdict == "passed", "it is named once"
    flying = status(code=int(StatusCode.HOVER), autopilot_mode="OFFBOARD")
    ill = readings({STATUS.name: (flying,)}, health={**readings().health, "vehicle_bridge": narrow})
    assert check_autopilot(ill).verdict == "passed"


def without(*names: str) -> dict[str, ServiceHealth]:
    return {name: found for name, found in readings().health.items() if name not in names}


@pytest.mark.parametrize(
    ("changes", "verdict", "words"),
    [
        ({"health": without("estimator")}, "warning", "estimator is silent: the vehicle could not land on the rover"),
        (
            {"health": without("estimator"), "silent_services": frozenset({"estimator"})},
            "failed",
            "estimator is silent: the vehicle could not land on the rover",
        ),
        ({"health": without("mission"), "silent_services": frozenset({"mission"})}, "warning", "mission is silent"),
        (
            {"health": without("camera", "camera_driver"), "heard_services": frozenset()},
            "warning",
            "no camera runs: the vehicle could not land on the rover",
        ),
        (
            {"health": without("camera") | {"camera": health("camera", "degraded", "renders 4 of 15 images")}},
            "warning",
            "camera: renders 4 of 15 images",
        ),
    ],
)
def test_a_service_of_the_landing_that_is_silent_in_two_rounds_fails_and_all_else_warns(
    changes: dict[str, Any], verdict: str, words: str
) -> None:
    outcome = check_services(readings(**changes))
    assert outcome.verdict == verdict
    assert words in outcome.text


def test_a_verdict_of_many_services_is_no_longer_than_a_text_may_be() -> None:
    ill = {f"package{number}": health(f"package{number}", "degraded", "x" * 200) for number in range(20)}
    outcome = check_services(readings(health={**readings().health, **ill}))
    assert decode(Check, encode(outcome)) == outcome


@pytest.mark.parametrize("camera", ["camera", "camera_driver"])
def test_one_camera_is_enough_simulated_or_real(camera: str) -> None:
    assert check_services(readings(health=without(camera), heard_services=frozenset())).verdict == "passed"


@pytest.mark.parametrize(
    ("messages", "verdict", "words"),
    [
        ({CLOCK.name: clocks()[:1]}, "failed", "vehicle time stands still"),
        ({STATUS.name: (status(t_ns=4_200_000_000),)}, "failed", "the status is 0.80 s old on arrival"),
        ({STATUS.name: (status(t_ns=5_800_000_000),)}, "failed", "the status is -0.80 s old on arrival"),
        ({STATUS.name: (status(t_ns=5_300_000_000),)}, "passed", "the status is 0 ms old"),
        ({STATUS.name: ()}, "passed", "vehicle time runs at 100 % of wall time"),
        ({CLOCK.name: clocks()[:1] * 2}, "passed", "vehicle time runs at 100 % of wall time"),
        ({CLOCK.name: clocks()[:2]}, "passed", "vehicle time runs at 100 % of wall time"),
        ({CLOCK.name: clocks(rate=0.6)}, "warning", "this computer is too slow for the simulation"),
        ({CLOCK.name: clocks(rate=0.95)}, "passed", "95 % of wall time, the status is 50 ms old"),
    ],
)
def test_the_clock_must_go_on_with_young_messages_and_warns_when_it_is_slow(
    messages: dict[str, Any], verdict: str, words: str
) -> None:
    outcome = check_clock(readings(messages))
    assert outcome.verdict == verdict
    assert words in outcome.text


@pytest.mark.parametrize(
    ("battery", "verdict", "words"),
    [
        (
            Battery(voltage_v=14.0, remaining=0.07, critical=0.07),
            "failed",
            "7 %, 14.0 V; the autopilot ends a flight at",
        ),
        (Battery(voltage_v=14.4, remaining=0.21, critical=0.07), "warning", "enough for a short flight only"),
        (Battery(voltage_v=14.8, remaining=0.23, critical=0.07), "passed", "23 %, 14.8 V"),
        (Battery(voltage_v=14.8, remaining=0.05), "warning", "the level at which the autopilot returns is unknown"),
        (Battery(voltage_v=14.8), "warning", "the autopilot does not measure its charge"),
        (None, "warning", "the autopilot does not measure its charge"),
    ],
)
def test_the_battery_fails_at_its_critical_level(battery: Battery | None, verdict: str, words: str) -> None:
    outcome = check_battery(readings({STATUS.name: (status(battery=battery),)}))
    assert outcome.verdict == verdict
    assert words in outcome.text


@pytest.mark.parametrize(
    ("recorder", "verdict", "words"),
    [
        (health("recorder", room_bytes=49_000_000), "failed", "49 MB free for recordings: delete old ones"),
        (health("recorder", room_bytes=60_000_000), "warning", "0.1 GB free for recordings: delete old ones soon"),
        (health("recorder", room_bytes=1_500_000_000), "warning", "1.5 GB free for recordings"),
        (health("recorder", room_bytes=3_000_000_000), "passed", "3.0 GB free for recordings"),
        (health("recorder", "degraded", "not recording: it may not write"), "warning", "not recording"),
        (health("recorder", "degraded", "not recording: full", room_bytes=0), "failed", "0 MB free for recordings"),
        (health("recorder", text="nothing to record yet"), "passed", "nothing to record yet"),
        (None, "warning", "this flight is not recorded"),
    ],
)
def test_a_full_disk_fails_and_a_flight_without_a_recording_warns(
    recorder: ServiceHealth | None, verdict: str, words: str
) -> None:
    found = without("recorder") | ({"recorder": recorder} if recorder else {})
    outcome = check_storage(readings(health=found))
    assert outcome.verdict == verdict
    assert words in outcome.text


FIELD = Zone(name="field", corners_ned_m=((-10.0, -10.0), (-10.0, 10.0), (10.0, 10.0), (10.0, -10.0)))


@pytest.mark.parametrize(
    ("state", "verdict", "words"),
    [
        ({}, "passed", "no fence is set"),
        (
            {"fence": Fence(name="mars", keep_in=FIELD), "fence_id": "a"},
            "passed",
            "inside 'mars', 10.0 m from the edge of the area 'field' to stay in",
        ),
        ({"fence": Fence(ceiling_m=20.0), "fence_id": "a"}, "passed", "the vehicle is inside 'fence'"),
        (
            {"fence_id": "a", "outside": "3.0 m outside the area 'field' to stay in"},
            "failed",
            "3.0 m outside the area 'field' to stay in: carry it inside",
        ),
        ({"fence_id": "a"}, "warning", "waits for the vehicle's origin"),
        (
            {"fence": Fence(keep_in=FIELD), "fence_id": "a", "autopilot_failure": "it does not reply"},
            "warning",
            "the autopilot has not taken it: it does not reply",
        ),
    ],
)
def test_a_vehicle_outside_its_fence_fails(state: dict[str, Any], verdict: str, words: str) -> None:
    outcome = check_fence(readings({FENCE.name: (FenceState(t_ns=1, **state),)}))
    assert outcome.verdict == verdict
    assert words in outcome.text


def test_a_fence_without_a_bridge_or_without_a_position_is_not_judged() -> None:
    held = (FenceState(t_ns=1, fence=Fence(keep_in=FIELD), fence_id="a"),)
    for messages, words in (
        ({FENCE.name: ()}, "the vehicle bridge publishes no fence"),
        ({FENCE.name: held, STATUS.name: ()}, "the vehicle bridge publishes no fence"),
        ({FENCE.name: held, STATUS.name: (status(odometry=None),)}, "waits for the vehicle's origin"),
    ):
        outcome = check_fence(readings(messages))
        assert outcome.verdict == "warning" and words in outcome.text
