"""The target view of a landing: its phase, its cone, and what the estimate is worth."""

from math import nan
from typing import Any

import msgspec

from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.goals import LandFeedback, MoveFeedback
from jezero.services.ground_station.views import landing_view
from tests.services.ground_station.messages import covariance, relative

LANDING = FeedbackMessage(
    t_ns=0,
    goal_id="land",
    action="land_on_spot",
    code=8,
    feedback=LandFeedback(
        pos_uav_ned_m=(5.0, -3.0, -3.0), pos_rel_ned_m=(0.3, 0.4, -2.0), phase="descent", cone_m=0.17
    ),
)
ESTIMATE = relative(
    pos_uav_rel_rover_ned_m=(0.03, 0.04, -2.5),
    cov=covariance([[0.01, 0, 0], [0, 0.04, 0], [0, 0, 0.0025]]),
    inputs=("odometry", "uwb", "altimeter"),
    use_tag=True,
    goal_id="land",
)


def view(message: Any = LANDING, age_s: float = 0.1, estimate: Any = ESTIMATE, estimate_age_s: Any = 0.1) -> Any:
    shown = landing_view(message, age_s, estimate, estimate_age_s)
    assert shown is not None
    return shown


def texts(shown: Any) -> list[str]:
    return [row["text"] for row in shown["rows"]]


def test_the_position_and_its_uncertainty_are_those_of_a_valid_estimate() -> None:
    shown = view()
    assert shown["phase"] == "Descent: goes down while it is inside the cone"
    assert (shown["pos"], shown["cone"], shown["platform"]) == ([0.03, 0.04, -2.5], 0.17, True)
    assert texts(shown) == ["0.05", "0.60", "2.50", "0.15"]
    assert shown["verdict"] == {"tone": "good", "text": "estimate valid"}


def test_each_input_is_used_or_wanted_or_off() -> None:
    assert [row["state"] for row in view()["inputs"]] == ["used", "silent", "used"]
    by_tag_alone = msgspec.structs.replace(ESTIMATE, use_uwb=False, inputs=("odometry", "tag"))
    assert [row["state"] for row in view(estimate=by_tag_alone)["inputs"]] == ["off", "used", "off"]


def test_an_invalid_estimate_gives_its_reason_and_no_uncertainty() -> None:
    invalid = msgspec.structs.replace(ESTIMATE, valid=False, reason="no tag for 2 s")
    shown = view(estimate=invalid)
    assert shown["verdict"] == {"tone": "bad", "text": "estimate invalid: no tag for 2 s"}
    assert shown["axes"] is None
    assert texts(shown) == ["0.50", "–", "2.00", "–"]  # the position is the one that the landing goes on with


def test_a_silent_estimator_and_a_silent_landing_are_told() -> None:
    assert view(estimate_age_s=1.5)["verdict"]["text"] == "the estimator is silent"
    assert view(estimate=None, estimate_age_s=None)["verdict"]["text"] == "no estimate of the rover arrives"
    late = view(age_s=3.0)
    assert late["phase"] == "No news of the landing"
    assert late["late"]
    silent = view(age_s=3.0, estimate_age_s=3.0)
    assert silent["pos"] is None
    assert all(row["late"] for row in silent["rows"])


def test_a_position_that_is_not_finite_shows_no_number() -> None:
    broken = msgspec.structs.replace(ESTIMATE, pos_uav_rel_rover_ned_m=(nan, 0.0, -1.0))
    shown = view(estimate=broken)
    assert shown["pos"] is None
    assert texts(shown)[0] == "–"
    assert texts(shown)[2] == "–"


def test_a_landing_on_a_spot_has_no_platform_and_no_inputs() -> None:
    feedback = LandFeedback(pos_uav_ned_m=(0.0, 0.0, -3.0), pos_rel_ned_m=(0.3, 0.4, -3.0), phase="descent")
    shown = view(msgspec.structs.replace(LANDING, goal_id="other", feedback=feedback))
    assert (shown["platform"], shown["inputs"], shown["axes"]) == (False, [], None)
    assert texts(shown) == ["0.50", "–", "3.00", "–"]


def test_a_platform_that_is_searched_for_is_still_a_platform() -> None:
    searching = LandFeedback(pos_uav_ned_m=(0.0, 0.0, -3.0), phase="search")
    invalid = msgspec.structs.replace(ESTIMATE, valid=False, reason="not found")
    shown = view(msgspec.structs.replace(LANDING, feedback=searching), estimate=invalid)
    assert shown["platform"]
    assert shown["pos"] is None
    assert texts(shown) == ["–", "–", "–", "–"]


def test_another_goal_has_no_target_view() -> None:
    moving = MoveFeedback(pos_uav_ned_m=(0.0, 0.0, -3.0), distance_m=1.0)
    assert landing_view(msgspec.structs.replace(LANDING, feedback=moving), 0.1, ESTIMATE, 0.1) is None
    assert landing_view(None, None, ESTIMATE, 0.1) is None
