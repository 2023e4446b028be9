"""The scene of a whole flight, against the flight's own messages and the truth."""

import json
from collections import defaultdict
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from jezero.base.frames import distance, enu_from_ned
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording.viewer_scene import LOCATION, SCENE, TRANSFORMS
from jezero.recording.writer import RECORDING
from jezero.trials.flight import fly_virtually
from jezero.trials.missions import FLIGHT
from tests.recording.frames_of_viewers import in_map

pytestmark = pytest.mark.xdist_group("viewer scene")

STAND_M = np.array((0.0, 0.0, VehicleConfig().airframe.height_stand_m))
Messages = dict[str, list[Any]]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Messages:
    """Messages of a flight that lands on the rover, by channel.

    Each is (time in ns, message); transforms are (time in ns, message, newest odometry, newest truth) at their writing.
    """
    path = tmp_path_factory.mktemp("run") / RECORDING
    assert fly_virtually(FLIGHT, 3, path).result == "succeeded"
    messages: Messages = defaultdict(list)
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            entry: tuple[Any, ...] = (message.log_time, json.loads(message.data))
            if channel.topic == TRANSFORMS:
                entry += (newest(messages["odometry"]), newest(messages["truth"]))
            messages[channel.topic].append(entry)
    return messages


def newest(messages: list[Any]) -> Any:
    return messages[-1][1] if messages else None


def test_vehicle_and_rover_are_where_the_flight_had_them(flight: Messages) -> None:
    with_odometry = [each for each in flight[TRANSFORMS] if each[2] is not None]
    assert len(with_odometry) > 250
    for _, transforms, odometry, truth in with_odometry:
        assert in_map(transforms, "frd") == pytest.approx(STAND_M + enu_from_ned(odometry["pos_uav_ned_m"]))
        assert in_map(transforms, "frd_true") == pytest.approx(STAND_M + enu_from_ned(truth["pos_uav_ned_m"]))
        assert in_map(transforms, "rover_body_true") == pytest.approx(enu_from_ned(truth["pos_rover_ned_m"]))
        assert distance(in_map(transforms, "frd"), in_map(transforms, "frd_true")) < 1.5  # GNSS


def test_the_vehicle_stands_on_the_rover_at_the_end(flight: Messages) -> None:
    _, transforms, _, _ = flight[TRANSFORMS][-1]
    above_m = np.subtract(in_map(transforms, "frd_true"), in_map(transforms, "rover_body_true")) - STAND_M
    assert np.abs(above_m).max() < 0.15
    above_m = np.subtract(in_map(transforms, "frd"), in_map(transforms, "rover_body")) - STAND_M
    assert np.abs(above_m).max() < 0.3


def test_the_scene_shows_vehicle_rover_paths_and_status_a_second_apart(flight: Messages) -> None:
    assert all(b - a <= 1_100_000_000 for (a, _), (b, _) in zip(flight[SCENE], flight[SCENE][1:], strict=False))
    entities = {entity["id"]: entity for entity in flight[SCENE][-1][1]["entities"]}
    assert {"frd", "frd_true", "rover_body", "rover_body_true", "path flown", "status"} <= entities.keys()
    flown = [[p["x"], p["y"], p["z"]] for p in entities["path flown"]["lines"][0]["points"]]
    true = np.array([message["pos_uav_ned_m"] for _, message in flight["truth"]])
    gaps_m = [float(np.linalg.norm(true - point, axis=1).min()) for point in flown]
    assert len(flown) > 50 and max(gaps_m) < 1.5


def test_positions_on_the_earth_are_those_of_the_gnss_receiver(flight: Messages) -> None:
    fix = newest(flight[LOCATION])
    gnss = newest(flight["sensor/gnss"])["position_deg"]
    assert fix["latitude"] == pytest.approx(gnss[0], abs=3e-5)
    assert fix["longitude"] == pytest.approx(gnss[1], abs=3e-5)
    assert fix["altitude"] == pytest.approx(gnss[2], abs=5.0)
