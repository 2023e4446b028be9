"""The world `mars`: the same services land another vehicle on the rover, and the recording knows the world."""

from pathlib import Path

import pytest

from jezero.recording import open_recording
from jezero.recording.journals import journaled_services
from jezero.replay.through import replay_through
from jezero.schemas.goals import GoToGoal, LandOnSpotGoal, TakeoffGoal
from jezero.schemas.topics import GO_TO, LAND_ON_SPOT, TAKEOFF
from jezero.trials.flight import fly_virtually
from jezero.trials.landing.flight import fly_landing
from jezero.trials.landing.trial import Conditions

MISSION = (
    (TAKEOFF, TakeoffGoal(altitude_m=2.0), 0.0),
    (GO_TO, GoToGoal(target_ned_m=(2.0, -3.0, -4.0)), 1.0),
    (LAND_ON_SPOT, LandOnSpotGoal(), 0.0),
)


@pytest.fixture(autouse=True)
def on_mars(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_WORLD", "mars")


def test_a_flight_on_mars_ends_on_the_rover_and_is_replayed_identically_on_earth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "flight.mcap"
    flight = fly_virtually(MISSION, 3, path)
    assert flight.reason == ""
    assert flight.touchdown_error_m is not None
    assert flight.touchdown_error_m < 0.1
    about = open_recording(path).summary().about
    assert about["world"] == "mars"
    assert "gravity_mps2 = 3.71" in about["settings/worlds/mars.toml"]
    monkeypatch.delenv("JEZERO_WORLD")
    replays = [replay_through(path, service) for service in journaled_services(path)]
    assert {"simulator", "autopilot", "vehicle_bridge", "land_on_spot"} <= {replay.service for replay in replays}
    assert [replay.service for replay in replays if not replay.identical] == []


@pytest.mark.parametrize("seed", [1, 2])
def test_the_vehicle_lands_on_a_driving_rover_on_mars(seed: int) -> None:
    landing = fly_landing(seed, Conditions(case="uwb+tag", rover="drive"))
    assert landing.failure == ""
    assert landing.error_m < 0.15
