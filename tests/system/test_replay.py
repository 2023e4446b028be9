"""A recorded flight on a bus again, as other programs see it there."""

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import threading
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import zenoh

from jezero import Vehicle
from jezero.base.codec import decode, encode
from jezero.base.zenoh_client import client_config, data_of
from jezero.deploy.launcher.health import router_is_up
from jezero.deploy.launcher.ports import instance_environment, reserved_instance
from jezero.recording import open_recording
from jezero.recording.images import ImageFormat
from jezero.recording.mcap_file import McapFile
from jezero.recording.writer import RecordingWriter
from jezero.replay.player import is_published
from jezero.runtime.instance import Instance, socket_of
from jezero.schemas import topics
from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import key, liveliness_key
from jezero.trials.flight import fly_virtually
from tests.client.rig import a_status
from tests.recording.foxglove_client import FoxgloveClient
from tests.system.conftest import JEZERO, wait_for

TIMEOUT_S = 30.0
SECOND_NS = 1_000_000_000
TAKE_TERMINAL = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.argv[1], sys.argv[1:])
"""
"""Makes standard input the terminal of this session, then becomes the command."""


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of a takeoff in virtual time."""
    path = tmp_path_factory.mktemp("flown") / "flight.mcap"
    fly_virtually(((topics.TAKEOFF, TakeoffGoal(altitude_m=2.0), 2.0),), 3, path)
    return path


@pytest.fixture
def instance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Instance]:
    """A vehicle's name, and a free address for a router whose socket is in a folder of the test."""
    monkeypatch.setenv("JEZERO_RUN_DIR", str(tmp_path))
    with reserved_instance(vehicle=f"r{os.getpid()}") as reserved:
        yield reserved


@pytest.fixture
def router(instance: Instance) -> Iterator[None]:
    """A router at the instance's address."""
    environment = {**os.environ, **instance_environment(instance)}
    process = subprocess.Popen([sys.executable, "-m", "jezero.runtime.router"], env=environment)
    try:
        wait_for(lambda: router_is_up(instance.router), TIMEOUT_S, "a router")
        yield
    finally:
        process.terminate()
        process.wait(TIMEOUT_S)


