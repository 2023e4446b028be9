"""The vehicle flies home by itself: while the battery holds the way, and when the ground station is lost."""

import msgspec
import pytest
from msgspec.structs import replace

from jezero.base.codec import decode, encode
from jezero.base.config import load_config
from jezero.base.frames import distance
from jezero.base.vehicle_config import VehicleConfig
from jezero.mission_files import shipped_mission
from jezero.schemas import topics
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.commands import Hover
from jezero.schemas.goals import ImagesFeedback
from jezero.schemas.health import ServiceHealth
from jezero.schemas.mission import GoalStep
from jezero.schemas.preflight import PreflightReport
from jezero.schemas.state import Status
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.mission.config import MissionConfig
from tests.scenario.mission_rig import LAND, TAKEOFF, MissionFlight, go
from tests.scenario.rig import go_to

SURVEY = GoalStep(
    label="survey",
    action="area_coverage",
    goal={"polygon_ned_m": [[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0], [-4.0, 4.0]], "z_ned_m": -5.0, "overlap": 0.6},
)


DEMONSTRATION_S = 103.0
"""Time in the air of `jezero demo`'s mission."""
TENTHS = [pytest.param(tenth, marks=() if tenth in (3, 9) else pytest.mark.slow) for tenth in range(1, 11)]
WAY_HOME = 0.14
"""Charge that the way home needs during the demonstration: 10 % and 30 to 40 s of flight."""


def on_the_rover(flight: MissionFlight) -> bool:
    return not flight.status.armed and distance(flight.truth.pos_uav_ned_m, flight.truth.pos_rover_ned_m) < 0.3


@pytest.mark.long
def test_a_goal_of_any_client_ends_while_the_battery_still_holds_the_way_home() -> None:
    flight = MissionFlight(AutopilotConfig(charge_at_start=0.24))
    flight.take_off(3.0)
    result = flight.finish(flight.send(topics.GO_TO, go_to(250.0, 0.0, -5.0)))
    assert result.outcome == "aborted"
    assert "the way home needs" in result.reason
    flight.wait(lambda: on_the_rover(flight), 240.0, "landing on the rover")
    assert flight.status.battery is not None and flight.status.battery.remaining is not None
    assert flight.status.battery.remaining >= 0.1


