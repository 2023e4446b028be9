"""Missions that are drawn, and the rules of missions, which find what breaks them."""

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from jezero.base.plugins import all_actions
from jezero.runtime.service import Call, Inbox, Output, Publish, Reply, Request, Spec
from jezero.schemas import topics
from jezero.schemas.goals import Goal, GoToGoal, ReturnHomeGoal
from jezero.schemas.mission import (
    FailurePolicy,
    GoalStep,
    Mission,
    MissionCommand,
    MissionProgress,
    MissionReply,
    WaitStep,
)
from jezero.schemas.state import InCharge, Status, StatusCode
from jezero.services.mission.step_run import goal_of
from jezero.trials.campaign.judge import Judge
from jezero.trials.campaign.mission import named_random
from jezero.trials.campaign.missions import AWAY, END, FORWARD, STOPPED, MissionJudge, draw_mission
from tests.services.preflight import healthy

S = 1_000_000_000
RETURNS = GoalStep(label="1 go_to", action="go_to", goal={}, on_failure=FailurePolicy(then="return"))
SKIPS = GoalStep(label="2 go_to", action="go_to", goal={}, on_failure=FailurePolicy(then="skip"))
HOVERS = GoalStep(label="3 go_to", action="go_to", goal={})
WAITS = WaitStep(label="4 wait", duration_s=1.0)
MISSION = Mission(name="four", steps=(RETURNS, SKIPS, HOVERS, WAITS))
LABELS = ("", "1 go_to", "2 go_to", "3 go_to", "4 wait")
ACCEPTED = MissionReply(accepted=True, mission_id="m-1")


def status(in_charge: InCharge = "goal", goal_id: str = "", interventions: int = 0, t_ns: int = 0) -> Status:
    code = StatusCode.EXTERNAL if in_charge in ("external", "failsafe") else StatusCode.GO_TO
    return Status(
        t_ns=t_ns,
        code=code,
        name=code.name,
        armed=True,
        landed=False,
        in_charge=in_charge,
        goal_id=goal_id,
        interventions=interventions,
        bridge_boot_id=1,
        ready=True,
        odometry=healthy.status().odometry,
    )


def goal(number: int | str, attempt: int = 1, before: str = "") -> Call:
    goal_id = f"m-1.{number}.{attempt}{before}"
    payload: Goal = GoToGoal(goal_id=goal_id, target_ned_m=(1.0, 0.0, -3.0))
    if number == "end":
        payload = ReturnHomeGoal(goal_id=goal_id)
    action = topics.RETURN_HOME if number == "end" else topics.GO_TO
    return Call(action.endpoint, payload, f"{goal_id}/goal")


def progress(state: Any, step: int, attempt: int = 1, label: str = "", reason: str = "because") -> Publish:
    message = MissionProgress(
        t_ns=0,
        state=state,
        reason=reason,
        mission_id="m-1",
        step=step,
        steps=4,
        label=label or LABELS[step],
        attempt=attempt,
    )
    return Publish(topics.MISSION, message)


class Script:
    """A mission service whose outputs a test writes, and its inbox."""

    spec = Spec(name="mission")

    def __init__(self) -> None:
        self.judge = Judge()
        self._judged = MissionJudge(self, self.judge, {}, {})
        self._outputs: tuple[Output, ...] = ()
        self._request: Request | None = None
        self._status = status()
        self._t_ns = 0
        self.request(MISSION)

    def request(self, payload: Mission | MissionCommand) -> None:
        self._request = Request(1, "me", payload)
        self.put(Reply(1, ACCEPTED))
        self._request = None

    def put(self, *outputs: Output, after_s: float = 0.1) -> None:
        """Step with these outputs."""
        self._t_ns += int(after_s * S)
        self._outputs = outputs
        inbox: Any = self
        list(self._judged.step(self._t_ns, inbox))

    def see(self, **fields: Any) -> None:
        """Step with another status."""
        self._status = status(t_ns=self._t_ns, **fields)
        self.put()

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        yield from self._outputs

    def requests(self, endpoint: Any) -> list[Request]:
        if self._request is None:
            return []
        is_mission = isinstance(self._request.payload, Mission)
        return [self._request] if is_mission is (endpoint is topics.RUN_MISSION) else []

    def latest(self, topic: Any) -> Status:
        return self._status

    @property
    def broken(self) -> list[str]:
        return [violation.rule for violation in self.judge.violations]


