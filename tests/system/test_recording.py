"""Recordings of stacks flown by hand, as other programs read them, and the live view of Foxglove."""

import json
import shutil
import signal
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from mcap.reader import make_reader

from jezero.base.config import config_directory
from jezero.base.frames import distance
from jezero.deploy.launcher.ports import service_environment
from jezero.recording import open_recording
from jezero.recording.folder import newest_recording
from jezero.recording.images import decompress
from jezero.recording.journals import journaled_services
from jezero.recording.viewer_scene import CALIBRATION, MESSAGES, TRANSFORMS
from jezero.replay.through import replay_through
from jezero.schemas import topics
from jezero.schemas.landing_board import BIG_ID
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.topics import ACTIONS
from jezero.services.estimator.tag_detector.config import TagDetectorConfig
from jezero.services.estimator.tag_detector.finder import Finder
from tests.recording.doctor import examine
from tests.recording.foxglove_client import FoxgloveClient
from tests.recording.frames_of_viewers import Motion, from_parent, in_map, time_ns, to_parent
from tests.system.conftest import Stack, new_stack, wait_for

TIMEOUT_S = 20.0
FLIGHTS = (("land_on_spot", "--yes"), ("target", "1", "2", "-3"))
"""Command after the take-off of each flight; the stack of the second is stopped in the air."""


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The recordings of two flights of one run folder, with lossless images, of which there are fewer than usual."""
    folder = tmp_path_factory.mktemp("flown")
    shutil.copytree(config_directory(), folder / "config")
    (folder / "config" / "recorder.toml").write_text('images = "png"\n')
    (folder / "config" / "vehicle.toml").write_text("[camera]\nrate_hz = 5.0\n")
    with new_stack(folder, whole=True) as stack:
        stack.environment["JEZERO_CONFIG_DIR"] = str(folder / "config")
        for words in FLIGHTS:
            stack.up()
            stack.jezero("takeoff", "2")
            stack.jezero(*words)
            stack.jezero("down")
        return sorted((stack.run_dir / "recordings").glob("*.mcap"))


@pytest.mark.long
def test_two_flights_by_hand_leave_two_recordings_that_other_programs_accept(recordings: list[Path]) -> None:
    assert len(recordings) == 2
    for path in recordings:
        counts = examine(path)
        assert {topic.name for topic in (topics.ODOMETRY, topics.STATUS, topics.TRUTH, topics.CAMERA)} <= counts.keys()
        assert counts.keys() >= MESSAGES.keys()
        assert open_recording(path).summary().problem == ""


@pytest.mark.long
def test_every_service_of_real_processes_is_replayed_identically(recordings: list[Path]) -> None:
    landing = recordings[0]
    services = journaled_services(landing)
    assert {"simulator", "camera", "autopilot", "vehicle_bridge", "estimator", "tag_detector"} <= set(services)
    assert set(ACTIONS) <= set(services)
    for service in services:
        replay = replay_through(landing, service)
        assert replay.first_difference is None, service
        assert replay.steps > 0 and replay.lossy_images == 0


def test_a_recording_names_the_goals_flown_by_hand(recordings: list[Path]) -> None:
    ends = [[(goal.action, goal.outcome) for goal in open_recording(path).goals()] for path in recordings]
    assert ends[0] == [("takeoff", "succeeded"), ("land_on_spot", "succeeded")]
    assert ends[1] == [("takeoff", "succeeded"), ("go_to", "succeeded")]


def test_the_autopilot_of_the_settings_is_in_the_recording(tmp_path: Path) -> None:
    settings = tmp_path / "settings"
    shutil.copytree(config_directory(), settings)
    (settings / "autopilot.toml").write_text('autopilot = "px4"\n')
    with new_stack(tmp_path) as stack:
        environment = {**stack.environment, "JEZERO_AUTOPILOT": "", "JEZERO_CONFIG_DIR": str(settings)}
        service = {**environment, **service_environment(stack.instance, stack.run_dir)}
        programs = (("jezero.runtime.router", environment), ("jezero.services.recorder", service))
        processes = [subprocess.Popen([sys.executable, "-m", name], env=variables) for name, variables in programs]
        try:
            wait_for(lambda: newest_recording(stack.run_dir), TIMEOUT_S, "a recording")  # of the router's health
        finally:
            for process in reversed(processes):
                process.terminate()
                process.wait(TIMEOUT_S)
        assert open_recording(stack.run_dir).summary().about["autopilot"] == "px4"


def test_the_scene_of_a_real_flight_has_the_vehicle_where_it_was(recordings: list[Path]) -> None:
    for path in recordings:
        with path.open("rb") as file:
            newest: dict[str, Any] = {}
            for _, channel, message in make_reader(file).iter_messages([TRANSFORMS, topics.ODOMETRY.name]):
                if (
                    channel.topic != TRANSFORMS
                ):  # when a stack ends in flight, the vehicle falls after its last odometry
                    at_odometry = dict(newest)
                newest[channel.topic] = json.loads(message.data)
        table = open_recording(path).table("odometry")
        assert np.abs(table["pos_uav_ned_m"][:, 2]).max() > 1.5
        true, shown = (in_map(at_odometry[TRANSFORMS], frame) for frame in ("frd_true", "frd"))
        assert distance(true, shown) < 2.0


def test_the_scene_drawn_into_an_image_meets_what_the_image_shows(recordings: list[Path]) -> None:
    landing = recordings[0]
    messages: dict[str, list[Any]] = defaultdict(list)
    with landing.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages([TRANSFORMS, CALIBRATION, topics.CAMERA.name]):
            messages[channel.topic].append(json.loads(message.data))
    motion = Motion(messages[TRANSFORMS])
    projection = np.reshape(messages[CALIBRATION][0]["P"], (3, 4))
    finder = Finder(TagDetectorConfig())
    distances_px = []
    for image in messages[topics.CAMERA.name]:
        pixels = decompress(json.dumps(image).encode())
        exposed_ns = time_ns(image["timestamp"])
        for tag in finder.find(frame_of(pixels)):
            if tag.tag_id == BIG_ID:
                middle_world_m = to_parent(motion.at("rover_body_true", exposed_ns), (0.0, 0.0, 0.0))
                middle_frd_m = from_parent(motion.at("frd_true", exposed_ns), middle_world_m)
                u, v, w = projection @ (*from_parent(motion.at("camera", exposed_ns), middle_frd_m), 1.0)
                distances_px.append(float(np.linalg.norm(np.mean(tag.corners_px, axis=0) - (u / w, v / w))))
    assert len(distances_px) >= 10
    assert np.median(distances_px) < 4.0  # 13 px if the times were those of the arrival


def frame_of(pixels: npt.NDArray[np.uint8]) -> CameraFrame:
    """A frame with the pixels of a recorded image; its other fields are not used."""
    height_px, width_px, _ = pixels.shape
    return CameraFrame(
        t_ns=0,
        sequence=0,
        width_px=width_px,
        height_px=height_px,
        pitch_camera_rad=0.0,
        exposure_s=0.0,
        pixels=pixels.tobytes(),
    )


def receive_until(client: FoxgloveClient, condition: Callable[[], object], description: str) -> None:
    def received() -> object:
        client.receive(0.1)
        return condition()

    wait_for(received, TIMEOUT_S, description)


@pytest.mark.long
@pytest.mark.whole
def test_foxglove_watches_a_running_stack_and_goes_on_after_its_restart(stack: Stack) -> None:
    watch = stack.start("watch", "--foxglove", "--port", "0", "--json")
    assert watch.stdout is not None
    serving = json.loads(watch.stdout.readline())
    assert serving["url"].startswith("ws://127.0.0.1:")
    camera, wanted = topics.CAMERA.name, ("odometry", "status", "viewer/transforms", "viewer/scene")
    try:
        with FoxgloveClient(serving["port"]) as client:
            receive_until(client, lambda: {*wanted, camera} <= client.channels.keys(), "channels")
            for topic in wanted:
                client.subscribe(topic)
            receive_until(client, lambda: set(wanted) <= client.messages.keys(), "messages")
            assert camera not in client.messages
            client.subscribe(camera)
            receive_until(client, lambda: camera in client.messages, "an image")
            _, transforms = client.messages["viewer/transforms"][-1]
            assert distance(in_map(transforms, "frd"), in_map(transforms, "frd_true")) < 2.0
            client.unsubscribe(camera)  # nobody reads while the stack starts
            stack.jezero("down")
            stack.up()
            client.subscribe("clock")
            receive_until(client, lambda: "clock" in client.messages, "messages of the new stack")
        watch.send_signal(signal.SIGINT)
        assert watch.wait(timeout=TIMEOUT_S) == 0
    finally:
        watch.kill()
        watch.communicate()
