"""A bag of what a real rclpy has received from the bridge is a flight again."""

import base64
import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import zenoh
from rosbags.rosbag2 import Writer

from jezero.base.codec import decode
from jezero.base.zenoh_client import client_config, data_of
from jezero.recording import open_recording
from jezero.replay.rosbag import import_bag
from jezero.replay.through import replay_through
from jezero.schemas.estimate import Relative, SetParameters
from jezero.schemas.topics import LEASE, RELATIVE, ROVER_ESTIMATE, SET_PARAMETERS, key
from jezero.services.ros2_bridge.bag import typestore_of
from jezero.services.ros2_bridge.exact import type_name
from jezero.services.ros2_bridge.rows import EXACT, ROWS, exact_name
from tests.system.conftest import Stack, wait_for
from tests.system.ros.conftest import Ros
from tests.system.ros.test_bridge import START_TIMEOUT_S, full_name, running_bridge

pytestmark = [pytest.mark.slow, pytest.mark.whole, pytest.mark.timeout(1200)]
RECORDER = Path(__file__).with_name("recorder.py")
LANDING_TIMEOUT_S = 240.0
STD_UWB_M = 0.04
SETTLES_NS = 8_000_000_000
"""The estimator that reads the bag begins in the middle of the flight."""


def write_live_bag(folder: Path, entries: list[dict[str, Any]], kinds: Mapping[str, str]) -> None:
    """Write what the recorder has received as a bag."""
    with Writer(folder, version=9) as writer:
        connections = {}
        for entry in entries:
            topic = entry["topic"]
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kinds[topic], typestore=typestore_of(9))
            writer.write(connections[topic], entry["t_ns"], base64.b64decode(entry["data"]))


def test_a_bag_that_ros_has_recorded_gives_the_estimates_of_the_flight(
    shared_stack: Stack, ros_with_interfaces: Ros, tmp_path: Path
) -> None:
    stack, ros, vehicle = shared_stack, ros_with_interfaces, shared_stack.instance.vehicle
    flown: dict[int, Relative] = {}

    def on_estimate(sample: zenoh.Sample) -> None:
        estimate = decode(Relative, data_of(sample))
        flown[estimate.t_ns] = estimate

    with (
        zenoh.open(client_config(stack.instance.router)) as session,
        stack.connect() as uav,
        running_bridge(stack, ros),
    ):
        session.declare_subscriber(key(vehicle, RELATIVE.name), on_estimate)
        uav.wait_ready(START_TIMEOUT_S)
        uav.takeoff(altitude_m=4.0).result(START_TIMEOUT_S)
        parameters = f"/{vehicle}/{exact_name(SET_PARAMETERS)}"
        kinds = {full_name(row, vehicle): row.type for row in ROWS if row.name.startswith(EXACT)}
        words = [f"{kind}={topic}" for topic, kind in kinds.items()]
        kinds[parameters] = type_name(SetParameters)
        lines = tmp_path / "lines"
        with lines.open("w") as file:  # a pipe that nobody reads would stop the recorder
            recorder = subprocess.Popen(
                [ros.python, str(RECORDER), *words, f"{kinds[parameters]}={parameters}=latched"],
                env=ros.environment(stack.environment),
                stdin=subprocess.PIPE,
                stdout=file,
            )
        wait_for(lambda: lines.stat().st_size, START_TIMEOUT_S, "the recorder receives messages")
        uav.go_to(3.0, 2.0, -4.0).result(START_TIMEOUT_S)
        uav.go_to(-1.0, -1.0, -4.0).result(START_TIMEOUT_S)
        std_before_m = uav.estimator_parameters().std_uwb_m
        uav.set_estimator_parameters(std_uwb_m=STD_UWB_M)
        north_m, east_m, _ = uav.latest(ROVER_ESTIMATE).pos_rover_ned_m
        roughly_ned_m = (round(north_m) + 0.5, round(east_m) - 0.5, 0.0)
        landing = uav.land_on_spot(roughly_ned_m, use_uwb=False)
        landing.result(LANDING_TIMEOUT_S)
        recorder.communicate(timeout=START_TIMEOUT_S)

    store, entries = typestore_of(9), [json.loads(line) for line in lines.read_text().splitlines()]
    write_live_bag(tmp_path / "bag", entries, kinds)
    done = import_bag(tmp_path / "bag", tmp_path / "live.mcap", namespace=vehicle)
    assert not done.left_out and not done.has_settings

    def received(topic: str) -> list[Any]:
        sent = [base64.b64decode(each["data"]) for each in entries if each["topic"] == topic]
        return [store.deserialize_cdr(each, kinds[topic]) for each in sent]

    read, leases = received(parameters), received(f"/{vehicle}/{exact_name(LEASE)}")
    assert [list(each.std_uwb_m) for each in (read[0], read[-1])] == [[std_before_m], [STD_UWB_M]]
    assert [list(each.pos_rover_ned_m) for each in leases[:2]] == [pytest.approx(roughly_ned_m), []]
    assert not any(each.release for each in leases[:-1])

    again = {e.message.t_ns: e.message for e in open_recording(tmp_path / "live.mcap").messages(RELATIVE)}
    begin_ns = min(again)
    compared = 0
    for t_ns, estimate in again.items():
        before = flown.get(t_ns)
        if before is None or t_ns - begin_ns < SETTLES_NS or not (before.valid and estimate.valid):
            continue
        assert estimate.pos_uav_rel_rover_ned_m == pytest.approx(before.pos_uav_rel_rover_ned_m, abs=0.3)
        compared += 1
    landed = [estimate for estimate in again.values() if estimate.goal_id]
    assert {estimate.goal_id for estimate in landed} == {landing.goal_id}
    assert not any(estimate.use_uwb for estimate in landed) and len(landed) > 100
    assert max(estimate.parameters_version for estimate in again.values()) == len(read)
    assert compared > 100, f"{compared} of {len(again)} estimates compared"
    assert replay_through(tmp_path / "live.mcap", "estimator").identical
