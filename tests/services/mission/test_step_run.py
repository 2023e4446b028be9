"""A goal of a mission reaches its server over a connection with gaps, and ends when the mission wants it."""

from collections.abc import Sequence
from typing import Any

import msgspec

from jezero.base.goal_follower import SENDS_MAX
from jezero.runtime.service import Call, Output, Response
from jezero.schemas.actions import Accepted, Cancel, CancelReply, GetResult, Rejected, Result, ResultReply
from jezero.schemas.goals import AreaCoverageGoal, CoverageResult, GoToGoal
from jezero.schemas.topics import AREA_COVERAGE, GO_TO
from jezero.schemas.units import NS_PER_S
from jezero.services.mission.step_run import StepGoal, goal_of
from tests.client.rig import POINT, a_feedback, a_result

GOAL = GoToGoal(goal_id="m-1.1.1", target_ned_m=(1.0, 0.0, -3.0))
STEP_NS = NS_PER_S // 10


class Connection:
    """Steps a goal's run ten times a second; its calls time out unless a test replies to them."""

    def __init__(self) -> None:
        self.run = StepGoal(GO_TO, GOAL)
        self.t_ns = 0
        self.waiting: dict[str, tuple[Call, int]] = {}
        """Calls without a response, and the times at which they time out."""
        self.responses: Sequence[Response] = ()

    def step(self, *responses: Response, seconds: float = 0.1) -> list[Call]:
        """Go on for some time; returns the new calls."""
        calls: list[Call] = []
        end_ns = self.t_ns + int(seconds * NS_PER_S)
        while self.t_ns < end_ns:
            self.t_ns += STEP_NS
            late = [tag for tag, (_, due_ns) in self.waiting.items() if due_ns <= self.t_ns]
            self.responses = (*responses, *(Response(tag, None, "timeout") for tag in late))
            calls += self._take(list(self.run.step(self.t_ns, self, paused=False)))  # type: ignore[arg-type]
            for response in self.responses:
                if not self.waiting[response.tag][0].streamed or response.error is not None:
                    del self.waiting[response.tag]
            responses = ()
        return calls

    def is_over(self) -> bool:
        return self.run.ended is not None

    def cancel(self) -> list[Call]:
        return self._take(list(self.run.cancel()))

    def reply(self, kind: type, payload: Any) -> Response:
        """A reply to the newest call with a request of this kind."""
        (tag,) = [tag for tag, (call, _) in self.waiting.items() if isinstance(call.payload, kind)]
        return Response(tag, payload)

    def _take(self, outputs: list[Output]) -> list[Call]:
        calls = [output for output in outputs if isinstance(output, Call)]
        for call in calls:
            self.waiting[call.tag] = (call, self.t_ns + int(call.timeout_s * NS_PER_S))
        return calls


def done(outcome: str, reason: str = "") -> ResultReply:
    """The reply to `GetResult` after the goal's end."""
    text = msgspec.json.encode(a_result(outcome, reason)).decode()
    return ResultReply(goal_id=GOAL.goal_id, action="go_to", running=False, result=text)


def requests(calls: list[Call], kind: type) -> int:
    return sum(isinstance(call.payload, kind) for call in calls)


def test_a_goal_that_was_lost_on_its_way_is_sent_again() -> None:
    link = Connection()
    assert requests(link.step(), GoToGoal) == 1
    assert requests(link.step(seconds=12.0), GoToGoal) == 2
    link.step(link.reply(GoToGoal, Accepted(goal_id=GOAL.goal_id)))
    calls = link.step(seconds=10.0)
    assert requests(calls, GoToGoal) == 0
    assert requests(calls, GetResult) > 10
    assert not link.is_over()


def test_a_goal_that_nobody_replies_to_fails() -> None:
    link = Connection()
    assert requests(link.step(seconds=60.0), GoToGoal) == SENDS_MAX
    assert link.run.ended is not None
    assert link.run.ended.reason == "go_to did not reply (timeout): is its service running? (jezero ps)"


def test_a_goal_that_its_server_never_got_ends_when_it_is_canceled() -> None:
    link = Connection()
    link.step(seconds=1.0)
    link.cancel()
    assert requests(link.step(seconds=10.0), Cancel) > 10
    assert not link.is_over()
    link.step(link.reply(Cancel, CancelReply(canceled=False, reason="no goal is known")))
    assert link.run.ended is not None
    assert link.run.ended.end == "canceled"


