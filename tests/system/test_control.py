"""Control over real processes: two clients, abort, stale setpoints, servers and bridges that die."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
import zenoh

from jezero import Aborted, Refused, Unreachable
from jezero.base.codec import decode, encode
from jezero.base.config import config_directory
from jezero.base.zenoh_client import client_config
from jezero.schemas import topics
from jezero.schemas.commands import Acquire, Phase, Setpoint
from jezero.schemas.rows import Topic
from jezero.schemas.state import StatusCode
from tests.system.conftest import Stack, in_the_air, wait_for, wait_for_status

DISARM_WITHIN_S = 30.0


def test_of_two_clients_one_is_refused_with_the_reason_and_a_third_aborts(shared_stack: Stack) -> None:
    # The first test of the file: the vehicle stands on the ground.
    with shared_stack.connect() as first, shared_stack.connect() as second, shared_stack.connect() as third:
        goal = first.takeoff(altitude_m=5.0)
        start = time.monotonic()
        with pytest.raises(Refused, match=r"(?i)takeoff") as refusal:
            second.takeoff(altitude_m=2.0)
        assert time.monotonic() - start < 0.2
        assert refusal.value.code in {StatusCode.IDLE, StatusCode.TAKEOFF}  # idle until the first setpoint
        wait_for_status(third, lambda s: s.armed and not s.landed, 15, "airborne")
        third.abort()
        with pytest.raises(Aborted):
            goal.result(timeout_s=5)
        wait_for_status(third, lambda s: s.code == StatusCode.HOVER, 15, "hovering")


@pytest.mark.long
def test_stale_or_foreign_setpoints_are_not_executed(shared_stack: Stack) -> None:
    """A service sends them: the bridge trusts none of them."""
    key = topics.key(shared_stack.instance.vehicle, topics.SETPOINT.name)
    with shared_stack.connect() as vehicle, zenoh.open(client_config(shared_stack.bus)) as session:
        in_the_air(vehicle)
        goal = vehicle.go_to(0.0, 0.0, -8.0, speed_mps=0.5)
        wait_for_status(vehicle, lambda s: s.grant > 0, 5, "in charge")
        setpoints: list[bytes] = []
        with session.declare_subscriber(key, lambda sample: setpoints.append(sample.payload.to_bytes())):
            wait_for(lambda: setpoints, 5, "a setpoint of the goal")
        secret = decode(Setpoint, setpoints[0]).control_id
        worst_m = 0.0
        for number in range(100):
            status = vehicle.status()
            assert status.odometry is not None
            worst_m = max(worst_m, abs(status.odometry.pos_uav_ned_m[0]))
            for control_id, age_ns in ((secret, 350_000_000), ("somebody", 0)):
                stale = Setpoint(
                    t_ns=max(0, status.odometry.t_ns - age_ns),
                    control_id=control_id,
                    sequence=1_000_000 + number,
                    phase=Phase.GO_TO,
                    pos_ned_m=(20.0, 0.0, -2.0),
                )
                session.put(key, encode(stale))
            time.sleep(0.02)
        assert worst_m < 0.5
        assert vehicle.status().code == StatusCode.GO_TO
        goal.cancel()


class Stranger:
    """A plain Zenoh program of the vehicle's computer that plays every service, until the end of its `with` block.

    Attributes:
        answered: requests that have reached its queryables.
        granted: replies to its requests for control.
    """

    def __init__(self, stack: Stack) -> None:
        self.answered: list[str] = []
        self.granted: list[str] = []
        self._vehicle = stack.instance.vehicle
        self._session = zenoh.open(client_config(stack.instance.router))
        self._newest: dict[str, dict[str, Any]] = {}
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._lie)
        for topic in (*LIES, topics.SETPOINT):
            self._session.declare_subscriber(
                self._key(topic.name), self._on_sample(topic.name), allowed_origin=zenoh.Locality.REMOTE
            )
        for endpoint in (topics.GO_TO.endpoint, topics.LAND_ON_SPOT.endpoint, topics.HOVER):
            self._session.declare_queryable(self._key(endpoint.name), self._on_query, complete=True)
        self._session.liveliness().declare_token(self._key("@alive/service/vehicle_bridge"))

    def __enter__(self) -> "Stranger":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self._session.close()  # type: ignore[no-untyped-call]

    def _key(self, name: str) -> str:
        return topics.key(self._vehicle, name)

    def _on_sample(self, name: str) -> Callable[[zenoh.Sample], None]:
        return lambda sample: self._newest.update({name: json.loads(sample.payload.to_bytes())})

    def _on_query(self, query: zenoh.Query) -> None:
        self.answered.append(str(query.key_expr))
        query.drop()  # type: ignore[no-untyped-call]

    def _lie(self) -> None:
        while not self._ending.wait(0.02):
            for topic, changes in LIES.items():
                if topic.name in self._newest:
                    self._put(topic.name, self._newest[topic.name] | changes)
            if setpoint := self._newest.get(topics.SETPOINT.name):  # fresh, with the control id of the goal in charge
                away = {"sequence": setpoint["sequence"] + 1, "pos_ned_m": [40.0, 0.0, -20.0], "vel_ned_mps": None}
                self._put(topics.SETPOINT.name, setpoint | away)
            acquire = encode(Acquire(goal_id="stranger-1", action="go_to", do_takeoff=False))
            self._session.get(self._key(topics.ACQUIRE.name), self._on_reply, payload=acquire, timeout=1.0)

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self.granted.append(reply.ok.payload.to_string())

    def _put(self, name: str, message: dict[str, Any]) -> None:
        self._session.put(self._key(name), json.dumps(message), congestion_control=zenoh.CongestionControl.BLOCK)


LIES: dict[Topic[Any], dict[str, Any]] = {
    topics.CLOCK: {"epoch_id": 77},
    topics.STATUS: {"code": int(StatusCode.EXTERNAL), "name": StatusCode.EXTERNAL.name, "armed": False},
    topics.ODOMETRY: {"pos_uav_ned_m": [50.0, 0.0, -30.0]},
    topics.ALTIMETER: {"range_m": 0.05},
    topics.RELATIVE: {"pos_uav_rel_rover_ned_m": [9.0, 9.0, -1.0], "valid": True},
}


@pytest.mark.long
def test_a_stranger_on_the_vehicles_computer_moves_nothing_and_gets_nothing(shared_stack: Stack) -> None:
    with shared_stack.connect() as vehicle, Stranger(shared_stack) as stranger:
        in_the_air(vehicle)
        before = vehicle.status()
        for north_m in (4.0, 0.0):
            result = vehicle.go_to(north_m, 0.0, -3.0, speed_mps=1.0).result(timeout_s=60)
            assert abs(result.pos_uav_ned_m[0] - north_m) < 0.5
        vehicle.hover()
        landed = vehicle.land_on_spot().result(timeout_s=120)
        after = vehicle.status()
    assert (after.epoch_id, after.bridge_boot_id) == (before.epoch_id, before.bridge_boot_id)
    assert landed.completed
    assert stranger.answered == [] and stranger.granted == []


@pytest.mark.long
def test_when_an_action_server_is_killed_its_client_gets_an_error_and_the_vehicle_hovers(shared_stack: Stack) -> None:
    server = shared_stack.processes()["go_to"]
    with shared_stack.connect() as vehicle:
        in_the_air(vehicle)
        goal = vehicle.go_to(10.0, 0.0, -3.0, speed_mps=1.0)
        failed_s: list[float] = []

        def wait() -> None:
            with pytest.raises(Unreachable):
                goal.result(timeout_s=30)
            failed_s.append(time.monotonic())

        waiter = threading.Thread(target=wait)
        waiter.start()
        wait_for_status(vehicle, lambda s: s.code == StatusCode.GO_TO, 5, "flying to the target")
        time.sleep(1.0)
        killed = time.monotonic()
        os.kill(server, signal.SIGKILL)
        hovering = wait_for_status(vehicle, lambda s: s.code == StatusCode.HOVER, 2.0, "hovering")
        waiter.join(timeout=5)
        assert failed_s and failed_s[0] - killed < 1.0
        assert hovering < 0.8  # 0.5 s without a setpoint, 0.1 s of abort, and this test's polling
        accepted_within = killed + 5.0
        while True:
            try:
                vehicle.go_to(0.0, 0.0, -3.0).result(timeout_s=60)
                break
            except (Unreachable, Refused):
                assert time.monotonic() < accepted_within, "no new goal accepted within 5 s"
                time.sleep(0.1)


@pytest.mark.slow  # in `make test-all`, tests/scenario/test_bridge_restarts.py and tests/system/test_faults.py fly it
@pytest.mark.parametrize("down_s", [0.3, 0.9, 1.5, 3.0])
def test_when_the_bridge_dies_the_autopilot_lands_by_itself(
    start_stack: Callable[..., Stack], tmp_path: Path, down_s: float
) -> None:
    compose = yaml.safe_load((config_directory().parent / "compose.yaml").read_text())
    compose["services"]["vehicle_bridge"]["restart"] = "no"
    (tmp_path / "compose.yaml").write_text(yaml.safe_dump(compose))
    stack = start_stack("-f", str(tmp_path / "compose.yaml"))
    with stack.connect() as vehicle:
        vehicle.takeoff(altitude_m=2.0).result(timeout_s=60)
        os.kill(stack.processes_cached["vehicle_bridge"], signal.SIGKILL)
    time.sleep(down_s)
    bridge = subprocess.Popen([sys.executable, "-m", "jezero.services.vehicle_bridge"], env=stack.service_environment)
    try:
        with stack.connect() as vehicle:
            codes: list[int] = []

            def is_down() -> bool:
                status = vehicle.status()
                codes.append(status.code)
                return status.code == StatusCode.IDLE and not status.armed and status.landed

            start = time.monotonic()
            while time.monotonic() - start < DISARM_WITHIN_S:
                try:
                    if is_down():
                        break
                except Unreachable:
                    pass
                time.sleep(0.05)
            else:
                raise AssertionError(f"not landed within {DISARM_WITHIN_S} s; codes: {sorted(set(codes))}")
            assert set(codes) <= {StatusCode.EXTERNAL, StatusCode.IDLE}
            assert StatusCode.EXTERNAL in codes
    finally:
        bridge.terminate()
        bridge.wait(timeout=5)
