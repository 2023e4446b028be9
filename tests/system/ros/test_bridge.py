"""The bridge beside a real rclpy: what arrives in ROS is what the vehicle has published."""

import json
import signal
import subprocess
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import cycle
from math import isclose, isnan
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from jezero.base.codec import decode, encode
from jezero.base.vehicle_config import VehicleConfig
from jezero.base.zenoh_client import client_config, data_of
from jezero.schemas.sensors import CameraFrame, CameraInfo
from jezero.schemas.state import Odometry, StatusCode
from jezero.schemas.topics import CAMERA_INFO, ODOMETRY, key
from jezero.services.ros2_bridge.conversions import Context
from jezero.services.ros2_bridge.geometry import RosMessage
from jezero.services.ros2_bridge.rows import EXACT, ROWS, TF, RosTopic, ros_name
from tests.system.conftest import Stack
from tests.system.ros.conftest import Ros

pytestmark = [pytest.mark.long, pytest.mark.whole, pytest.mark.timeout(1200)]
LISTENER = Path(__file__).with_name("listener.py")
START_TIMEOUT_S = 120.0
EXPORT_TIMEOUT_S = 400.0
LISTEN_S = 12.0
COMPARED_MIN = 3
NOT_COMPARED = {"relative_pose", "path", "markers/uncertainty", "markers/fence", "/diagnostics", "rover/cmd_vel"}
"""Topics that depend on more than their message, or have no stamp; their conversions have tests of their own."""
IMAGE_BYTES = 100
"""The listener shows so many bytes of an image."""


@contextmanager
def running_bridge(
    stack: Stack, ros: Ros, *words: str, said: list[str] | None = None, before: tuple[str, ...] = ()
) -> Iterator["subprocess.Popen[str]"]:
    """A bridge that is ready; `said` gets the lines that it logged before; `before`: words before its command."""
    lines = [] if said is None else said
    command = [*before, ros.python, "-m", "jezero.cli.main", "ros2", "bridge", *words]
    with subprocess.Popen(command, env=ros.environment(stack.environment), stderr=subprocess.PIPE, text=True) as bridge:
        try:
            assert bridge.stderr is not None
            while not lines or " is in /" not in lines[-1]:
                lines.append(bridge.stderr.readline())
                assert lines[-1], f"the bridge has ended: {lines}"
            yield bridge
        finally:
            bridge.terminate()
            bridge.communicate(timeout=30)


def listen(stack: Stack, ros: Ros, reliability: str, topics: Mapping[str, str]) -> "subprocess.Popen[str]":
    """Start to listen to topics; `topics` has the type of each."""
    words = [f"{kind}={topic}" for topic, kind in topics.items()]
    listener = subprocess.Popen(
        [ros.python, str(LISTENER), str(LISTEN_S), reliability, *words],
        env=ros.environment(stack.environment),
        stdout=subprocess.PIPE,
        text=True,
    )
    assert listener.stdout is not None
    assert json.loads(listener.stdout.readline())["message"] == "listens"
    return listener


def heard(listener: "subprocess.Popen[str]") -> dict[str, list[dict[str, Any]]]:
    """Messages by topic, once the listener has ended."""
    output, _ = listener.communicate(timeout=LISTEN_S + START_TIMEOUT_S)
    found: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for line in output.splitlines():
        entry = json.loads(line)
        found[entry["topic"]].append(entry["message"])
    return found


def full_name(row: RosTopic, namespace: str) -> str:
    return row.name if row.name.startswith("/") else f"/{namespace}/{row.name}"


def stamp_of(message: dict[str, Any]) -> tuple[int, int]:
    stamp = message["header"]["stamp"]
    return stamp["sec"], stamp["nanosec"]


def assert_same(made: Any, seen: Any, where: str) -> None:
    """Compare each field of a message that was made here with what arrived; floats have 32 bits in some types."""
    if isinstance(made, RosMessage):
        for name, value in made.fields.items():
            assert_same(value, seen[name], f"{where}.{name}")
    elif isinstance(made, float):
        same = isclose(made, seen, rel_tol=1e-6, abs_tol=1e-9) or (isnan(made) and isnan(seen))
        assert same, f"{where}: {seen} in ROS, {made} in jezero"
    elif isinstance(made, str | int | bool):
        assert made == seen, where
    elif isinstance(made, bytes):
        assert made[0] == seen, where
    else:
        for i, (a, b) in enumerate(zip(made[:IMAGE_BYTES], seen, strict=True)):
            assert_same(a, b, f"{where}[{i}]")


def assert_same_as_one(made: Sequence[Any], seen: Any, where: str, compare: Callable[[Any, Any, str], None]) -> None:
    """Compare what arrived with all that was made at its time: a busy vehicle has several statuses of one time."""
    assert made, where
    for each in made[:-1]:
        with suppress(AssertionError):
            compare(each, seen, where)
            return
    compare(made[-1], seen, where)


