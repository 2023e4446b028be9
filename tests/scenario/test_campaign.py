"""The fault campaign: missions pass and replay exactly, and faults that they found stay fixed."""

import os
import subprocess
import sys
from functools import partial

import pytest

from jezero.schemas import topics
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import ACTIONS
from jezero.services.actions.table import action_server
from jezero.services.vehicle_bridge.admission import is_allowed
from jezero.trials.campaign.campaign import CampaignReport, fly_campaign
from jezero.trials.campaign.clients import draw_goal
from jezero.trials.campaign.faults import FAULT_COUNTS, PARTITION_MAX_S, Fault, Kind, draw_faults
from jezero.trials.campaign.judge import ALLOWED
from jezero.trials.campaign.mission import CampaignMission, fly_mission, named_random
from jezero.trials.campaign.models import MODELS
from tests.scenario.rig import Flight, go_to

HASH = (
    "from jezero.trials.campaign.mission import fly_mission; print(fly_mission(2019, model={model!r}).messages_sha256)"
)


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("model", MODELS)
def test_a_mission_passes_and_replays_exactly_in_another_process(model: str) -> None:
    reports = list(fly_campaign((2019,), jobs=1, mission=partial(fly_mission, model=model)))
    result = CampaignReport()
    result.add(reports[0])
    assert result.failed == {} and result.seeds == 1 and result.sim_time_s > 60.0
    assert sum(result.faults.values()) >= FAULT_COUNTS[0]
    assert result.states["HOVER"] >= 2
    command, environment = [sys.executable, "-c", HASH.format(model=model)], {**os.environ, "PYTHONHASHSEED": "99"}
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert run.stdout.split()[-1] == reports[0].messages_sha256


def test_another_seed_is_another_mission() -> None:
    one, other = (fly_mission(seed, model="point-mass") for seed in (2019, 2020))
    assert one.messages_sha256 != other.messages_sha256


def test_every_kind_of_fault_is_drawn_and_no_partition_is_too_long() -> None:
    faults = [fault for seed in range(300) for fault in draw_faults(named_random(seed, "faults"), 42.0)]
    assert {fault.kind for fault in faults} == set(Kind)
    assert len(faults) >= 300 * FAULT_COUNTS[0]
    assert all(f.duration_s <= PARTITION_MAX_S for f in faults if f.kind is Kind.PARTITION)


def test_the_clients_know_what_to_send_to_every_action() -> None:
    for action in ACTIONS.values():
        assert draw_goal(action, named_random(1, "goals"), "g-1", 5).goal_id == "g-1"


def test_the_judges_table_of_transitions_equals_the_bridges() -> None:
    codes = list(StatusCode)
    assert {(a, b) for a in codes for b in codes if is_allowed(a, b)} == ALLOWED


@pytest.mark.long
def test_a_vehicle_whose_simulator_is_gone_needs_no_commander() -> None:
    mission = CampaignMission(1)
    mission.faults = [
        Fault(Kind.KILL, "vehicle_bridge", "bus", start_s=7.0, duration_s=1.6),
        Fault(Kind.KILL, "simulator", "bus", start_s=7.6, duration_s=2.0),
    ]
    assert mission.fly().violations == []
    assert mission.judge.states["EXTERNAL"], "the bridge came back before the simulator"


@pytest.mark.long
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