def test_a_canceled_goal_that_its_server_still_plans_ends_with_the_reply_to_the_goal() -> None:
    link = Connection()
    link.step()
    link.cancel()
    link.step(link.reply(Cancel, CancelReply(canceled=True)))
    assert not link.is_over()
    link.step(link.reply(GoToGoal, Rejected(goal_id=GOAL.goal_id, reason="canceled by a client")))
    assert link.run.ended is not None
    assert link.run.ended.end == "canceled"


def test_a_lost_cancel_is_repeated_until_the_result_comes() -> None:
    link = Connection()
    link.step()
    link.step(link.reply(GoToGoal, Accepted(goal_id=GOAL.goal_id)))
    link.cancel()
    assert requests(link.step(seconds=5.0), Cancel) > 5
    link.step(link.reply(GetResult, done("canceled", "canceled by a client")))
    assert link.run.ended is not None
    assert (link.run.ended.end, link.run.ended.reason) == ("canceled", "canceled by a client")


def test_a_garbled_result_is_asked_for_again() -> None:
    link = Connection()
    link.step()
    link.step(link.reply(GoToGoal, Accepted(goal_id=GOAL.goal_id)))
    link.step(seconds=0.5)
    link.step(link.reply(GetResult, msgspec.structs.replace(done("succeeded"), result='{"outcome": "succ')))
    assert not link.is_over()
    link.step(seconds=0.5)
    link.step(link.reply(GetResult, done("succeeded")))
    assert link.run.ended is not None
    assert link.run.ended.end == "succeeded"


def test_a_gap_in_the_connection_is_no_restart_of_the_server_and_a_server_that_knows_nothing_is_one() -> None:
    link = Connection()
    link.step()
    link.step(link.reply(GoToGoal, Accepted(goal_id=GOAL.goal_id)))
    link.step(seconds=60.0)
    assert not link.is_over()
    for _ in range(4):
        link.step(seconds=0.5)
        tag = link.reply(GetResult, None).tag
        link.step(Response(tag, None, "no server"))
    assert link.run.ended is not None
    assert link.run.ended.reason == "go_to doesn't know the goal any more: it was restarted"


def test_while_feedback_comes_nothing_else_is_asked_for_and_the_result_ends_the_goal_at_once() -> None:
    link = Connection()
    link.step()
    link.step(link.reply(GoToGoal, Accepted(goal_id=GOAL.goal_id)))
    for _ in range(50):
        assert link.step(link.reply(GoToGoal, a_feedback(1.0))) == []
    link.step(link.reply(GoToGoal, a_result("aborted", "the battery is low")))
    assert link.run.ended is not None
    assert (link.run.ended.end, link.run.ended.reason) == ("failed", "the battery is low")


def test_the_result_of_a_goal_whose_stream_has_ended_is_asked_for_at_once() -> None:
    link = Connection()
    link.step()
    link.step(link.reply(GoToGoal, Accepted(goal_id=GOAL.goal_id)))
    ended = link.reply(GoToGoal, None).tag
    assert requests(link.step(Response(ended, None, "no server")), GetResult) == 1


def test_what_is_missing_of_an_interrupted_area_is_the_rest_of_the_step() -> None:
    rest = AreaCoverageGoal(goal_id="old", polygon_ned_m=((0.0, 0.0), (0.0, 5.0), (5.0, 5.0)), z_ned_m=-4.0)
    images = CoverageResult(completed=False, pos_uav_ned_m=POINT, covered=0.5, resume=rest)
    run = StepGoal(AREA_COVERAGE, rest)
    box = Connection()
    list(run.step(1, box, paused=False))  # type: ignore[arg-type]
    box.responses = [
        Response("old/goal", Result(goal_id="old", t_ns=2, outcome="aborted", reason="wind", result=images))
    ]
    list(run.step(2, box, paused=False))  # type: ignore[arg-type]
    assert run.ended is not None and run.ended.rest is not None
    assert "goal_id" not in run.ended.rest
    assert goal_of(AREA_COVERAGE, run.ended.rest, "new", 3).polygon_ned_m == rest.polygon_ned_m  # type: ignore[attr-defined]
