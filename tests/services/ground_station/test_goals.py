"""The goal in charge, whichever client sent it."""

from typing import Any

import msgspec

from jezero.schemas.actions import FeedbackMessage, PlannedCoverage, RunningGoal
from jezero.schemas.images import Image
from jezero.services.ground_station.goals import Goals
from tests.services.ground_station.messages import IMAGE, Flight

FLIGHT = Flight()
PLAN = PlannedCoverage(
    plan_id="ab",
    path_ned_m=((0.0, 0.0), (5.0, 0.0)),
    pictures_ned_m=((0.0, 0.0), (2.5, 0.0), (5.0, 0.0)),
    start_ned_m=(0.0, 0.0),
    line_distance_m=1.0,
    picture_distance_m=2.5,
    length_m=5.0,
    duration_s=5.0,
    covered=1.0,
    photographed=1.0,
)


def flying(action: str = "area_coverage", goal_id: str = "py-1-1") -> Goals:
    goals = Goals()
    goals.on_status(FLIGHT.status(code=10, in_charge="goal", action=action, goal_id=goal_id))
    return goals


def feedback(
    goal_id: str = "py-1-1", taken: int = 0, images: tuple[Image, ...] = (), changes: int = 0
) -> FeedbackMessage[dict[str, Any]]:
    fields = {"phase": "flying", "taken": taken, "planned": 12, "images": msgspec.to_builtins(images)}
    return FeedbackMessage(
        t_ns=0,
        goal_id=goal_id,
        action="area_coverage",
        code=10,
        feedback=fields,
        remaining_s=75.0,
        changes=changes,
    )


def test_the_progress_of_another_clients_goal_is_shown() -> None:
    goals = flying()
    goals.on_feedback(0.1, feedback(taken=3))
    goal = goals.progress(0.2)
    assert goal is not None
    assert goal["text"] == "3 of 12 images · flying · 1 min 15 s left"
    assert goal["done"] == 0.25
    late = goals.progress(5.0)
    assert late is not None
    assert late["text"] == "no news of its progress"


def test_feedback_of_an_earlier_goal_is_no_progress_of_this_one() -> None:
    goals = flying()
    goals.on_feedback(0.1, feedback("before", taken=3))
    goal = goals.progress(0.2)
    assert goal is not None
    assert goal["text"] == "no news of its progress"


def test_without_a_goal_in_charge_there_is_no_progress() -> None:
    goals = flying()
    goals.on_status(FLIGHT.status())
    assert goals.progress(0.1) is None
    assert goals.drawing() == {"path": [], "pictures": [], "taken": []}


def test_a_goal_has_the_owner_that_its_server_names() -> None:
    goals = flying()
    assert goals.owner("py-1", ()) == ""
    goals.on_running(RunningGoal(action="area_coverage", goal_id="py-1-1", clients=("py-1",)))
    assert goals.owner("py-1", {"py-1-1"}) == "sent from this page"
    assert goals.owner("py-1", ()) == "sent from another page of this ground station"
    assert goals.owner("py-2", ()) == "sent by another program"
    goals.on_running(RunningGoal(action="area_coverage", goal_id="py-1-1"))
    assert goals.owner("py-2", ()) == "its sender is gone"
    goals = flying(goal_id="m-7.3.1")
    goals.on_running(RunningGoal(action="area_coverage", goal_id="m-7.3.1"))
    assert goals.owner("py-2", ()) == "sent by a mission"


def test_the_servers_are_asked_once_for_a_goal_and_again_for_images_that_are_missing() -> None:
    goals = flying()
    assert goals.wants_running(10.0)
    assert not goals.wants_running(10.1)
    goals.on_running(RunningGoal(action="area_coverage", goal_id="py-1-1"))
    assert not goals.wants_running(20.0)
    goals.on_feedback(20.0, feedback(taken=2, images=(IMAGE,)))
    assert goals.wants_running(20.1)


def test_the_servers_are_asked_for_the_new_way_of_a_goal_that_was_changed() -> None:
    goals = flying()
    assert goals.wants_running(10.0)
    goals.on_running(RunningGoal(action="area_coverage", goal_id="py-1-1"))
    goals.on_feedback(20.0, feedback(changes=1))
    assert goals.wants_running(20.1)
    assert goals.wants_running(30.0)  # no reply came
    goals.on_running(RunningGoal(action="area_coverage", goal_id="py-1-1", path_ned_m=((1.0, 2.0, -3.0),)))
    assert not goals.wants_running(40.0)
    assert goals.drawing()["path"] == [[1.0, 2.0, -3.0]]


def test_a_coverage_is_drawn_with_its_plan_and_the_images_that_are_taken() -> None:
    goals = flying()
    path_ned_m = ((1.0, 2.0, -3.0), (0.0, 0.0, -4.0), (5.0, 0.0, -4.0))
    goals.on_running(RunningGoal(action="area_coverage", goal_id="py-1-1", coverage=PLAN, path_ned_m=path_ned_m))
    goals.on_feedback(0.1, feedback(taken=1, images=(IMAGE,)))
    assert goals.drawing() == {
        "path": [[1.0, 2.0, -3.0], [0.0, 0.0, -4.0], [5.0, 0.0, -4.0]],
        "pictures": [[0.0, 0.0], [2.5, 0.0], [5.0, 0.0]],
        "taken": [0],
    }


def test_the_places_of_images_relative_to_the_rover_are_not_drawn() -> None:
    goals = flying()
    goal = {"frame": "rover"}
    goals.on_running(RunningGoal(action="area_coverage", goal_id="py-1-1", goal=goal, coverage=PLAN))
    assert goals.drawing()["pictures"] == []


def test_a_reply_about_another_goal_changes_nothing() -> None:
    goals = flying()
    goals.on_running(RunningGoal(action="go_to", goal_id="other", clients=("me",)))
    assert goals.owner("", ()) == ""
