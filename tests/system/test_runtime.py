"""One service as a real process on a real router: it answers, refuses, reports, and leaves in time."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from msgspec.structs import replace

from jezero.base.codec import encode
from jezero.base.zenoh_client import client_config
from jezero.deploy.launcher.ports import instance_environment, reserved_instance, service_environment
from jezero.runtime.instance import Instance, socket_of
from jezero.runtime.links import TcpClient, TcpServer, Udp
from jezero.runtime.service import Spec
from jezero.runtime.zenoh_bus import BusSession
from jezero.schemas import topics
from jezero.schemas.sensors import CameraFrame
from tests.system.conftest import wait_for

TOYS = Path(__file__).with_name("toy_services.py")
Started = tuple[Instance, dict[str, str], "subprocess.Popen[str]"]


def start(environment: dict[str, str], name: str) -> "subprocess.Popen[str]":
    return subprocess.Popen([sys.executable, str(TOYS), name], env=environment, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def router(tmp_path: Path) -> Iterator[tuple[Instance, dict[str, str]]]:
    """A router; the instance has its address for services, and the variables are those of a service."""
    with reserved_instance(vehicle=f"r{os.getpid()}") as instance:
        process = run_router(instance, tmp_path)
        yield replace(instance, router=socket_of(tmp_path)), {**os.environ, **service_environment(instance, tmp_path)}
        process.terminate()
        process.wait(timeout=5)


def run_router(instance: Instance, run_folder: Path) -> "subprocess.Popen[bytes]":
    environment = {**os.environ, **instance_environment(instance), "JEZERO_RUN_DIR": str(run_folder)}
    return subprocess.Popen([sys.executable, "-m", "jezero.runtime.router"], env=environment)


@pytest.fixture
def echo(router: tuple[Instance, dict[str, str]]) -> Iterator[Started]:
    instance, environment = router
    process = start(environment, "echo")
    yield instance, environment, process
    process.kill()
    process.communicate(timeout=5)


def ask(session: zenoh.Session, instance: Instance, selector: str = "", payload: bytes | None = None) -> list[str]:
    replies = session.get(topics.key(instance.vehicle, topics.ABORT.name) + selector, payload=payload, timeout=2.0)
    return [reply.ok.payload.to_string() for reply in replies if reply.ok is not None]


def health(session: zenoh.Session, instance: Instance, condition: str) -> dict[str, object]:
    """The first health report of the echo service that contains some text."""
    found: list[dict[str, object]] = []

    def on_sample(sample: zenoh.Sample) -> None:
        text = sample.payload.to_string()
        if condition in text:
            found.append(json.loads(text))

    subscriber = session.declare_subscriber(topics.key(instance.vehicle, "health/echo"), on_sample)
    wait_for(lambda: bool(found), 5.0, f"a health report with {condition}")
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    return found[0]


def test_a_question_is_answered_and_a_malformed_one_refused_with_the_reason(echo: Started) -> None:
    instance, _, _ = echo
    with zenoh.open(client_config(instance.router)) as session:
        wait_for(lambda: bool(ask(session, instance)), 10.0, "an answer")
        assert '"hovering":true' in ask(session, instance, '?reason="x"')[0]
        assert "there is no field 'colour'" in ask(session, instance, "?colour=red")[0]
        assert "JSON is malformed" in ask(session, instance, "", b"\xff{")[0]
        assert "both" in ask(session, instance, "?reason=x", b"{}")[0]


def test_bad_messages_are_counted_in_health_and_never_acted_on(echo: Started) -> None:
    instance, _, _ = echo
    key = topics.key(instance.vehicle, topics.CLOCK.name)
    with zenoh.open(client_config(instance.router)) as session:
        wait_for(lambda: bool(ask(session, instance)), 10.0, "an answer")
        for body in (b"", b"\xff", b'{"t_ns":1}', b'{"t_ns":-5,"epoch_id":1,"wall_ns":1}', b'{"t_ns":null}'):
            session.put(key, body)
        session.delete(key)
        report = health(session, instance, '"rejected":6')
        assert str(report["last_error"]).startswith("clock: ")
        assert "nothing" in ask(session, instance)[0]
        session.put(key, b'{"t_ns":1,"epoch_id":77,"wall_ns":1}')
        wait_for(lambda: "epoch 77" in ask(session, instance)[0], 2.0, "the good one")


def test_a_second_service_of_the_same_name_refuses_to_start_and_names_the_holder(echo: Started) -> None:
    instance, environment, process = echo
    with zenoh.open(client_config(instance.router)) as session:
        wait_for(lambda: bool(ask(session, instance)), 10.0, "an answer")
        second = start(environment, "echo")
        _, error = second.communicate(timeout=15)
        assert second.returncode == 1
        assert f"{socket.gethostname()} pid {process.pid}" in error
        process.kill()
        process.wait(timeout=5)
        third = start(environment, "echo")
        wait_for(lambda: bool(ask(session, instance)), 10.0, "the successor's answer")
        third.kill()
        third.communicate(timeout=5)


def test_a_router_that_was_stopped_for_longer_than_its_tick_goes_on(router: tuple[Instance, dict[str, str]]) -> None:
    instance, _ = router
    with zenoh.open(client_config(instance.router)) as session:
        reports = deque[str]()
        topic = topics.key(instance.vehicle, topics.health_of("router").name)
        subscriber = session.declare_subscriber(topic, lambda sample: reports.append(sample.payload.to_string()))
        wait_for(lambda: bool(reports), 10.0, "a report")
        pid = int(json.loads(reports[0])["process"].split()[-1])
        os.kill(pid, signal.SIGSTOP)
        time.sleep(1.2)  # longer than the second between two reports
        os.kill(pid, signal.SIGCONT)
        reports.clear()
        wait_for(lambda: len(reports) > 1, 10.0, "more reports")
        assert f"pid {pid}" in reports[-1]
        subscriber.undeclare()  # type: ignore[no-untyped-call]


def test_of_services_of_one_name_that_start_at_the_same_instant_exactly_one_gets_it(
    router: tuple[Instance, dict[str, str]],
) -> None:
    instance, environment = router
    with zenoh.open(client_config(instance.router)) as session:
        processes = [start(environment, "echo") for _ in range(4)]
        try:
            wait_for(lambda: bool(ask(session, instance)), 20.0, "an answer")
            wait_for(lambda: sum(each.poll() == 1 for each in processes) == 3, 30.0, "three that refuse to start")
            assert len(ask(session, instance)) == 1
        finally:
            for process in processes:
                process.kill()
                process.communicate(timeout=5)


def waits_for_router(pid: int) -> bool:
    """Whether a service has its handlers of signals, and threads that open the session. Source: proc(5)."""
    text = Path(f"/proc/{pid}/status").read_text()
    caught = int(text.partition("SigCgt:")[2].split()[0], 16)
    return bool(caught & 1 << (signal.SIGTERM - 1)) and len(os.listdir(f"/proc/{pid}/task")) > 2


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("when", ["running", "router dead", "no router yet"])
def test_a_service_leaves_within_a_second(
    router: tuple[Instance, dict[str, str]], number: signal.Signals, when: str
) -> None:
    instance, environment = router
    if when == "no router yet":
        environment = {**environment, "JEZERO_ROUTER": "unixsock-stream//nobody/here"}
        process = start(environment, "echo")
        wait_for(lambda: waits_for_router(process.pid), 30.0, "the thread that waits for the router")
    else:
        with zenoh.open(client_config(instance.router)) as session:
            process = start(environment, "echo")
            wait_for(lambda: bool(ask(session, instance)), 10.0, "an answer")
    begin = time.monotonic()
    process.send_signal(number)
    _, error = process.communicate(timeout=5)
    assert time.monotonic() - begin < 1.0
    assert (process.returncode, error) == (0, "")


def test_a_programming_error_ends_the_process(router: tuple[Instance, dict[str, str]]) -> None:
    process = start(router[1], "undeclared")
    _, printed = process.communicate(timeout=15)
    assert process.returncode not in {0, None}
    assert "UndeclaredError" in printed


def test_a_service_answers_while_its_work_keeps_the_interpreter_busy(router: tuple[Instance, dict[str, str]]) -> None:
    process = start(router[1], "busy")
    try:
        with zenoh.open(client_config(router[0].router)) as session:
            wait_for(lambda: bool(ask(session, router[0])), 10.0, "an answer")
            answers, delays_s = [""], []
            while "1 done" not in answers[-1]:
                asked_s = time.monotonic()
                answers += ask(session, router[0])
                delays_s.append(time.monotonic() - asked_s)
    finally:
        process.terminate()
        process.communicate(timeout=5)
    assert len(delays_s) > 10 and max(delays_s) < 0.5


def test_a_service_that_lost_its_router_resumes_when_it_is_back(tmp_path: Path) -> None:
    with reserved_instance(vehicle=f"b{os.getpid()}") as instance:
        first = run_router(instance, tmp_path)
        process = start({**os.environ, **service_environment(instance, tmp_path)}, "echo")
        with zenoh.open(client_config(instance.router)) as session:
            wait_for(lambda: bool(ask(session, instance)), 10.0, "an answer")
        first.kill()
        first.wait(timeout=5)
        again = run_router(instance, tmp_path)
        with zenoh.open(client_config(instance.router)) as session:
            took_s = wait_for(lambda: bool(ask(session, instance)), 10.0, "an answer after the router's return")
        assert took_s < 5.0
        for child in (process, again):
            child.terminate()
            child.communicate(timeout=5)


def test_tcp_links_carry_bytes_both_ways_and_reconnect() -> None:
    with reserved_instance() as instance:
        server, client = TcpServer("127.0.0.1", instance.hil_port), TcpClient("127.0.0.1", instance.hil_port)
        server.start()
        client.start()
        got = {"server": b"", "client": b""}

        def pump() -> bool:
            now_ns = time.monotonic_ns()
            got["client"] += client.poll(now_ns)
            got["server"] += server.poll(now_ns)
            return server.up and client.up

        wait_for(pump, 2.0, "connected")
        client.send(b"ping")
        server.send(b"pong")
        wait_for(lambda: pump() and got == {"server": b"ping", "client": b"pong"}, 2.0, "both heard")
        client.close()
        wait_for(lambda: not (server.poll(time.monotonic_ns()) or server.up), 2.0, "the loss noticed")
        wait_for(pump, 2.0, "connected again")
        assert (server.connections, client.connections) == (2, 2)
        client.close()
        server.close()


def test_a_udp_link_hears_its_peer_and_nobody_else() -> None:
    with reserved_instance() as instance:
        local, peer = ("127.0.0.1", instance.bridge_port), ("127.0.0.1", instance.autopilot_offboard_port)
        listening = Udp(local, peer, only_from_peer=True)
        speaking = Udp(peer, local)
        stranger = Udp(("127.0.0.1", instance.autopilot_gcs_port), local)
        for link in (listening, speaking, stranger):
            link.start()
        stranger.send(b"turn to me")
        speaking.send(b"hello")
        heard: list[bytes] = []

        def has_received() -> bool:
            heard.append(listening.poll(0))
            return bool(heard[-1])

        wait_for(has_received, 2.0, "a datagram")
        assert heard[-1] == b"hello"
        listening.send(b"back")
        wait_for(lambda: speaking.poll(0) == b"back", 2.0, "the answer")
        assert stranger.poll(0) == b""
        stranger.send(b"anybody there?")
        speaking.send(b"bye")
        wait_for(has_received, 2.0, "another datagram")
        assert heard[-1] == b"bye"
        for link in (listening, speaking, stranger):
            link.close()


def test_no_thread_is_left_when_a_session_closes(echo: Started) -> None:
    before = threading.active_count()
    with zenoh.open(client_config(echo[0].router)):
        pass
    assert threading.active_count() <= before


def test_who_is_slow_sees_the_newest_picture_and_not_every_one(router: tuple[Instance, dict[str, str]]) -> None:
    instance, environment = router
    process = start(environment, "slow_viewer")
    camera = BusSession(instance, Spec(name="painter", outputs=(topics.CAMERA,)), lambda *_: None)
    camera.open_in_background().join()
    camera.declare()
    try:
        with zenoh.open(client_config(instance.router)) as session:
            wait_for(lambda: bool(ask(session, instance)), 10.0, "an answer")
            for number in range(21):
                camera.put(topics.CAMERA, encode(picture(number)))
                time.sleep(0.02)
            wait_for(lambda: any('"20 ' in answer for answer in ask(session, instance)), 10.0, "the newest picture")
            (answer,) = ask(session, instance)
    finally:
        camera.close()
        process.kill()
        process.communicate(timeout=5)
    assert '"hovering":true' in answer
    assert int(json.loads(answer)["reason"].split()[1]) < 10


def test_a_pictures_pixels_are_the_bare_payload_of_a_reply(router: tuple[Instance, dict[str, str]]) -> None:
    instance, environment = router
    process = start(environment, "album")
    key = topics.key(instance.vehicle, topics.GET_IMAGES.image.name)

    def fetched(selector: str) -> list[tuple[dict[str, object], bytes]]:
        replies = [reply.ok for reply in session.get(key + selector, timeout=2.0) if reply.ok is not None]
        headers = [b"{}" if reply.attachment is None else reply.attachment.to_bytes() for reply in replies]
        return [(json.loads(h), r.payload.to_bytes()) for h, r in zip(headers, replies, strict=True)]

    try:
        with zenoh.open(client_config(instance.router)) as session:
            wait_for(lambda: bool(fetched("?goal_id=g;index=0")), 10.0, "an answer")
            ((header, pixels),) = fetched("?goal_id=g;index=0")
            assert pixels == b"\n\x00\xffabc"
            assert (header["goal_id"], header["width_px"], header["height_px"]) == ("g", 2, 1)
            ((header, pixels),) = fetched("?goal_id=g;index=4")
            assert (header["reason"], pixels) == ("no picture 4", b"")
            ((header, _),) = fetched("?goal_id=g;index=-4")
            assert "index" in str(header["reason"])
    finally:
        process.kill()
        process.communicate(timeout=5)


def picture(number: int) -> CameraFrame:
    return CameraFrame(
        t_ns=1,
        sequence=number,
        width_px=640,
        height_px=480,
        pitch_camera_rad=0.0,
        exposure_s=0.005,
        pixels=bytes([number]) * (640 * 480 * 3),
    )
