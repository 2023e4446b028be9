"""Goals from the journals of action servers and from their feedback."""

from pathlib import Path

import pytest
from msgspec import Raw

from jezero.base.codec import encode
from jezero.recording import RecordingError
from jezero.recording.goals import feedback_by_goal
from jezero.schemas import topics
from jezero.schemas.actions import Rejected
from jezero.schemas.goals import GetImagesGoal, GoToGoal, ImagesFeedback, MoveFeedback
from jezero.schemas.journal import Replied, Requested
from tests.recording.goals_rig import (
    GOAL,
    RESULT,
    Flight,
    accepted,
    ended,
    message,
    replied,
    requested,
    step,
    succeeded,
)
from tests.recording.rig import SECOND_NS


@pytest.fixture
def flight(tmp_path: Path) -> Flight:
    return Flight(tmp_path / "flight.mcap")


def test_a_goal_has_its_request_its_feedback_and_its_result(flight: Flight) -> None:
    flight.feedback(2.0)
    flight.journal(2.1, requested(1), step(1.5), accepted(warning="slower"))
    flight.feedback(3.0)
    flight.journal(5.0, step(4.5), succeeded(4.5))
    (goal,) = flight.goals()
    assert (goal.goal_id, goal.action, goal.client_id, goal.goal) == ("a", "go_to", "py-1", GOAL)
    assert [each.t_ns for each in goal.feedback] == [2 * SECOND_NS, 3 * SECOND_NS]
    assert (goal.outcome, goal.reason, goal.warning, goal.result) == ("succeeded", "", "slower", RESULT)
    assert goal.start_s == pytest.approx(1.5) and goal.duration_s == pytest.approx(3.0)


def test_a_canceled_goal_has_its_reason(flight: Flight) -> None:
    flight.journal(2.0, requested(1), step(1.0), accepted(), step(2.0), ended(2.0, "canceled", "by a client"))
    (goal,) = flight.goals()
    assert (goal.outcome, goal.reason, goal.result) == ("canceled", "by a client", None)


def test_a_rejected_goal_has_its_reason_also_without_an_id(flight: Flight) -> None:
    nameless = GoToGoal(target_ned_m=(1.0, 2.0, -3.0))
    flight.journal(2.0, requested(1), step(1.0), replied(1, Rejected(goal_id="a", reason="no battery")))
    flight.journal(4.0, requested(2, nameless), step(3.0), replied(2, Rejected(reason="busy")))
    flight.journal(6.0, requested(3), step(5.0), accepted(3), step(5.5), succeeded(5.5, 3))
    goals = flight.goals()
    assert [(goal.goal_id, goal.outcome, goal.reason) for goal in goals] == [
        ("a", "rejected", "no battery"),
        ("", "rejected", "busy"),
        ("a", "succeeded", ""),
    ]


def test_a_goal_that_was_sent_twice_is_one_goal(flight: Flight) -> None:
    flight.journal(2.0, requested(1), step(1.0), accepted(1), requested(2), step(1.5), accepted(2))
    flight.journal(4.0, step(3.0), succeeded(3.0, 1), succeeded(3.0, 2))
    (goal,) = flight.goals()
    assert goal.start_ns == SECOND_NS and goal.duration_s == pytest.approx(2.0)


def test_of_a_goal_that_runs_at_the_end_of_the_recording_the_end_is_unknown(flight: Flight) -> None:
    flight.journal(2.0, requested(1), step(1.0), accepted())
    flight.feedback(3.0)
    flight.journal(4.0, requested(2, GoToGoal(target_ned_m=(0.0, 0.0, -1.0))), step(4.0))
    flying, waiting = flight.goals()
    assert (flying.goal_id, flying.outcome) == ("a", "unknown")
    assert flying.duration_s == pytest.approx(2.0)
    assert (waiting.goal_id, waiting.outcome, waiting.end_ns) == ("", "unknown", 4 * SECOND_NS)


