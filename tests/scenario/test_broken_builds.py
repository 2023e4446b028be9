"""A test of the campaign itself: bridges and missions that are broken on purpose are caught by the seeds from 0 on.

The seeds are not selected: they are flown in order until one breaks the rule, at most `SEEDS`. With the point mass that
takes seconds; `make broken` does the same with full physics.
"""

from collections.abc import Callable
from typing import Any

import pytest

from jezero.services.mission import service as mission
from jezero.services.vehicle_bridge import admission, authority, fence
from jezero.services.vehicle_bridge.authority import Authority
from jezero.trials.campaign.mission import fly_mission

SEEDS = 200

Break = Callable[[pytest.MonkeyPatch], None]


def takes_setpoints_of_any_age(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(authority, "MAX_AGE_NS", 10**18)
    patch.setattr(authority, "MAX_LEAD_NS", 10**18)


def loses_releases(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Authority, "release", lambda self, request, vehicle, resets: None)


def grants_control_twice(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(admission, "acquire_refusal", lambda *args: None)


def engages_again_after_a_failsafe(patch: pytest.MonkeyPatch) -> None:
    lose_control = Authority._lose_control

    def lose_and_take_back(self: Authority, holder: Any, reason: str, vehicle: Any) -> None:
        lose_control(self, holder, reason, vehicle)
        self._begin_taking_back(vehicle)

    patch.setattr(Authority, "_lose_control", lose_and_take_back)


def limits_no_target_at_a_fence(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(fence, "limited_target", lambda fence, limits, target, vehicle, **_: (target, ""))


def flies_missions_on_after_a_takeover(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(mission, "somebody_else", lambda status, mission_id: "")
    patch.setattr(mission.MissionService, "_watch_interventions", lambda self, inbox: ())


BROKEN: dict[Break, str] = {
    takes_setpoints_of_any_age: "only the owner's fresh setpoints",
    loses_releases: "released control stays released",
    grants_control_twice: "one owner at most",
    engages_again_after_a_failsafe: "silence after a failsafe or takeover",
    limits_no_target_at_a_fence: "stays inside the fence",
    flies_missions_on_after_a_takeover: "no goal of a mission after a takeover, until a command",
}
"""The fault of each broken build, and the promise that it breaks."""

QUICK = (limits_no_target_at_a_fence,)
"""Those that `make test-all` flies; `make broken` flies all."""
CASES = [pytest.param(broken, marks=() if broken in QUICK else pytest.mark.slow) for broken in BROKEN]


def first_seed_that_breaks(rule: str, model: str) -> int | None:
    for seed in range(SEEDS):
        report = fly_mission(seed, model=model)
        if any(f": {rule}: " in violation for violation in report.violations):
            return seed
    return None


@pytest.mark.long
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("broken", CASES, ids=lambda broken: broken.__name__)
@pytest.mark.parametrize("model", ["point-mass", pytest.param("physics", marks=pytest.mark.slow)])
def test_a_broken_build_is_caught(monkeypatch: pytest.MonkeyPatch, model: str, broken: Break) -> None:
    broken(monkeypatch)
    seed = first_seed_that_breaks(BROKEN[broken], model)
    assert seed is not None, f"a build that {broken.__name__} went unnoticed in {SEEDS} missions"
    print(f"{model}: a build that {broken.__name__} is caught by seed {seed}")
