"""One goal, from its request to its end, in virtual time: what is requested when, and which reply ends it."""

from typing import Any

import pytest

from jezero.base.goal_follower import ASK_PERIOD_NS, SEND_PERIOD_NS, SENDS_MAX, GoalFollower
from jezero.schemas.actions import CancelReply, Rejected, ResultReply
from jezero.schemas.units import NS_PER_S
from tests.client.rig import ACCEPTED, a_feedback, a_result

RUNNING = ResultReply(goal_id="g", action="takeoff", running=True)
REJECTED = Rejected(goal_id="g", reason="it flies already")
NOT_CANCELED = CancelReply(canceled=False, reason="no goal is known")


def a_follower(gap_max_s: float | None = None, *, accepted: bool = False) -> GoalFollower:
    return GoalFollower(unknown_max=3, gap_max_s=gap_max_s, accepted=accepted)


def requests_until(follower: GoalFollower, end_s: float, begin_s: float = 0.0) -> list[tuple[float, str]]:
    """Time and kind of each request that is due, of a caller that looks ten times a second."""
    tenths = range(round(begin_s * 10), round(end_s * 10))
    return [(n / 10, request) for n in tenths for request in follower.due(n * NS_PER_S // 10)]


def test_a_goal_is_sent_again_until_somebody_replies_and_is_lost_after_the_last_time() -> None:
    follower = a_follower()
    sends = requests_until(follower, 100.0)
    assert sends == [(n * SEND_PERIOD_NS / NS_PER_S, "goal") for n in range(SENDS_MAX)]
    assert (follower.end, follower.accepted) == ("timeout", False)


@pytest.mark.parametrize("reply", [ACCEPTED, a_feedback(1.0), RUNNING])
def test_a_goal_that_is_heard_of_is_asked_for_when_it_has_been_silent(reply: Any) -> None:
    follower = a_follower()
    assert list(follower.due(0)) == ["goal"]
    follower.on_reply(0, reply)
    assert follower.accepted
    assert requests_until(follower, 1.2) == [(0.5, "result"), (1.0, "result")]
    follower.on_reply(NS_PER_S, a_feedback(1.0))
    assert list(follower.due(NS_PER_S + ASK_PERIOD_NS - 1)) == []


def test_the_end_of_the_stream_makes_the_result_due_at_once() -> None:
    follower = a_follower()
    follower.on_reply(0, ACCEPTED)
    follower.on_silence(1, "goal", "no server")
    assert list(follower.due(1)) == ["result"]
    assert follower.end is None


def test_the_result_ends_a_goal_and_nothing_changes_it() -> None:
    follower = a_follower(accepted=True)
    follower.cancel()
    follower.on_reply(0, a_result("aborted", "wind"))
    follower.on_reply(1, a_result("canceled"))
    follower.on_silence(2, "result", "no server")
    assert follower.end == a_result("aborted", "wind")
    assert list(follower.due(NS_PER_S)) == []


@pytest.mark.parametrize("reply", [REJECTED, NOT_CANCELED])
def test_a_refusal_ends_a_goal_only_before_it_is_accepted(reply: Any) -> None:
    early, flying = a_follower(), a_follower(accepted=True)
    for follower in (early, flying):
        follower.on_reply(0, reply)
    assert (early.end, flying.end) == (reply, None)


def test_a_cancel_is_repeated_and_the_goal_is_not_sent_again() -> None:
    follower = a_follower()
    assert list(follower.due(0)) == ["goal"]
    follower.cancel()
    assert requests_until(follower, 20.0, 0.1) == [((1 + 5 * n) / 10, "cancel") for n in range(40)]
    follower.on_reply(20 * NS_PER_S, CancelReply(canceled=True))
    assert follower.end is None


@pytest.mark.parametrize(
    ("request_", "gap", "end"), [("goal", False, "why"), ("cancel", False, "why"), ("goal", True, None)]
)
def test_without_a_server_a_goal_ends_before_it_is_accepted_but_not_for_a_gap(
    request_: Any, gap: bool, end: str | None
) -> None:
    follower = a_follower()
    follower.on_silence(0, request_, "why", gap=gap)
    assert follower.end == end


def test_a_goal_that_no_server_knows_several_times_in_a_row_is_lost() -> None:
    follower = a_follower(accepted=True)
    for reply in (None, None, RUNNING, None, None, None):
        assert follower.end is None
        if reply is None:
            follower.on_silence(0, "result", "no server")
        else:
            follower.on_reply(0, reply)
    assert (follower.end, follower.gap) == ("no server", False)


def test_a_gap_of_any_length_ends_nothing_where_none_is_too_long() -> None:
    follower = a_follower(accepted=True)
    for t_s in range(1000):
        follower.on_silence(t_s * NS_PER_S, "result", "timeout", gap=True)
    assert follower.end is None


@pytest.mark.parametrize("gap_at_end", [True, False])
def test_after_a_gap_servers_have_time_to_connect_again(gap_at_end: bool) -> None:
    follower = a_follower(gap_max_s=5.0, accepted=True)
    follower.on_silence(10 * NS_PER_S, "goal", "the stream has ended")
    follower.on_silence(10 * NS_PER_S, "result", "no reply", gap=True)
    for t_s in (11, 12, 13, 14, 15):
        follower.on_silence(t_s * NS_PER_S, "result", "no reply", gap=gap_at_end)
        assert follower.end is None
    follower.on_silence(15 * NS_PER_S + 1, "result", "no reply", gap=gap_at_end)
    assert (follower.end, follower.gap) == ("no reply", True)


def test_a_reply_ends_the_gap() -> None:
    follower = a_follower(gap_max_s=5.0, accepted=True)
    follower.on_silence(0, "result", "no reply", gap=True)
    follower.on_reply(NS_PER_S, RUNNING)
    assert not follower.gap
    for _ in range(3):
        follower.on_silence(NS_PER_S, "result", "no reply")
    assert follower.end == "no reply"
