"""A stack on the twin: its camera is a plug of the hardware, and what is built on pictures works unchanged."""

import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest
import zenoh

from jezero.base.zenoh_client import client_config
from jezero.client.errors import TimedOut
from jezero.deploy.twin.twin import SETTINGS, set_field
from jezero.runtime.instance import socket_of
from jezero.schemas import topics
from jezero.schemas.sensors import CameraPreview
from tests.system.conftest import Stack, has_status, wait_for, wait_for_status

pytestmark = [pytest.mark.slow, pytest.mark.whole, pytest.mark.long, pytest.mark.timeout(900)]
START_S, FIND_S, STOP_S = 180.0, 240.0, 90.0
RATE_MIN_HZ, PICTURES = 5.0, 60
ATTEMPTS = 5
"""Times that the rate is measured: other programs may have the processors meanwhile."""
HEIGHT_M = 3.0
OVER_ROVER_NED_M = (5.0, -3.0, -4.0)
"""Above the rover's start by the shipped `simulator.toml`."""


@pytest.fixture
def on_twin(unstarted: Stack, tmp_path: Path) -> Iterator[Stack]:
    """A stack that has the twin's settings; the twin runs until the test ends."""
    words = (sys.executable, "-m", "jezero.cli.main", "twin", "--folder", str(tmp_path / "twin"))
    log = tmp_path / "twin.log"
    with log.open("w") as output:
        twin = subprocess.Popen(words, env=unstarted.environment, stdout=output, stderr=subprocess.STDOUT)
        try:
            wait_for(lambda: "fly it with" in log.read_text() or twin.poll() is not None, START_S, "the twin")
            found = re.search(r"JEZERO_CONFIG_DIR=(\S+)", log.read_text())
            assert found is not None, log.read_text()
            unstarted.environment["JEZERO_CONFIG_DIR"] = found[1]
            yield unstarted
            unstarted.jezero("down", check=False)
        finally:
            twin.send_signal(signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                twin.wait(STOP_S)
            twin.kill()
            twin.wait()


def measured_hz(stack: Stack) -> float:
    """Pictures per second of the next few."""
    with stack.connect() as vehicle, vehicle.subscribe(topics.CAMERA) as stream:
        stream.next(START_S)
        start_s = time.monotonic()
        for _ in range(PICTURES):
            frame = stream.next(START_S)
        assert (frame.width_px, frame.height_px) == (640, 480)
        return PICTURES / (time.monotonic() - start_s)


def test_a_goal_turns_the_twins_camera_by_the_gimbal_of_its_flight_controller(on_twin: Stack, tmp_path: Path) -> None:
    set_field(tmp_path / "twin" / SETTINGS / "vehicle.toml", "gimbal", '"mavlink"', "camera")
    on_twin.jezero("up", "-d", "--profile", "onboard")
    of_hardware = client_config(socket_of(tmp_path / "twin" / "hardware" / "run"))
    true_rad: list[float] = []
    with zenoh.open(of_hardware) as session, on_twin.connect() as vehicle, vehicle.subscribe(topics.CAMERA) as frames:
        decoder = msgspec.json.Decoder(CameraPreview)

        def on_preview(sample: zenoh.Sample) -> None:
            assert sample.attachment is not None
            true_rad.append(decoder.decode(sample.attachment.to_bytes()).pitch_camera_rad)

        session.declare_subscriber(topics.key("twin", topics.CAMERA_PREVIEW.name), on_preview)
        wait_for(lambda: has_status(vehicle), START_S, "a status of the bridge, which has just started")
        wait_for_status(vehicle, lambda status: status.ready, START_S, "ready")
        assert frames.next(START_S).pitch_camera_rad == pytest.approx(-1.5708, abs=0.1)
        vehicle.takeoff(HEIGHT_M).result(timeout_s=FIND_S)
        goal = vehicle.get_images((0.0, 0.0, -HEIGHT_M), 3.0, 4)
        pairs: list[tuple[float, float]] = []
        for feedback in goal.feedback():
            if 1 <= feedback.taken < 4 and true_rad:
                pairs.append((frames.next(START_S).pitch_camera_rad, true_rad[-1]))
        images = goal.result(timeout_s=FIND_S).images
    assert len(images) == 4
    assert pairs, "no picture came while the camera looked at the target"
    assert all(measured_rad > -1.2 for measured_rad, _ in pairs)
    differences_rad = sorted(abs(measured_rad - rad) for measured_rad, rad in pairs)
    assert differences_rad[len(pairs) // 2] < 0.1, pairs


def test_the_stack_gets_pictures_of_the_twins_camera_and_finds_the_tag(on_twin: Stack) -> None:
    on_twin.jezero("up", "-d", "--profile", "onboard")
    assert "camera_driver" in on_twin.processes()
    with on_twin.connect() as vehicle:
        wait_for(lambda: has_status(vehicle), START_S, "a status of the bridge, which has just started")
        wait_for_status(vehicle, lambda status: status.ready, START_S, "ready")
        rates_hz: list[float] = []
        while not rates_hz or (rates_hz[-1] < RATE_MIN_HZ and len(rates_hz) < ATTEMPTS):
            rates_hz.append(measured_hz(on_twin))
        assert rates_hz[-1] > RATE_MIN_HZ, rates_hz
        vehicle.takeoff(HEIGHT_M).result(timeout_s=FIND_S)
        vehicle.go_to(*OVER_ROVER_NED_M).result(timeout_s=FIND_S)
        with vehicle.subscribe(topics.ESTIMATE_TAG) as tags, suppress(TimedOut):
            tag = tags.next(FIND_S)
            assert tag.t_ns > 0
            return
    raise AssertionError("the tag detector found no tag in the twin's pictures")
