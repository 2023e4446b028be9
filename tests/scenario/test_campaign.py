"""The fault campaign: missions pass and replay exactly, and builds that are broken on purpose are caught."""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

from jezero.deploy.campaign.campaign import fly_campaign
from jezero.deploy.campaign.clients import draw_goal
from jezero.deploy.campaign.faults import FAULTS_MIN, PARTITION_MAX_S, Kind, draw_faults
from jezero.deploy.campaign.judge import ALLOWED
from jezero.deploy.campaign.mission import MissionReport, fly_mission, named_random
from jezero.schemas import topics
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import ACTIONS
from jezero.services.actions.table import action_server
from jezero.services.vehicle_bridge import admission, authority
from jezero.services.vehicle_bridge.authority import Authority
from jezero.services.vehicle_bridge.transitions import is_allowed
from tests.scenario.rig import Flight, go_to

HASH = "from jezero.deploy.campaign.mission import fly_mission; print(fly_mission(2019).log_sha256)"


def test_a_mission_passes_and_replays_exactly_in_another_process() -> None:
    reports: list[MissionReport] = []
    result = fly_campaign((2019,), jobs=1, tell=reports.append)
    assert result.failed == {} and result.seeds == 1 and result.sim_time_s > 60.0
    assert sum(result.faults.values()) >= FAULTS_MIN
    assert result.states["HOVER"] >= 2
    run = subprocess.run([sys.executable, "-c", HASH], capture_output=True, text=True, check=True)
    assert run.stdout.split()[-1] == reports[0].log_sha256


def test_every_kind_of_fault_is_drawn_and_no_partition_is_too_long() -> None:
    faults = [fault for seed in range(300) for fault in draw_faults(named_random(seed, "faults"), 50.0)]
    assert {fault.kind for fault in faults} == set(Kind)
    assert len(faults) >= 300 * FAULTS_MIN
    assert all(f.duration_s <= PARTITION_MAX_S for f in faults if f.kind is Kind.PARTITION)


def test_the_clients_know_what_to_send_to_every_action() -> None:
    for action in ACTIONS.values():
        assert draw_goal(action, named_random(1, "goals"), "g-1", 5).goal_id == "g-1"


def test_the_table_of_transitions_stated_anew_is_the_bridges() -> None:
    codes = list(StatusCode)
    assert {(a, b) for a in codes for b in codes if is_allowed(a, b)} == ALLOWED


def is_caught(rule: str, *seeds: int) -> bool:
    """Whether one of the seeds breaks a rule; further ones are for the case that a first one happens not to."""
    return any(f": {rule}: " in violation for seed in seeds for violation in fly_mission(seed).violations)


def without(refusals: Callable[..., Any], words: str) -> Callable[..., Any]:
    """A generator of refusals that leaves some out."""

    def remaining(*args: Any) -> Any:
        return (refusal for refusal in refusals(*args) if words not in refusal)

    return remaining


def test_a_bridge_that_does_not_check_the_age_of_setpoints_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = without(admission._setpoint_refusals, " s old; accepted are")
    monkeypatch.setattr(admission, "_setpoint_refusals", broken)
    assert is_caught("only the owner's fresh setpoints", 42, 136, 48, 120)


def test_a_bridge_that_loses_releases_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Authority, "release", lambda self, request, now, resets: "")
    assert is_caught("who gives control back has none", 0, 1)


def test_a_bridge_that_grants_control_twice_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(authority, "why_not_acquire", lambda *args: "")
    assert is_caught("one owner at most", 0, 1, 2)


def test_a_bridge_that_engages_again_after_a_failsafe_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    lose = Authority._lose

    def lose_and_take_back(self: Authority, other: Any, why: str, now: Any) -> None:
        lose(self, other, why, now)
        self._begin_taking_back(now)

    monkeypatch.setattr(Authority, "_lose", lose_and_take_back)
    assert is_caught("silence after a failsafe or takeover", 2008, 2003, 6)


def test_a_goal_sent_again_to_a_restarted_server_does_not_fly_again() -> None:
    flight = Flight()
    flight.take_off()
    goal = go_to(8.0, 0.0, -3.0, goal_id="g-1")
    flight.send(topics.GO_TO, goal)
    flight.wait_code(StatusCode.GO_TO, 2.0)
    flight.bus.remove("go_to")
    flight.wait_code(StatusCode.HOVER, 2.0)
    flight.bus.add(action_server("go_to", boot_id=777))
    flight.bus.run_for(0.5)
    assert "runs once" in flight.refusal(topics.GO_TO, goal)
    assert flight.codes[-1] is StatusCode.HOVER