class Published:
    """What the vehicle publishes, by source and time."""

    def __init__(self, session: zenoh.Session, vehicle: str) -> None:
        self.by_time: dict[str, dict[int, list[Any]]] = defaultdict(lambda: defaultdict(list))
        self.info: CameraInfo | None = None
        for row in {row.source.name: row for row in ROWS if row.source.name != "health/*"}.values():
            self._keep(session, vehicle, row)
        session.declare_subscriber(key(vehicle, CAMERA_INFO.name), self._on_info)

    def _keep(self, session: zenoh.Session, vehicle: str, row: RosTopic) -> None:
        def on_sample(sample: zenoh.Sample) -> None:
            message = decode(row.source.type, data_of(sample))
            if isinstance(message, CameraFrame):  # a minute of whole images has a gigabyte
                message = msgspec.structs.replace(message, pixels=message.pixels[:IMAGE_BYTES])
            self.by_time[row.source.name][message.t_ns].append(message)

        session.declare_subscriber(key(vehicle, row.source.name), on_sample)

    def _on_info(self, sample: zenoh.Sample) -> None:
        self.info = decode(CameraInfo, data_of(sample))


def test_every_topic_has_in_ros_the_values_that_the_vehicle_published(shared_stack: Stack, ros: Ros) -> None:
    check_every_topic(shared_stack, ros)


@pytest.mark.slow
def test_every_topic_is_the_same_in_another_distribution_of_ros(shared_stack: Stack, ros_jazzy: Ros) -> None:
    check_every_topic(shared_stack, ros_jazzy)


def check_every_topic(stack: Stack, ros: Ros) -> None:
    """Fly, and compare what arrives in ROS and what a bag of the flight has with what the vehicle has published."""
    vehicle = stack.instance.vehicle
    with (
        zenoh.open(client_config(stack.instance.router)) as session,
        stack.connect() as uav,
        running_bridge(stack, ros),
    ):
        published = Published(session, vehicle)
        uav.wait_ready(START_TIMEOUT_S)
        uav.takeoff(altitude_m=3.0).result(START_TIMEOUT_S)
        rows = [row for row in ROWS if row.type != TF and not row.name.startswith(EXACT)]
        topics = {full_name(row, vehicle): row.type for row in rows}
        listener = listen(stack, ros, "BEST_EFFORT", {**topics, "/clock": "rosgraph_msgs/msg/Clock"})
        with uav.rover.driving(0.2), ThreadPoolExecutor(1) as pool:
            hearing = pool.submit(heard, listener)
            for north_m, east_m in cycle(((3.0, 2.0), (0.0, 0.0))):
                uav.go_to(north_m, east_m, -3.0).result(START_TIMEOUT_S)
                if hearing.done():
                    break
            seen = hearing.result()
        uav.land_on_spot((3.0, 2.0, 0.0), use_uwb=False, use_tag=False).result(START_TIMEOUT_S)
    context = Context(ros_name(vehicle), VehicleConfig())
    assert published.info is not None
    context.notice(published.info)
    for row in rows:
        messages = seen[full_name(row, vehicle)]
        assert messages, f"nothing arrived on {row.name}"
        if row.name in NOT_COMPARED:
            continue
        compared = 0
        by_time = published.by_time[row.source.name]
        for message in messages:
            sec, nanosec = stamp_of(message)
            found = by_time.get(sec * 1_000_000_000 + nanosec)
            if found is None:
                continue
            made = [each for each in (row.convert(source, context) for source in found) if each is not None]
            assert_same_as_one(made, message, row.name, assert_same)
            compared += 1
        assert compared >= COMPARED_MIN, f"{row.name}: {compared} of {len(messages)} compared"
    check_bag(stack, seen)
    clocks = [c["clock"]["sec"] * 1_000_000_000 + c["clock"]["nanosec"] for c in seen["/clock"]]
    assert clocks == sorted(clocks)
    assert len(clocks) > 20 * LISTEN_S, "nearly a hundred in a second on a quiet machine"


def test_a_bridge_that_is_killed_in_flight_is_nothing_to_the_vehicle_and_a_new_one_goes_on(
    shared_stack: Stack, ros: Ros
) -> None:
    stack = shared_stack
    vehicle = stack.instance.vehicle
    odometry = {f"/{vehicle}/odometry": "nav_msgs/msg/Odometry"}
    with stack.connect() as uav:
        uav.wait_ready(START_TIMEOUT_S)
        uav.takeoff(altitude_m=2.0).result(START_TIMEOUT_S)
        with running_bridge(stack, ros) as bridge:
            goal = uav.go_to(4.0, -3.0, -2.0, speed_mps=0.5)
            bridge.kill()
            bridge.wait(timeout=30)
        with running_bridge(stack, ros):
            listener = listen(stack, ros, "RELIABLE", odometry)
            goal.result(START_TIMEOUT_S)
            assert len(heard(listener)[f"/{vehicle}/odometry"]) > 10, "a reliable subscriber is served too"
        assert uav.status().code in (StatusCode.GO_TO_DONE, StatusCode.HOVER)
        uav.land_on_spot((4.0, -3.0, 0.0), use_uwb=False, use_tag=False).result(START_TIMEOUT_S)


