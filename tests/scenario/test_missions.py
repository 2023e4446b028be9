"""The mission service flies lists of goals, in virtual time."""

from itertools import pairwise
from typing import Any

import msgspec
import pytest

from jezero.base.config import load_config
from jezero.base.frames import norm, subtract
from jezero.schemas import topics
from jezero.schemas.commands import Abort
from jezero.schemas.goals import AreaCoverageGoal
from jezero.schemas.mission import (
    GoalStep,
    WaitStep,
)
from jezero.schemas.rows import Action
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.simulator.camera.config import CameraConfig
from jezero.trials.stack import build_stack
from tests.scenario.mission_rig import LAND, TAKEOFF, MissionFlight, go
from tests.scenario.rig import Flight, go_to


def test_a_mission_flies_its_steps_and_ends_on_the_rover() -> None:
    flight = MissionFlight()
    flight.wait_ready()
    assert flight.run(TAKEOFF, go(2.0, 0.0), WaitStep(label="wait", duration_s=3.0), LAND).accepted
    progress = flight.wait_state("succeeded")
    assert (progress.step, progress.steps, progress.reason) == (4, 4, "")
    assert not flight.status.armed


def test_a_person_who_takes_control_interrupts_the_mission_until_a_command() -> None:
    flight = MissionFlight()
    flight.wait_ready()
    flight.run(TAKEOFF, go(30.0, 0.0, retries=3), go(0.0, 0.0))
    flight.wait_step(2)
    flight.bus.run_for(1.0)
    flight.request(topics.ABORT, Abort(reason="a bird"))
    progress = flight.wait_state("interrupted")
    assert "a bird" in progress.reason
    flight.bus.run_for(5.0)
    assert flight.progress[-1].state == "interrupted"
    assert "is interrupted: end it first" in flight.run(TAKEOFF).reason
    assert flight.command("skip").accepted
    assert flight.wait_state("succeeded").step == 3


def test_stop_ends_the_mission_in_a_hover_and_another_can_begin() -> None:
    flight = MissionFlight()
    flight.wait_ready()
    assert "no mission is flown" in flight.command("pause").reason
    flight.run(TAKEOFF, go(30.0, 0.0))
    flight.wait_step(2)
    assert flight.command("stop").accepted
    flight.wait_state("stopped")
    assert not flight.status.landed
    assert flight.run(LAND).accepted
    flight.wait_state("succeeded")


def test_a_mission_with_a_goal_that_is_none_is_refused_with_the_step() -> None:
    flight = MissionFlight()
    flight.wait_ready()
    reply = flight.run(TAKEOFF, GoalStep(label="fly", action="go_to", goal={"target_ned_m": [1.0, 2.0]}))
    assert not reply.accepted
    assert reply.reason.startswith("step 2, fly: ")
    assert "there is no action 'goto'" in flight.run(GoalStep(label="fly", action="goto", goal={})).reason


