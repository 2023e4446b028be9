"""Goals that are prepared in a process of their own: what ends that work, and what its failure means for the goal."""

from collections.abc import Callable, Iterator
from functools import partial
from operator import truediv
from typing import Any

import pytest

from jezero.runtime import memory_bus
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.runtime.service import Inbox, Output, Publish, Reply
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Cancel, CancelReply, FeedbackMessage, Modify, Rejected
from jezero.schemas.goals import GoToGoal, MoveFeedback
from jezero.schemas.state import Status
from jezero.services.actions.lifecycle.server import NO_REPLY, ActionServer, PreparationRun
from jezero.services.actions.motion.behaviour import Plan, Preparation, Prepared, Refusal, VehicleState
from jezero.services.actions.table import PLANNERS
from tests.services.actions.fake_bridge import FakeBridge
from tests.services.actions.rig import CONFIG
from tests.services.preflight import healthy

SLOWER = partial(str, "slower than wanted")
GOAL = GoToGoal(target_ned_m=(5.0, 0.0, -3.0), goal_id="near")


class PreparedGoTo:
    """Plans flights to a point, after some work."""

    def __init__(self, work: Callable[[], Any]) -> None:
        self._planner = PLANNERS["go_to"](CONFIG)
        self.work = work

    def plan(self, goal: Any, status: Status) -> Plan | Refusal:
        plan = self._planner.plan(goal, status)
        assert isinstance(plan, Plan)
        start = plan.start
        assert not isinstance(start, Preparation)
        preparation = Preparation(
            work=lambda state: self.work,
            start=lambda value: Prepared(start, warning=str(value)),
            feedback=lambda state: MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, frame="world", distance_m=1.0),
            too_long="fly to one point after the other",
        )
        return Plan(preparation)


class World:
    """A bus with a hovering vehicle and a server whose goals need some work first."""

    def __init__(self, work: Callable[[], Any] = SLOWER) -> None:
        self.bus = MemoryBus(seed=1)
        self.bridge = FakeBridge((0.0, 0.0, -3.0))
        self.bus.add(self.bridge)
        self.planner = PreparedGoTo(work)
        self.bus.add(ActionServer(topics.GO_TO, self.planner, CONFIG, 5))
        self.bus.run_for(0.5)

    def send(self, goal: GoToGoal = GOAL) -> SentRequest:
        return self.bus.send_request(topics.GO_TO.endpoint, goal, "me")

    def first(self, answers: SentRequest, within_s: float = 3.0) -> Any:
        assert self.bus.run_for(within_s, lambda: bool(answers.replies))
        return answers.replies[0]


@pytest.fixture
def endless(monkeypatch: pytest.MonkeyPatch) -> World:
    """A world whose work takes an hour."""
    monkeypatch.setattr(memory_bus, "BACKGROUND_TASK_S", 3600.0)
    return World()


def test_the_warning_of_a_preparation_comes_with_the_acceptance() -> None:
    world = World()
    accepted = world.first(world.send())
    assert isinstance(accepted, Accepted)
    assert accepted.warning == "slower than wanted"


def test_work_that_raises_refuses_its_goal_and_the_next_one_is_planned_again() -> None:
    world = World(partial(truediv, 1, 0))
    for _ in range(2):
        rejected = world.first(world.send())
        assert isinstance(rejected, Rejected)
        assert rejected.reason.startswith("go_to failed in prepare: ZeroDivisionError: division by zero")


def test_work_that_can_not_be_sent_to_a_process_refuses_its_goal_with_what_to_do() -> None:
    world = World(lambda: None)
    rejected = world.first(world.send())
    assert isinstance(rejected, Rejected)
    assert rejected.reason.endswith("use a function of a module")


def test_work_that_takes_too_long_is_ended_and_the_refusal_says_what_to_change(endless: World) -> None:
    answers = endless.send()
    assert not endless.bus.run_for(19.5, lambda: answers.ended)
    rejected = endless.first(answers)
    assert isinstance(rejected, Rejected)
    assert rejected.reason == "the goal could not be planned within 20 s: fly to one point after the other"
    assert endless.bridge.grants == 0


def test_the_work_of_a_goal_that_was_canceled_ends_and_changes_nothing_any_more(endless: World) -> None:
    endless.send()
    endless.bus.run_for(1.0)
    assert len(endless.bus._ports["go_to"]._tasks) == 1
    endless.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="near"))
    endless.bus.run_for(1.0)
    assert not endless.bus._ports["go_to"]._tasks


