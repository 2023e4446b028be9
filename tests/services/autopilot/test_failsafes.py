"""What is done about each thing that can be wrong, in each mode, on the ground and in the air."""

from itertools import product
from pathlib import Path

import msgspec
import pytest

from jezero.services.autopilot.config import FailsafeConfig
from jezero.services.autopilot.failsafes import (
    FailsafeAction,
    Trigger,
    configured_action,
    docs_section,
    failsafe_action,
    most_severe_action,
)
from jezero.services.autopilot.modes import Mode

DEFAULT = FailsafeConfig()
SETTINGS = [
    msgspec.convert({"com_obl_rc_act": obl, "nav_dll_act": dll, "com_low_bat_act": low}, FailsafeConfig)
    for obl, dll, low in product((0, 1, 2, 3, 4, 5, 6, 7), (0, 1, 2, 3, 5, 6), (0, 2, 3))
]
EVERYTHING = list(product(Trigger, Mode, (False, True)))
N, W, H, R, L, D, X = (
    FailsafeAction.NONE, FailsafeAction.WARN, FailsafeAction.HOLD, FailsafeAction.RETURN, FailsafeAction.LAND,
    FailsafeAction.DESCEND, FailsafeAction.DISARM,
)  # fmt: skip
MODES = (Mode.POSITION, Mode.TAKEOFF, Mode.HOLD, Mode.RETURN, Mode.LAND, Mode.DESCEND, Mode.OFFBOARD)
BY_DEFAULT = {
    Trigger.OFFBOARD_LOST: (N, N, N, N, N, N, L),
    Trigger.LINK_LOST: (N, N, N, N, N, N, N),
    Trigger.BATTERY_LOW: (W, W, W, W, W, W, W),
    Trigger.BATTERY_CRITICAL: (W, W, W, W, W, W, W),
    Trigger.BATTERY_EMERGENCY: (W, W, W, W, W, W, W),
    Trigger.POSITION_LOST: (D, D, D, D, D, N, D),
    Trigger.TILTED: (X, X, X, X, X, X, X),
}
ACTING = FailsafeConfig(com_obl_rc_act=5, nav_dll_act=2, com_low_bat_act=3)
WHEN_ACTING = {
    Trigger.OFFBOARD_LOST: (N, N, N, N, N, N, H),
    Trigger.LINK_LOST: (R, R, R, N, N, N, R),
    Trigger.BATTERY_LOW: (W, W, W, W, W, W, W),
    Trigger.BATTERY_CRITICAL: (R, R, R, N, N, N, R),
    Trigger.BATTERY_EMERGENCY: (L, L, L, L, N, N, L),
    Trigger.POSITION_LOST: (D, D, D, D, D, N, D),
    Trigger.TILTED: (X, X, X, X, X, X, X),
}


@pytest.mark.parametrize("trigger", list(Trigger))
@pytest.mark.parametrize(("config", "table"), [(DEFAULT, BY_DEFAULT), (ACTING, WHEN_ACTING)])
def test_in_the_air(trigger: Trigger, config: FailsafeConfig, table: dict[Trigger, tuple[FailsafeAction, ...]]) -> None:
    assert tuple(failsafe_action(trigger, mode, False, config) for mode in MODES) == table[trigger]


@pytest.mark.parametrize("config", SETTINGS)
def test_on_the_ground_nothing_keeps_it_flying_or_takes_off(config: FailsafeConfig) -> None:
    actions = {failsafe_action(trigger, mode, True, config) for trigger in Trigger for mode in Mode}
    assert actions.isdisjoint({FailsafeAction.HOLD, FailsafeAction.RETURN})


@pytest.mark.parametrize("config", SETTINGS)
def test_it_answers_to_everything_and_never_with_less_than_the_mode_does(config: FailsafeConfig) -> None:
    does = {Mode.HOLD: H, Mode.RETURN: R, Mode.LAND: L, Mode.DESCEND: D}
    for trigger, mode, landed in EVERYTHING:
        action = failsafe_action(trigger, mode, landed, config)
        assert action in {N, W} or action > does.get(mode, N)
        assert configured_action(trigger, config) >= action or landed


@pytest.mark.parametrize("landed", [False, True])
@pytest.mark.parametrize("mode", list(Mode))
def test_of_several_things_the_most_severe_counts_in_whatever_order(mode: Mode, landed: bool) -> None:
    for one, other in product(Trigger, Trigger):
        worst = max(failsafe_action(one, mode, landed, ACTING), failsafe_action(other, mode, landed, ACTING))
        assert most_severe_action((one, other), mode, landed, ACTING)[0] is worst
        assert most_severe_action((other, one), mode, landed, ACTING)[0] is worst
    assert most_severe_action((), mode, landed, ACTING) == (N, None)


def test_the_cause_of_an_action_is_the_trigger_of_the_most_severe_one_and_of_equal_ones_the_first() -> None:
    low, critical, lost = Trigger.BATTERY_LOW, Trigger.BATTERY_CRITICAL, Trigger.LINK_LOST
    for triggers, action, cause in (
        ((low, critical), R, critical),
        ((critical, low), R, critical),
        ((critical, lost), R, critical),
        ((lost, low, critical), R, lost),
        ((Trigger.OFFBOARD_LOST,), N, None),
    ):
        assert most_severe_action(triggers, Mode.POSITION, False, ACTING) == (action, cause)


def test_the_documentation_has_the_table() -> None:
    text = (Path(__file__).parents[3] / "docs" / "reliability.md").read_text()
    assert docs_section() in text, (
        "run python -m jezero.services.autopilot.failsafes and put its output between the marks"
    )
