"""The worlds that jezero ships beside Mars: the same mission ends on the rover in each, and a hut's roof carries."""

from pathlib import Path

import pytest

from jezero.recording import open_recording
from jezero.schemas.goals import GoToGoal, LandOnSpotGoal, TakeoffGoal
from jezero.schemas.topics import GO_TO, LAND_ON_SPOT, STATUS, TAKEOFF, TRUTH
from jezero.trials.flight import fly_virtually

TO_THE_ROVER = (
    (TAKEOFF, TakeoffGoal(altitude_m=2.0), 0.0),
    (GO_TO, GoToGoal(target_ned_m=(3.0, -2.0, -4.0)), 1.0),
    (LAND_ON_SPOT, LandOnSpotGoal(), 0.0),
)
ROOF_NED_M = (14.0, -6.0, -2.6)
TO_THE_ROOF = (
    (TAKEOFF, TakeoffGoal(altitude_m=5.0), 0.0),
    (GO_TO, GoToGoal(target_ned_m=(14.0, -6.0, -5.0)), 1.0),
    (LAND_ON_SPOT, LandOnSpotGoal(landing_spot_ned_m=ROOF_NED_M, use_uwb=False, use_tag=False), 0.0),
)


@pytest.mark.parametrize("world", ["playground", "harbour"])
def test_the_vehicle_lands_on_the_rover(world: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_WORLD", world)
    flight = fly_virtually(TO_THE_ROVER, 3)
    assert flight.reason == ""
    assert flight.touchdown_error_m is not None
    assert flight.touchdown_error_m < 0.15


def test_the_vehicle_lands_on_the_roof_of_a_hut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The autopilot's own position may be a metre wrong, and the roof is 3.6 m wide."""
    monkeypatch.setenv("JEZERO_WORLD", "playground")
    path = tmp_path / "flight.mcap"
    flight = fly_virtually(TO_THE_ROOF, 3, path)
    assert "platform" in flight.reason  # it isn't on the rover
    recording = open_recording(path)
    truth = [entry.message for entry in recording.messages(TRUTH.name)][-1]
    status = [entry.message for entry in recording.messages(STATUS.name)][-1]
    north_m, east_m, down_m = truth.pos_uav_ned_m
    assert not status.armed
    assert (north_m, east_m) == pytest.approx(ROOF_NED_M[:2], abs=1.2)
    assert 2.4 < -down_m < 3.0
