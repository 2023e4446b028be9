"""Missions of the fault campaign take in whatever the stack is made of."""

from jezero.schemas.topics import ACTIONS
from jezero.trials.campaign.faults import Kind, draw_faults
from jezero.trials.campaign.mission import CampaignMission, named_random
from jezero.trials.campaign.models import MODELS, POINT_MASS
from jezero.trials.stack import service_makers


def test_a_mission_with_physics_begins_with_every_service_of_the_stack() -> None:
    mission = CampaignMission(1, model=MODELS["physics"])
    mission.bus.run_for(0.5)
    assert all(mission.bus.has(name) for name in service_makers(1))
    assert not mission.judge.violations


def test_a_mission_with_the_point_mass_begins_with_all_that_commands_the_vehicle() -> None:
    mission = CampaignMission(1, model=MODELS["point-mass"])
    mission.bus.run_for(0.5)
    assert all(mission.bus.has(name) for name in ("point_mass", "vehicle_bridge", *ACTIONS))
    assert not mission.judge.violations


def test_a_mission_has_as_many_faults_as_asked_for() -> None:
    assert len(CampaignMission(1, model=MODELS["point-mass"], fault_counts=range(40, 41)).faults) == 40
    assert all(3 <= len(draw_faults(named_random(seed, "faults"), 42.0)) <= 14 for seed in range(50))


def test_every_further_service_has_faults_of_its_own() -> None:
    faults = [f for seed in range(400) for f in draw_faults(named_random(seed, "faults"), 42.0, ("estimator",))]
    hit = {fault.kind for fault in faults if "estimator" in fault.where}
    assert hit >= {Kind.KILL, Kind.FREEZE, Kind.PARTITION, Kind.DELAY, Kind.DROP, Kind.NAN, Kind.WRONG_TIME}


def test_some_seeds_fly_missions_with_the_service_that_flies_them_and_others_single_goals() -> None:
    flown = [CampaignMission(seed, model=POINT_MASS) for seed in range(12)]
    missions = [mission for mission in flown if mission.missions is not None]
    assert 0 < len(missions) < len(flown)
    for mission in flown:
        assert bool(mission.clients) is (mission.missions is None)
        assert mission.bus.has("mission") is (mission.missions is not None)
