"""The confirmation of a goal in words, and for how long it holds."""

import pytest

from jezero.schemas.actions import PlanReply
from jezero.services.ground_station.confirmation import TIMEOUT_S, Confirmation

PATH = ((0.0, 0.0, -2.5), (0.0, 0.0, -6.5), (9.0, 0.0, -3.0))
PLAN = PlanReply(accepted=True, duration_s=34.2, distance_m=41.3, battery_used=0.048, path_ned_m=PATH)


def test_the_button_says_time_length_battery_and_highest_point_above_the_start() -> None:
    asked = Confirmation({}, {}, PLAN, 0.0)
    assert asked.words(0.0) == "Confirm: 34 s, 41 m, 5 % of the battery, up to 6.5 m"
    assert asked.words(-0.5) == "Confirm: 34 s, 41 m, 5 % of the battery, up to 6 m"


@pytest.mark.parametrize(("used", "words"), [(0.0, "0 %"), (0.001, "1 %"), (0.05, "5 %"), (0.0514, "6 %")])
def test_the_battery_is_rounded_up(used: float, words: str) -> None:
    assert Confirmation({}, {}, PlanReply(accepted=True, battery_used=used), 0.0).words(0.0) == (
        f"Confirm: {words} of the battery"
    )


def test_a_plan_without_figures_is_confirmed_without_figures() -> None:
    assert Confirmation({}, {}, PlanReply(accepted=True), 0.0).words(0.0) == "Confirm"


def test_a_confirmation_holds_for_the_planned_goal_and_for_a_minute() -> None:
    asked = Confirmation({"altitude_m": 3.0}, {"altitude_m": "3"}, PLAN, 10.0)
    assert asked.holds_for({"altitude_m": "3"}, 10.0 + TIMEOUT_S)
    assert not asked.holds_for({"altitude_m": "3"}, 10.1 + TIMEOUT_S)
    assert not asked.holds_for({"altitude_m": "30"}, 11.0)