def test_while_the_work_lasts_feedback_comes_ten_times_a_second(endless: World) -> None:
    seen: list[str] = []
    endless.bus.observe(lambda t_ns, topic, data: seen.append(topic))
    endless.send()
    endless.bus.run_for(2.0)
    assert 18 <= seen.count("action/go_to/feedback") <= 21


def test_a_cancel_is_obeyed_within_a_fifth_of_a_second(endless: World) -> None:
    answers = endless.send()
    endless.bus.run_for(5.0)
    canceled_ns = endless.bus.t_ns
    reply = endless.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="near"))
    rejected = endless.first(answers)
    assert (endless.bus.t_ns - canceled_ns) < 200_000_000
    assert isinstance(rejected, Rejected) and rejected.reason == "canceled by another client, client"
    assert reply.replies == [CancelReply(canceled=True)]


def test_another_goal_is_answered_while_one_is_planned(endless: World) -> None:
    endless.send()
    endless.bus.run_for(5.0)
    other = endless.send(GoToGoal(target_ned_m=(5.0, 0.0, -3.0), goal_id="other"))
    rejected = endless.first(other, 0.1)
    assert isinstance(rejected, Rejected) and rejected.reason.startswith("busy: another goal go to is running")


def test_a_plan_whose_client_has_gone_is_not_worked_out_any_more(endless: World) -> None:
    plan = endless.bus.send_request(topics.GO_TO.plan, GOAL, "me")
    endless.bus.run_for(1.0)
    assert not plan.ended
    endless.bus.client_departs("me")
    assert endless.bus.run_for(0.5, lambda: plan.ended)


def test_no_work_is_begun_for_a_goal_that_the_bridge_would_refuse(endless: World) -> None:
    endless.bridge.refuse = "a person flies"
    rejected = endless.first(endless.send(), within_s=1.0)
    assert isinstance(rejected, Rejected) and rejected.reason == "a person flies"


def test_a_change_whose_work_fails_is_refused_and_the_goal_goes_on() -> None:
    world = World()
    answers = world.send()
    assert isinstance(world.first(answers), Accepted)
    world.bus.run_for(1.0)
    world.planner.work = partial(truediv, 1, 0)
    change = Modify(goal_id="near", fields={"target_ned_m": (7.0, 0.0, -3.0)})
    reply = world.first(world.bus.send_request(topics.GO_TO.modify, change))
    assert not reply.modified
    assert reply.reason.startswith("go_to failed in prepare: ZeroDivisionError")
    assert world.bus.run_for(30.0, lambda: answers.ended)
    assert answers.replies[-1].outcome == "succeeded"
    assert world.bridge.pos_ned_m == pytest.approx((5.0, 0.0, -3.0), abs=0.2)


def test_no_work_is_begun_while_the_bridge_has_not_replied(endless: World) -> None:
    step = endless.bridge.step

    def without_replies(t_ns: int, inbox: Inbox) -> Iterator[Output]:
        yield from (output for output in step(t_ns, inbox) if not isinstance(output, Reply))

    endless.bridge.step = without_replies  # type: ignore[method-assign]
    rejected = endless.first(endless.send(), within_s=2.0)
    assert isinstance(rejected, Rejected) and rejected.reason.startswith(NO_REPLY)


@pytest.mark.parametrize("known", [True, False])
def test_feedback_of_a_preparation_has_the_code_of_the_status_and_minus_one_without_a_status(known: bool) -> None:
    pos_ned_m, still = (0.0, 0.0, -3.0), (0.0, 0.0, 0.0)
    state = VehicleState(pos_ned_m, still, (1.0, 0.0, 0.0, 0.0), armed=True, landed=False)
    feedback = MoveFeedback(pos_uav_ned_m=pos_ned_m, frame="world", distance_m=1.0)
    run = PreparationRun(
        0, topics.GO_TO, "near", Preparation(lambda state: SLOWER, Refusal, lambda state: feedback), state
    )
    (output,) = run.feedback(0, state, healthy.status(code=4) if known else None)
    assert isinstance(output, Publish) and isinstance(output.message, FeedbackMessage)
    assert output.message.code == (4 if known else -1)
    assert not list(run.feedback(99_999_999, state, None)), "ten times a second"