def test_a_mission_that_flies_its_steps_breaks_nothing() -> None:
    script = Script()
    script.put(goal(1), progress("running", 1))
    script.put(goal(1, 2), progress("running", 1, 2))
    script.put(goal(2), progress("running", 2))
    script.put(goal(3), progress("running", 3))
    script.put(progress("running", 4))
    script.put(progress("succeeded", 4))
    assert script.broken == []


@pytest.mark.parametrize("second", [progress("running", 1), progress("running", 2, 1)])
def test_a_mission_that_goes_backward_is_found(second: Publish) -> None:
    script = Script()
    script.put(progress("running", 2, 2))
    script.put(second)
    assert script.broken == [FORWARD]


def test_a_mission_that_flies_on_after_its_end_is_found() -> None:
    script = Script()
    script.request(MissionCommand(command="stop"))
    script.put(progress("stopped", 1))
    assert script.broken == []
    script.put(goal(2))
    script.put(progress("running", 2))
    assert script.broken == [STOPPED, FORWARD]


def test_a_goal_that_outlives_its_mission_is_found() -> None:
    script = Script()
    script.request(MissionCommand(command="stop"))
    script.put(progress("stopped", 1))
    script.put(after_s=2.0)
    script.see(goal_id="m-1.1.1")
    assert script.broken == []
    script.put(after_s=4.0)
    script.see(goal_id="m-1.1.1")
    assert script.broken == [STOPPED]


@pytest.mark.parametrize("taken", [{"in_charge": "external"}, {"in_charge": "failsafe"}, {"interventions": 1}])
def test_a_goal_after_a_takeover_is_found_until_somebody_commands(taken: dict[str, Any]) -> None:
    script = Script()
    script.put(goal(1))
    script.see(**taken)
    script.see(interventions=taken.get("interventions", 0))
    script.put(goal(2))
    assert script.broken == [AWAY]
    script.request(MissionCommand(command="resume"))
    script.put(goal(3))
    assert script.broken == [AWAY]


@pytest.mark.parametrize(
    ("ends", "broken"),
    [
        ([progress("succeeded", 2)], [END]),
        ([progress("stopped", 1)], [END]),
        ([progress("failed", 1)], [END]),
        ([goal("end"), progress("failed", 1, label="return home")], []),
        ([progress("failed", 2)], [END]),
        ([progress("failed", 3)], []),
        ([progress("failed", 4)], [END]),
        ([goal(4, before=".takeoff"), progress("failed", 4)], []),
        ([progress("failed", 3, reason="")], ["a mission that fails says why"]),
    ],
)
def test_a_mission_ends_as_its_steps_say(ends: list[Output], broken: list[str]) -> None:
    script = Script()
    script.put(*ends)
    assert script.broken == broken


@pytest.mark.parametrize("cannot_fly", [{"odometry": None}, {"landed": True}])
def test_a_mission_of_a_vehicle_that_cannot_fly_home_may_end_without_that(cannot_fly: dict[str, Any]) -> None:
    script = Script()
    script._status = msgspec.structs.replace(status(), **cannot_fly)
    script.put(progress("failed", 1))
    assert script.broken == []


def test_every_step_of_a_drawn_mission_is_a_goal_of_its_action() -> None:
    kinds = set()
    for seed in range(200):
        mission = draw_mission(named_random(seed, "mission"), 5, from_ground=True)
        assert msgspec.convert(msgspec.to_builtins(mission), type(mission)) == mission
        for step in mission.steps:
            kinds.add(step.action if isinstance(step, GoalStep) else "wait")
            if isinstance(step, GoalStep):
                goal_of(all_actions()[step.action], step.goal, "g", 5)
    missions_may = {name for name, action in all_actions().items() if not action.mission_refusal}
    assert kinds == {*missions_may, "wait"}
