"""A mission's plan: each goal from where the one before ends."""

from typing import Any

from jezero.mission_files import plan_mission
from jezero.schemas.actions import PlanReply
from jezero.schemas.goals import GoToGoal
from jezero.schemas.mission import GoalStep, Mission, WaitStep
from jezero.schemas.topics import ACTIONS

START_NED_M = (7.0, 8.0, 0.0)


def go(*target_ned_m: float) -> GoalStep:
    return GoalStep(label="go", action="go_to", goal={"target_ned_m": list(target_ned_m)})


def test_each_goal_is_planned_from_the_end_of_the_last_one_that_is_known() -> None:
    asked: list[Any] = []

    def plan(action: Any, goal: Any) -> PlanReply:
        assert isinstance(goal, GoToGoal)
        asked.append(goal.plan_from_ned_m)
        if goal.target_ned_m[0] > 500.0:
            return PlanReply(accepted=False, reason="too far")
        if goal.target_ned_m[0] < 0.0:
            return PlanReply(accepted=False, reason="the rover is not found", input_missing=True)
        return PlanReply(accepted=True, duration_s=10.0, path_ned_m=((0.0, 0.0, 0.0), goal.target_ned_m))

    steps = (go(900, 0, 0), go(1, 2, -3), WaitStep(label="wait", duration_s=4.0), go(-1, 0, 0), go(4, 5, -6))
    plans = list(plan_mission(Mission(name="test", steps=steps), ACTIONS, plan, START_NED_M))
    assert asked == [None, START_NED_M, (1.0, 2.0, -3.0), (1.0, 2.0, -3.0)]
    assert [(each.duration_s, each.problem, each.mistake) for each in plans] == [
        (None, "too far", True),
        (10.0, "", False),
        (4.0, "", False),
        (None, "the rover is not found", False),
        (10.0, "", False),
    ]