def start(instance: Instance, *words: str) -> "subprocess.Popen[str]":
    """Start a jezero command for the instance."""
    environment = {**os.environ, **instance_environment(instance), "PYTHONUNBUFFERED": "1"}
    return subprocess.Popen(
        [*JEZERO, *words], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def run(instance: Instance, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a jezero command for the instance."""
    process = start(instance, *words)
    stdout, stderr = process.communicate(timeout=TIMEOUT_S)
    return subprocess.CompletedProcess(words, process.returncode, stdout, stderr)


class Subscriber:
    """Collects everything that a vehicle publishes; a context manager."""

    def __init__(self, instance: Instance) -> None:
        self.samples: dict[str, list[zenoh.Sample]] = defaultdict(list)
        self._prefix = key(instance.vehicle, "")
        self._session = zenoh.open(client_config(instance.router, TIMEOUT_S))
        self._subscriber = self._session.declare_subscriber(f"{self._prefix}**", self._on_sample)

    def __enter__(self) -> "Subscriber":
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()  # type: ignore[no-untyped-call]

    def _on_sample(self, sample: zenoh.Sample) -> None:
        self.samples[str(sample.key_expr).removeprefix(self._prefix)].append(sample)


def recorded(path: Path, topic: str) -> list[bytes]:
    return [message.data for message in McapFile(path).messages() if message.topic == topic]


@pytest.mark.usefixtures("router")
def test_a_subscriber_gets_every_message_with_the_bytes_that_were_recorded(flight: Path, instance: Instance) -> None:
    counts = {name: count for name, count in open_recording(flight).summary().counts.items() if is_published(name)}
    with Subscriber(instance) as subscriber:
        done = run(instance, "replay", str(flight), "--speed", "20")
        assert done.returncode == 0, done.stderr
        received = subscriber.samples
        wait_for(lambda: len(received["odometry"]) >= counts["odometry"], TIMEOUT_S, "the last odometry")
    assert {name: len(received[name]) for name in counts} == counts
    assert received.keys() - counts.keys() <= {"health/replay", "health/router"}
    for topic in ("odometry", "clock", "status", "action/takeoff/feedback"):
        assert [sample.payload.to_bytes() for sample in received[topic]] == recorded(flight, topic)
        assert {str(sample.encoding) for sample in received[topic]} == {str(zenoh.Encoding.APPLICATION_JSON)}


def test_without_a_router_the_replay_is_one_and_clients_see_the_flight(flight: Path, instance: Instance) -> None:
    end_s = open_recording(flight).summary().duration_s
    replay = start(instance, "replay", str(flight), "--loop", "--from", f"{end_s - 2.0}")
    try:
        wait_for(lambda: router_is_up(instance.router), TIMEOUT_S, "the replay's router")
        with Vehicle.connect(instance.vehicle, router=instance.router) as vehicle:
            vehicle.wait_ready(timeout_s=TIMEOUT_S)
            assert vehicle.status().name == "HOVER"
        shown = run(instance, "status")
        assert shown.returncode == 0 and "in the air" in shown.stdout
        watched_by_foxglove(instance)
        second = run(instance, "replay", str(flight))
        assert second.returncode == 3 and f"replay of {instance.vehicle} runs" in second.stderr
        up = run(instance, "up", "-d", "--run-dir", str(flight.parent / "run"))
        assert up.returncode == 3 and f"replay of vehicle {instance.vehicle} runs already as" in up.stderr
        refused = run(instance, "takeoff")
        assert refused.returncode == 5 and "no server replies" in refused.stderr
        replay.send_signal(signal.SIGINT)
        stdout, stderr = replay.communicate(timeout=TIMEOUT_S)
        assert (replay.returncode, stderr) == (0, "")
        assert "the replay is the router until it ends" in stdout and "messages published" in stdout
        assert not router_is_up(instance.router)
    finally:
        replay.kill()
        replay.communicate()


def watched_by_foxglove(instance: Instance) -> None:
    """Check that `jezero watch` shows the replay, with a scene made anew."""
    watch = start(instance, "watch", "--foxglove", "--port", "0", "--json")
    wanted = ("odometry", "viewer/scene", "health/replay")
    try:
        assert watch.stdout is not None
        with FoxgloveClient(json.loads(watch.stdout.readline())["port"]) as client:

            def received(names: set[str]) -> bool:
                client.receive(0.1)
                return set(wanted) <= names

            wait_for(lambda: received({*client.channels}), TIMEOUT_S, "channels")
            for name in wanted:
                client.subscribe(name)
            wait_for(lambda: received({*client.messages}), TIMEOUT_S, "messages")
    finally:
        watch.kill()
        watch.communicate()


def test_an_image_becomes_a_camera_frame_for_a_subscriber(tmp_path: Path, instance: Instance) -> None:
    path = tmp_path / "flight.mcap"
    frames = [image_of(sequence) for sequence in range(20)]
    with RecordingWriter(path, {}, image_format=ImageFormat("png")) as writer:
        for frame in frames:
            writer.write(frame.t_ns, topics.CAMERA.name, encode(frame))
    replay = start(instance, "replay", str(path), "--loop")
    try:
        wait_for(lambda: router_is_up(instance.router), TIMEOUT_S, "the replay's router")
        with Subscriber(instance) as subscriber:
            wait_for(lambda: subscriber.samples["sensor/camera"], TIMEOUT_S, "an image")
            sample = subscriber.samples["sensor/camera"][0]
            assert decode(CameraFrame, data_of(sample)) in frames
            assert str(sample.encoding) == str(zenoh.Encoding.APPLICATION_OCTET_STREAM)
    finally:
        replay.kill()
        replay.communicate()


def image_of(sequence: int) -> CameraFrame:
    return CameraFrame(
        t_ns=sequence * SECOND_NS // 10,
        sequence=sequence,
        width_px=4,
        height_px=2,
        pitch_camera_rad=-1.5,
        exposure_s=0.01,
        pixels=bytes(range(sequence, sequence + 24)),
    )


@contextmanager
def a_vehicle_in_the_air(instance: Instance, run_folder: Path) -> Iterator[None]:
    """What a replay finds of one: the liveliness of its bridge, and the status that the bridge replies."""
    status = encode(a_status(StatusCode.HOVER))
    with zenoh.open(client_config(socket_of(run_folder), TIMEOUT_S)) as session:
        token = session.liveliness().declare_token(liveliness_key(instance.vehicle, "service", "vehicle_bridge"))
        name = key(instance.vehicle, topics.STATUS.name)
        queryable = session.declare_queryable(name, lambda query: query.reply(name, status))
        yield
        queryable.undeclare()  # type: ignore[no-untyped-call]
        token.undeclare()  # type: ignore[no-untyped-call]


@pytest.mark.usefixtures("router")
def test_a_replay_is_refused_where_the_vehicle_flies(flight: Path, instance: Instance, tmp_path: Path) -> None:
    commands = ("--topic", topics.SETPOINT.name)
    with a_vehicle_in_the_air(instance, tmp_path), Subscriber(instance) as subscriber:
        refused = run(instance, "replay", str(flight))
        assert refused.returncode == 3
        assert "and the vehicle flies" in refused.stderr and "--vehicle" in refused.stderr
        assert len(refused.stderr.splitlines()) == 1
        other = run(instance, "replay", str(flight), "--vehicle", "other", "--speed", "20")
        assert "messages published" in other.stdout
        assert subscriber.samples.keys() <= {"health/router"}
        words = ("replay", str(flight), "--force", "--speed", "20", "--topic", topics.CAMERA_INFO.name)
        forced = run(instance, *words, *commands)
        assert "confuse their readers" in forced.stderr and " 1 topics" in forced.stdout
        assert not subscriber.samples[topics.SETPOINT.name]
        nothing = run(instance, "replay", str(flight), "--force", *commands)
        assert nothing.returncode == 1 and "commands" in nothing.stderr


@pytest.mark.usefixtures("router")
def test_a_replay_ends_when_a_service_of_the_vehicle_starts(flight: Path, instance: Instance, tmp_path: Path) -> None:
    replay = start(instance, "replay", str(flight), "--loop")
    try:
        with Subscriber(instance) as subscriber, zenoh.open(client_config(socket_of(tmp_path), TIMEOUT_S)) as session:
            wait_for(lambda: subscriber.samples["odometry"], TIMEOUT_S, "the replay")
            token = session.liveliness().declare_token(liveliness_key(instance.vehicle, "service", "estimator"))
            _, stderr = replay.communicate(timeout=TIMEOUT_S)
            token.undeclare()  # type: ignore[no-untyped-call]
        assert replay.returncode == 3
        assert f"estimator of {instance.vehicle} has started" in stderr
    finally:
        replay.kill()
        replay.communicate()


@pytest.mark.usefixtures("router")
def test_a_replay_is_refused_where_a_program_of_ones_own_publishes(
    flight: Path, instance: Instance, tmp_path: Path
) -> None:
    stopping = threading.Event()
    with zenoh.open(client_config(socket_of(tmp_path), TIMEOUT_S)) as session:

        def publish() -> None:
            while not stopping.wait(0.05):
                session.put(key(instance.vehicle, "estimate/relative"), b"{}")

        writer = threading.Thread(target=publish)
        writer.start()
        try:
            refused = run(instance, "replay", str(flight))
        finally:
            stopping.set()
            writer.join()
    assert refused.returncode == 3
    assert f"somebody publishes estimate/relative of {instance.vehicle}" in refused.stderr


class Terminal:
    """A replay in a terminal of its own; a context manager."""

    def __init__(self, instance: Instance, *words: str) -> None:
        self.shown = ""
        self._master, slave = pty.openpty()
        environment = {**os.environ, **instance_environment(instance)}
        self.process = subprocess.Popen(
            [sys.executable, "-c", TAKE_TERMINAL, *JEZERO, "replay", *words],
            env=environment, stdin=slave, stdout=slave, stderr=slave, start_new_session=True,
        )  # fmt: skip
        os.close(slave)

    def __enter__(self) -> "Terminal":
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._master)

    def press(self, keys: str) -> None:
        """Press keys; what was shown before is forgotten."""
        self.shown = ""
        os.write(self._master, keys.encode())

    def wait_for(self, pattern: str) -> str:
        """Wait until the terminal shows a pattern; returns its first group."""

        def found() -> re.Match[str] | None:
            if select.select([self._master], [], [], 0.05)[0]:
                with suppress(OSError):  # the process has ended, and all that it wrote is read
                    self.shown += os.read(self._master, 4096).decode(errors="replace")
            return re.search(pattern, self.shown)

        wait_for(found, TIMEOUT_S, f"{pattern} in the terminal")
        match = re.search(pattern, self.shown)
        assert match is not None
        return match[1]

    @property
    def is_cooked(self) -> bool:
        """Whether the terminal collects lines and shows what is typed."""
        modes = termios.tcgetattr(self._master)[3]
        return bool(modes & termios.ICANON and modes & termios.ECHO)


def test_keys_pause_step_and_quit(flight: Path, instance: Instance) -> None:
    with Terminal(instance, str(flight), "--loop") as terminal:
        terminal.wait_for(r"(space: pause)")
        terminal.press(" ")
        paused_s = float(terminal.wait_for(r"([\d.]+) s of [\d.]+ s, paused"))
        terminal.press(".")
        stepped = round(paused_s + 0.1, 1)
        terminal.wait_for(rf"({stepped}|{stepped + 0.1:.1f}) s of [\d.]+ s, paused")
        terminal.press(" ")
        terminal.wait_for(r"([\d.]+) s of [\d.]+ s[^,]")
        terminal.press("q")
        terminal.wait_for(r"(ended at) ")
        assert terminal.process.wait(TIMEOUT_S) == 0
        assert terminal.is_cooked