@pytest.mark.long
def test_a_gauge_that_stands_still_brings_the_vehicle_home_too_and_is_named() -> None:
    flight = MissionFlight(AutopilotConfig(charge_at_start=0.3))
    named: list[str] = []

    def stand_still(sender: str, receiver: str, name: str, t_ns: int, data: bytes) -> list[tuple[int, bytes]]:
        if name == topics.STATUS.name:
            status: Status = decode(Status, data)
            if status.battery is not None:
                data = encode(replace(status, battery=replace(status.battery, remaining=0.3)))
        return [(t_ns, data)]

    def keep(t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.PREFLIGHT.name:
            report: PreflightReport = decode(PreflightReport, data)
            named.extend(check.text for check in report.failed())

    flight.take_off(3.0)
    flight.bus.tamper = stand_still
    flight.bus.observe(keep)
    flight.wait(lambda: flight.status.action == "return_home", 260.0, "the return")
    flight.wait(lambda: on_the_rover(flight), 120.0, "landing on the rover")
    left = flight.status.battery  # as the autopilot reports it
    assert left is not None and left.remaining is not None and left.remaining >= 0.1
    assert any("its gauge stands still" in text for text in named)


@pytest.mark.long
def test_a_survey_goes_on_with_the_first_missing_image_after_a_change_of_the_battery() -> None:
    flight = MissionFlight(AutopilotConfig(charge_at_start=0.15, battery_swap_s=5.0))
    feedback: dict[str, ImagesFeedback] = {}

    def keep(t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.feedback_of(topics.AREA_COVERAGE).name:
            message = msgspec.json.decode(data, type=FeedbackMessage[ImagesFeedback])
            feedback[message.goal_id] = message.feedback

    flight.bus.observe(keep)
    flight.wait_ready()
    assert flight.run(TAKEOFF, SURVEY, LAND).accepted
    waiting = flight.wait_state("interrupted")
    assert waiting.step == 2 and "the way home needs" in waiting.reason
    assert "wait until it has landed" in flight.command("resume").reason
    flight.wait(lambda: on_the_rover(flight), 240.0, "landing on the rover")
    flight.wait(lambda: "it has landed" in flight.progress[-1].reason, 10.0, "the mission knows of the landing")
    assert "put in one with" in flight.command("swapped").reason
    flight.bus.run_for(6.0)
    assert flight.command("swapped").accepted
    flight.wait_state("succeeded", 300.0)
    assert on_the_rover(flight)
    first, second = feedback.values()
    assert 0 < first.taken < first.planned
    assert first.taken + second.taken == first.planned == second.planned


@pytest.mark.long
def test_a_person_who_ends_the_return_flies_on_and_is_not_overruled() -> None:
    flight = MissionFlight(AutopilotConfig(charge_at_start=0.24))
    flight.take_off(3.0)
    flight.send(topics.GO_TO, go_to(250.0, 0.0, -5.0))
    flight.wait(lambda: flight.status.action == "return_home", 120.0, "the return")
    flight.request(topics.HOVER, Hover())
    flight.bus.run_for(20.0)
    assert flight.status.name == "HOVER"


@pytest.mark.long
@pytest.mark.parametrize("ground_loss_s", [0.0, 10.0])
def test_a_lost_ground_station_brings_the_vehicle_home_only_where_that_is_set(ground_loss_s: float) -> None:
    flight = MissionFlight(config=MissionConfig(ground_loss_s=ground_loss_s))
    flight.wait_ready()
    assert flight.run(TAKEOFF, go(20.0, 0.0), go(-20.0, 0.0), go(0.0, 0.0), LAND).accepted
    flight.wait_step(2)
    flight.bus.publish("ground_station", topics.health_of("ground_station"), msgspec.json.encode(health()))
    flight.wait(lambda: flight.progress[-1].state != "running", 200.0, "the end of the mission")
    assert (flight.progress[-1].state == "interrupted") == bool(ground_loss_s)
    flight.wait(lambda: on_the_rover(flight), 120.0, "landing on the rover")


def health() -> ServiceHealth:
    return ServiceHealth(t_ns=0, service="ground_station", boot_id=1, state="ok", text="")


@pytest.mark.long
@pytest.mark.parametrize("tenth", TENTHS)
def test_a_battery_that_would_be_empty_at_a_tenth_of_the_demonstration_holds_the_way_home_or_says_why_not(
    tenth: int,
) -> None:
    vehicle = load_config(VehicleConfig, "vehicle")
    battery = vehicle.battery
    capacity_mah = battery.capacity_mah * battery.used(tenth / 10 * DEMONSTRATION_S)
    flight = MissionFlight(vehicle=replace(vehicle, battery=replace(battery, capacity_mah=capacity_mah)))
    fly_the_demonstration(flight)


@pytest.mark.slow
@pytest.mark.parametrize("tenth", range(1, 11))
def test_a_battery_that_becomes_low_at_a_tenth_of_the_demonstration_holds_the_way_home(tenth: int) -> None:
    used = load_config(VehicleConfig, "vehicle").battery.used(tenth / 10 * DEMONSTRATION_S)
    flight = MissionFlight(AutopilotConfig(charge_at_start=WAY_HOME + used))
    assert fly_the_demonstration(flight) >= 0.1


def fly_the_demonstration(flight: MissionFlight) -> float:
    """Fly until the vehicle has come home, and check that it has; returns the charge that is left."""
    flight.wait_ready()
    reply = flight.request(topics.RUN_MISSION, shipped_mission("demonstration"))
    assert reply.accepted
    flight.wait(lambda: flight.progress[-1].state not in ("idle", "running"), 300.0, "the end of the mission")
    flight.wait(lambda: not flight.status.armed, 120.0, "the landing")
    flight.bus.run_for(2.0)
    reason, battery = flight.progress[-1].reason, flight.status.battery
    assert battery is not None and battery.remaining is not None
    print(f"{battery.remaining:.0%} left; {flight.progress[-1].state} {reason}")  # for pytest -s
    if all(status.landed for status in flight.statuses):
        assert "the battery is too low" in reason
    else:
        assert on_the_rover(flight) or "less than 10% may be left" in reason
        assert battery.remaining >= 0.1 or "less than 10% may be left" in reason
    return battery.remaining
