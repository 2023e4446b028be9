"""Services replayed from the recordings of flights in virtual time: their outputs are the recorded ones, bit by bit."""

from pathlib import Path
from shutil import copytree

import pytest

from jezero.base.config import config_directory
from jezero.recording.journals import journaled_services
from jezero.replay.through import Replay, replay_through
from jezero.schemas import topics
from jezero.schemas.goals import AreaCoverageGoal, GetImagesGoal, LandOnSpotGoal, TakeoffGoal
from jezero.trials.campaign.mission import CampaignMission
from jezero.trials.flight import fly_virtually
from jezero.trials.recording import virtual_recording

pytestmark = pytest.mark.long

MISSION = (
    (topics.TAKEOFF, TakeoffGoal(altitude_m=2.0), 0.0),
    (topics.GET_IMAGES, GetImagesGoal(center_ned_m=(0.0, 0.0, -3.0), radius_m=2.0, num_images=2, frame="rover"), 0.0),
    (
        topics.AREA_COVERAGE,
        AreaCoverageGoal(
            polygon_ned_m=((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)), z_ned_m=-4.0, resolution_m=1.0, frame="rover"
        ),
        0.0,
    ),
    (topics.LAND_ON_SPOT, LandOnSpotGoal(), 0.0),
)
READERS_OF_IMAGES = ("tag_detector", "get_images", "area_coverage")


def replays(path: Path, services: list[str]) -> dict[str, Replay]:
    """The replay of each service, which has steps and no gap."""
    found = {service: replay_through(path, service) for service in services}
    assert all(replay.steps > 0 and replay.gap_s is None for replay in found.values())
    return found


def first_differences(found: dict[str, Replay]) -> dict[str, object]:
    """The first difference of each service whose replay is not identical."""
    return {service: replay.first_difference for service, replay in found.items() if not replay.identical}


def test_every_service_of_a_flight_with_lossless_images_is_replayed_identically(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, path = tmp_path / "config", tmp_path / "flight.mcap"
    copytree(config_directory(), settings)
    (settings / "recorder.toml").write_text('images = "png"\n')
    (settings / "vehicle.toml").write_text("[camera]\nrate_hz = 5.0\nwidth_px = 320\nheight_px = 240\n")
    monkeypatch.setenv("JEZERO_CONFIG_DIR", str(settings))
    assert fly_virtually(MISSION, 1, path, on_images=lambda images: None).reason == ""
    services = journaled_services(path)
    assert {"simulator", "camera", "autopilot", "vehicle_bridge", "estimator", *READERS_OF_IMAGES} <= set(services)
    found = replays(path, services)
    assert first_differences(found) == {}
    assert all(found[name].lossy_images == 0 for name in READERS_OF_IMAGES)


@pytest.mark.parametrize(
    "seed", [9, pytest.param(23, marks=pytest.mark.slow)], ids=["bridge killed", "estimator killed"]
)
def test_services_of_a_mission_with_faults_are_replayed_identically(seed: int, tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    with virtual_recording(path, seed) as writer:
        CampaignMission(seed, record=writer.write).fly()
    of_the_mission = {"simulator", "blank_camera"}  # the first one's outputs are changed by faults before they are sent
    services = sorted(set(journaled_services(path)) - of_the_mission)
    assert first_differences(replays(path, services)) == {}