def test_a_goal_that_began_before_the_recording_has_its_end(flight: Flight) -> None:
    flight.feedback(1.0)
    flight.journal(3.0, step(2.0), succeeded(2.0))
    (goal,) = flight.goals()
    assert (goal.goal, goal.outcome, goal.result) == (None, "succeeded", RESULT)
    assert goal.start_ns == SECOND_NS and goal.end_ns == 2 * SECOND_NS


def test_a_recording_without_journals_has_the_feedback_alone(flight: Flight) -> None:
    for seconds, goal_id in ((1.0, "a"), (2.0, "b"), (3.0, "a")):
        flight.feedback(seconds, goal_id)
    a, b = flight.goals()
    assert (a.goal_id, a.action, a.start_ns, a.end_ns) == ("a", "go_to", SECOND_NS, 3 * SECOND_NS)
    assert (b.goal_id, b.goal, b.outcome) == ("b", None, "unknown")
    assert [each.feedback.distance_m for each in a.feedback] == [1.0, 1.0]


def test_a_goal_that_was_only_planned_is_no_goal(flight: Flight) -> None:
    content = ImagesFeedback(pos_uav_ned_m=(0.0, 0.0, -2.0), phase="planning", taken=0, planned=4)
    flight.write(1.0, topics.feedback_of(topics.GET_IMAGES).name, encode(message(1.0, "p", content)))
    assert flight.goals() == []


def test_a_goal_that_was_rejected_after_its_planning_keeps_that_feedback(flight: Flight) -> None:
    content = ImagesFeedback(pos_uav_ned_m=(0.0, 0.0, -2.0), phase="planning", taken=0, planned=4)
    goal = GetImagesGoal(goal_id="p", center_ned_m=(0.0, 0.0, -2.0), radius_m=2.0, num_images=4)
    flight.write(1.0, topics.feedback_of(topics.GET_IMAGES).name, encode(message(1.0, "p", content)))
    end = replied(1, Rejected(goal_id="p", reason="too far"))
    flight.journal(2.0, requested(1, goal, "get_images"), step(0.5), step(1.5), end, action="get_images")
    (rejected,) = flight.goals()
    assert (rejected.outcome, len(rejected.feedback)) == ("rejected", 1)
    assert rejected.duration_s == pytest.approx(1.0)


def test_replies_to_other_requests_are_no_goals(flight: Flight) -> None:
    cancel = Requested("@action/go_to/cancel", 7, "py-1", Raw(b'{"goal_id":"a"}'))
    flight.journal(2.0, cancel, step(1.0), Replied(7, Raw(b'{"canceled":false,"reason":"no goal a"}'), True))
    assert flight.goals() == []


def test_goals_of_a_part_of_the_recording(flight: Flight) -> None:
    flight.journal(2.0, requested(1), step(1.0), accepted(), step(1.5), succeeded(1.5))
    flight.journal(6.0, requested(2), step(5.0), accepted(2), step(5.5), succeeded(5.5, 2))
    (late,) = flight.goals(start_s=3.0)
    assert late.start_ns == 5 * SECOND_NS


def test_a_goal_of_another_version_is_refused_with_a_sentence(flight: Flight) -> None:
    unknown = Requested("@action/go_to", 1, "", Raw(b'{"target":[1,2,3]}'))
    flight.journal(2.0, unknown, step(1.0))
    with pytest.raises(RecordingError, match=r"journal/go_to does not fit this version"):
        flight.goals()


def test_feedback_is_grouped_by_goal() -> None:
    content = MoveFeedback(pos_uav_ned_m=(0.0, 0.0, -2.0), distance_m=1.0)
    a, b, c = (message(seconds, goal_id, content) for seconds, goal_id in ((1.0, "a"), (2.0, "b"), (3.0, "a")))
    assert feedback_by_goal([a, "other", b, c]) == [[a, c], [b]]
