"""A mission's plan: each goal from the end and in the state of the one before, and as long as the battery lasts."""

from typing import Any

import pytest

from jezero.base.vehicle_config import VehicleConfig
from jezero.mission_files import plan_mission
from jezero.mission_files.planning import Start, StepPlan
from jezero.schemas.actions import PlanReply
from jezero.schemas.goals import ReturnHomeGoal, TakeoffGoal
from jezero.schemas.mission import GoalStep, Mission, Step, WaitStep
from jezero.schemas.topics import ACTIONS

VEHICLE = VehicleConfig()
SPEED_MPS = 5.0


def step(action: str, **goal: Any) -> GoalStep:
    return GoalStep(label=action, action=action, goal=goal)


def go(*target_ned_m: float) -> GoalStep:
    return step("go_to", target_ned_m=list(target_ned_m))


TAKEOFF, LAND, HOME = step("takeoff", altitude_m=3.0), step("land_on_spot"), step("return_home")


class Planner:
    """Plans straight flights.

    Attributes:
        asked: the goals so far, without those that only ask for the way home.
    """

    def __init__(self) -> None:
        self.asked: list[Any] = []

    def plan(self, action: Any, goal: Any) -> PlanReply:
        north_m, east_m, down_m = begin_ned_m = goal.plan_from_ned_m
        if isinstance(goal, ReturnHomeGoal):
            end_ned_m = (0.0, 0.0, 0.0)
        elif isinstance(goal, TakeoffGoal):
            end_ned_m = (north_m, east_m, down_m - goal.altitude_m)
        else:
            end_ned_m = getattr(goal, "target_ned_m", (north_m, east_m, 0.0))
        self.asked.append(goal)
        if end_ned_m[0] > 500.0:
            return PlanReply(accepted=False, reason="too far")
        if end_ned_m[0] < -400.0:
            return PlanReply(accepted=False, reason="the rover is not found", input_missing=True)
        length_m = sum((a - b) ** 2 for a, b in zip(begin_ned_m, end_ned_m, strict=True)) ** 0.5
        path_ned_m = (begin_ned_m, end_ned_m)
        return PlanReply(accepted=True, duration_s=length_m / SPEED_MPS, distance_m=length_m, path_ned_m=path_ned_m)


def planned(*steps: Step, **start: Any) -> list[StepPlan]:
    return list(
        plan_mission(Mission(name="test", steps=steps), ACTIONS, Planner().plan, Start(vehicle=VEHICLE, **start))
    )


def problems(*steps: Step, **start: Any) -> list[str]:
    return [plan.problem for plan in planned(*steps, **start)]


def test_each_goal_is_planned_from_the_end_of_the_last_one_that_is_known() -> None:
    planner = Planner()
    steps = (go(900, 0, 0), go(1, 2, -3), WaitStep(label="wait", duration_s=4.0), go(-500, 0, 0), go(4, 5, -6))
    start = Start(vehicle=VEHICLE, pos_ned_m=(7.0, 8.0, -2.0), flies=True)
    plans = list(plan_mission(Mission(name="test", steps=steps), ACTIONS, planner.plan, start))
    flown = [goal.plan_from_ned_m for goal in planner.asked if not isinstance(goal, ReturnHomeGoal)]
    assert flown == [(7.0, 8.0, -2.0), (7.0, 8.0, -2.0), (1.0, 2.0, -3.0), (1.0, 2.0, -3.0)]
    assert [(each.problem, each.mistake) for each in plans] == [
        ("too far", True), ("", False), ("", False), ("the rover is not found", False), ("", False),
    ]  # fmt: skip


def test_a_flight_from_the_ground_needs_a_takeoff_and_a_takeoff_the_ground() -> None:
    stands = "the vehicle stands on the ground after step 2: put a takeoff before this step"
    assert problems(TAKEOFF, LAND, go(10, 0, -3), LAND)[2:] == [stands, stands]
    assert problems(TAKEOFF, TAKEOFF, LAND)[1].startswith("the vehicle flies already after step 1")
    assert problems(TAKEOFF, LAND, flies=True)[0].startswith("the vehicle flies already before the mission")
    assert problems(go(10, 0, -3))[0].startswith("the vehicle stands on the ground before the mission")


def test_two_flights_and_a_goal_that_takes_off_itself_are_right() -> None:
    assert not any(problems(TAKEOFF, go(5, 0, -3), HOME, TAKEOFF, LAND))
    assert not any(problems(step("go_to", target_ned_m=[5, 0, -3], do_takeoff=True), LAND))
    assert not any(problems(go(5, 0, -3), LAND, flies=True))


def test_a_wait_in_the_air_uses_the_battery_and_one_on_the_ground_does_not() -> None:
    wait = WaitStep(label="wait", duration_s=120.0)
    in_air, landed = planned(TAKEOFF, wait, LAND, wait)[1::2]
    assert in_air.charge_used == pytest.approx(VEHICLE.battery.used(120.0))
    assert landed.charge_used == 0.0


def test_the_step_is_named_in_which_the_vehicle_would_return() -> None:
    wait = WaitStep(label="wait", duration_s=300.0)
    found = problems(TAKEOFF, wait, wait, wait, wait, LAND)
    assert [bool(problem) for problem in found] == [False, False, False, False, True, False]
    assert "the mission would end in this step: the battery would have 0% after it, the way home needs 1" in found[4]


def test_a_battery_that_is_not_full_and_a_far_way_home_count() -> None:
    assert not any(problems(TAKEOFF, go(200, 0, -3), HOME, charge=0.5))
    assert "the way home needs" in problems(TAKEOFF, go(200, 0, -3), HOME, charge=0.15)[1]
    assert "would have 9% after this landing, and 10% is its reserve" in problems(LAND, flies=True, charge=0.09)[0]


def test_a_head_wind_takes_more_than_calm_air() -> None:
    calm, wind = (
        planned(TAKEOFF, go(200, 0, -3), wind_ned_mps=(north_mps, 0.0, 0.0))[1].charge_used for north_mps in (0.0, -6.0)
    )
    assert calm is not None and wind is not None
    assert 1.1 * calm < wind < 1.5 * calm