def check_bag(stack: Stack, seen: Mapping[str, list[dict[str, Any]]]) -> None:
    """Compare each message of the bridge with those of its time in a bag of the recorded flight."""
    bag = stack.run_dir / f"bag-{len(list(stack.run_dir.glob('bag-*')))}"
    vehicle = stack.instance.vehicle
    words = ("recording", "export", str(stack.run_dir), "--rosbag2", str(bag), "--no-images", "--vehicle", vehicle)
    stack.jezero(*words, timeout_s=EXPORT_TIMEOUT_S)
    recorded: dict[tuple[str, tuple[int, int]], list[Any]] = defaultdict(list)
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, data in reader.messages():
            message: Any = reader.deserialize(data, connection.msgtype)
            if (stamp := getattr(getattr(message, "header", None), "stamp", None)) is not None:
                recorded[connection.topic, (stamp.sec, stamp.nanosec)].append(message)
    compared: Counter[str] = Counter()
    for topic, messages in seen.items():
        for each in messages:
            if not topic.startswith(f"/{vehicle}/") or "header" not in each or "camera/" in topic or "path" in topic:
                continue
            if found := recorded.get((topic, stamp_of(each))):
                assert_same_as_one(found, each, topic, assert_same_as_bag)
                compared[topic] += 1
    assert compared[f"/{vehicle}/odometry"] >= COMPARED_MIN
    assert compared[f"/{vehicle}/rover/odometry"] >= COMPARED_MIN


def assert_same_as_bag(made: Any, seen: Any, where: str) -> None:
    """Compare each field of a message of a bag with what arrived in ROS.

    The relative pose's orientation is left out, as it has the newest attitude, which the recorder and the bridge may
    have at another moment; its conversion has tests of its own.
    """
    if hasattr(made, "__msgtype__"):
        for name, value in seen.items():
            if where.endswith("relative_pose.pose.pose") and name == "orientation":
                continue
            assert_same_as_bag(getattr(made, name), value, f"{where}.{name}")
    elif isinstance(seen, list):
        for i, (a, b) in enumerate(zip(list(made)[:IMAGE_BYTES], seen, strict=True)):
            assert_same_as_bag(a, b, f"{where}[{i}]")
    elif isinstance(seen, float):
        same = isclose(made, seen, rel_tol=1e-6, abs_tol=1e-9) or (isnan(made) and isnan(seen))
        assert same, f"{where}: {seen} in ROS, {made} in the bag"
    else:
        assert made == seen, where


@pytest.mark.slow
def test_a_bridge_that_is_stuck_is_nothing_to_the_vehicle(shared_stack: Stack, ros: Ros) -> None:
    with shared_stack.connect() as uav, running_bridge(shared_stack, ros) as bridge:
        uav.wait_ready(START_TIMEOUT_S)
        bridge.send_signal(signal.SIGSTOP)
        try:
            uav.takeoff(altitude_m=2.0).result(START_TIMEOUT_S)
            uav.go_to(2.0, 2.0, -2.0).result(START_TIMEOUT_S)
            uav.land_on_spot((2.0, 2.0, 0.0), use_uwb=False, use_tag=False).result(START_TIMEOUT_S)
        finally:
            bridge.send_signal(signal.SIGCONT)


@pytest.mark.slow
def test_two_vehicles_are_in_two_namespaces(shared_stack: Stack, ros: Ros) -> None:
    """The second vehicle is odometry that the test publishes, at a place where the first one never is."""
    stack = shared_stack
    vehicle = stack.instance.vehicle
    topics = {f"/{name}/odometry": "nav_msgs/msg/Odometry" for name in (vehicle, "second")}
    with (
        zenoh.open(client_config(stack.bus)) as session,
        running_bridge(stack, ros),
        running_bridge(stack, ros, "--vehicle", "second", "--no-clock"),
    ):
        listener = listen(stack, ros, "BEST_EFFORT", topics)
        ended = threading.Event()

        def publish() -> None:
            while not ended.wait(0.1):
                odometry = Odometry(
                    t_ns=time.monotonic_ns(),
                    epoch_id=1,
                    pos_uav_ned_m=(500.0, 0.0, 0.0),
                    vel_uav_ned_mps=(0.0, 0.0, 0.0),
                    q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
                    rates_uav_frd_rps=(0.0, 0.0, 0.0),
                )
                session.put(key("second", ODOMETRY.name), encode(odometry), encoding=zenoh.Encoding.APPLICATION_JSON)

        publisher = threading.Thread(target=publish)
        publisher.start()
        try:
            seen = heard(listener)
        finally:
            ended.set()
            publisher.join()
    first, second = seen[f"/{vehicle}/odometry"], seen["/second/odometry"]
    assert first and second
    assert {m["pose"]["pose"]["position"]["y"] for m in second} == {500.0}
    assert all(abs(m["pose"]["pose"]["position"]["y"]) < 100.0 for m in first)
    assert {m["header"]["frame_id"] for m in second} == {"second/odom"}