def test_a_goal_is_planned_from_a_place_where_the_vehicle_is_not_with_its_way() -> None:
    camera = msgspec.structs.replace(load_config(CameraConfig, "camera"), mode="rendered")
    flight = Flight(1, lambda seed: build_stack(seed, camera=camera))
    flight.wait_ready()
    begin_ned_m, target_ned_m = (10.0, 0.0, -5.0), (10.0, 20.0, -5.0)
    goals: list[tuple[Action[Any], dict[str, Any], tuple[float, float, float]]] = [
        (topics.TAKEOFF, {"altitude_m": 2.0}, (10.0, 0.0, -7.0)),
        (topics.GO_TO, {"target_ned_m": target_ned_m}, target_ned_m),
        (topics.GET_IMAGES, {"center_ned_m": (10.0, 5.0, -5.0), "radius_m": 3.0, "num_images": 4}, (10.0, 2.0, -5.0)),
        (topics.LAND_ON_SPOT, {"landing_spot_ned_m": target_ned_m, "use_uwb": False, "use_tag": False}, (10, 20, 0)),
    ]
    for action, fields, end_ned_m in goals:
        goal = action.goal_type(**fields, plan_from_ned_m=begin_ned_m)
        plan = flight.request(action.plan, goal)
        assert plan.accepted, plan.reason
        assert plan.path_ned_m[0] == pytest.approx(begin_ned_m)
        assert plan.path_ned_m[-1] == pytest.approx(end_ned_m, abs=1e-6)
        assert plan.duration_s > 2.0
    assert "plan_from_ned_m is for requests for a plan" in flight.refusal(
        topics.GO_TO, go_to(0.0, 0.0, -3.0, plan_from_ned_m=begin_ned_m)
    )
    corners = ((0.0, 0.0), (0.0, 10.0), (10.0, 10.0), (10.0, 0.0))
    area = AreaCoverageGoal(polygon_ned_m=corners, z_ned_m=-5.0, resolution_m=2.0, plan_from_ned_m=begin_ned_m)
    plan = flight.request(topics.AREA_COVERAGE.plan, area)
    assert plan.accepted, plan.reason
    lengths_m = [norm(subtract(end, begin)) for begin, end in pairwise(plan.path_ned_m)]
    assert sum(lengths_m) == pytest.approx(plan.distance_m, rel=0.02)


def test_a_mission_without_some_of_its_steps_succeeds_with_their_number() -> None:
    flight = MissionFlight()
    flight.wait_ready()
    assert flight.run(TAKEOFF, go(900.0, 0.0, then="skip"), go(2.0, 0.0), go(950.0, 0.0, then="skip"), LAND).accepted
    end = flight.wait_state("succeeded")
    assert (end.left_out, end.reason) == (2, "2 of 5 steps left out")


def test_a_failed_mission_is_resumed_with_the_step_that_failed_or_without_it() -> None:
    flight = MissionFlight()
    flight.wait_ready()
    assert flight.run(TAKEOFF, go(900.0, 0.0), LAND).accepted
    assert flight.wait_state("failed").attempt == 1
    assert flight.command("resume").accepted
    flight.wait(lambda: flight.progress[-1].state == "failed" and flight.progress[-1].attempt == 2, 20.0, "another try")
    assert flight.command("skip").accepted
    assert flight.wait_state("succeeded").left_out == 1
    assert not flight.status.armed


def test_a_mission_whose_stack_is_started_anew_takes_off_and_goes_on() -> None:
    before = MissionFlight()
    before.wait_ready()
    assert before.run(TAKEOFF, go(3.0, 0.0), go(30.0, 0.0, -5.0), go(0.0, 0.0), LAND).accepted
    before.wait_step(3)
    before.bus.run_for(3.0)
    flight = MissionFlight(saved=before.saved[-1])
    flight.wait_ready()
    interrupted = flight.wait_state("interrupted")
    assert (interrupted.step, flight.status.landed) == (3, True)
    assert flight.command("resume").accepted
    flight.wait_state("succeeded", 200.0)
    assert max(-truth.pos_uav_ned_m[2] for truth in flight.truths) > 4.5
    assert max(truth.pos_uav_ned_m[0] for truth in flight.truths) > 29.0


@pytest.mark.long
def test_a_wait_that_a_return_has_cut_waits_on_in_the_air() -> None:
    flight = MissionFlight(AutopilotConfig(charge_at_start=0.16, battery_swap_s=5.0))
    flight.wait_ready()
    assert flight.run(TAKEOFF, WaitStep(label="wait", duration_s=100.0), LAND).accepted
    flight.wait_state("interrupted", 200.0)
    waited_s = sum(status.name == "HOVER" for status in flight.statuses) / 10.0
    flight.wait(lambda: not flight.status.armed, 100.0, "the landing")
    flight.bus.run_for(8.0)
    assert flight.command("swapped").accepted
    begin = len(flight.statuses)
    flight.wait_state("succeeded", 300.0)
    hovered_s = sum(status.name == "HOVER" for status in flight.statuses[begin:]) / 10.0
    assert hovered_s == pytest.approx(100.0 - waited_s, abs=8.0)
