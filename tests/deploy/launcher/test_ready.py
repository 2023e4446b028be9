"""When the launcher says that the stack is ready, and why it isn't."""

import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import zenoh

from jezero.base.codec import encode
from jezero.deploy.launcher.compose import parse
from jezero.deploy.launcher.launcher import Launcher
from jezero.deploy.launcher.state import RunFolder
from jezero.runtime.instance import Instance
from jezero.schemas.health import ServiceHealth, ServiceState
from jezero.schemas.state import Status

SERVICES = "services: {vehicle_bridge: {command: bridge, healthcheck: {test: [X]}}, toy: {command: toy}}"


class Bus:
    """A launcher of a bridge and a program without health, and the messages that it gets."""

    def __init__(self, folder: RunFolder) -> None:
        self.launcher = Launcher(parse(SERVICES, {}), folder, Instance(vehicle="uav1"), "", "compose.yaml")
        for slot in self.launcher._slots.values():
            slot.state = "running"
        self.launcher._health._on_token(_sample("jezero/uav1/service/vehicle_bridge", b""))

    def bridge_health(self, state: ServiceState, text: str) -> None:
        health = ServiceHealth(t_ns=0, service="vehicle_bridge", boot_id=1, state=state, text=text)
        self.launcher._health._on_health(_sample("jezero/uav1/health/vehicle_bridge", encode(health)))

    def status(self, reason: str = "") -> None:
        status = Status(
            t_ns=0,
            code=0,
            name="IDLE",
            armed=False,
            landed=True,
            in_charge="none",
            bridge_boot_id=1,
            ready=not reason,
            not_ready_reason=reason,
        )
        self.launcher._health._on_status(_sample("jezero/uav1/status", encode(status)))


def _sample(key: str, payload: bytes) -> "zenoh.Sample":
    content = SimpleNamespace(to_bytes=lambda: payload)
    return SimpleNamespace(key_expr=key, payload=content, kind=zenoh.SampleKind.PUT)  # type: ignore[return-value]


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[Bus]:
    folder = RunFolder(tmp_path)
    folder.acquire()
    bus = Bus(folder)
    yield bus
    launcher = bus.launcher
    launcher._output.close()
    for resource in (launcher._selector, launcher._wake_read, launcher._wake_write):
        resource.close()
    folder.release()


def test_a_degraded_service_is_named_although_the_vehicle_is_ready(bus: Bus) -> None:
    bus.status()
    bus.bridge_health("degraded", "the parameters are being set")
    assert bus.launcher._not_ready_reason() == "vehicle_bridge is degraded: the parameters are being set"
    bus.bridge_health("ok", "linked")
    assert bus.launcher._not_ready_reason() == ""


def test_a_service_that_failed_is_named_once_and_a_ready_vehicle_afterwards(
    bus: Bus, capsys: pytest.CaptureFixture[str]
) -> None:
    launcher, toy = bus.launcher, bus.launcher._slots["toy"]
    launcher._output._terminal = sys.stdout
    toy.state, toy.text = "failed", "ended with exit code 78: toy.toml: there is no setting 'colour'"
    bus.status()
    bus.bridge_health("ok", "linked")
    for _ in range(2):
        launcher._advance()
        launcher._print_readiness(0.0)
    assert capsys.readouterr().out == f"not ready: toy failed: {toy.text}; end the stack with Ctrl+C, and mend that\n"
    toy.state = "running"
    for _ in range(2):
        launcher._advance()
        launcher._print_readiness(0.0)
    assert capsys.readouterr().out.count("ready after") == 1


def test_a_well_bridge_is_not_enough_while_its_status_says_why_the_vehicle_is_not_ready(bus: Bus) -> None:
    bus.bridge_health("ok", "linked")
    assert bus.launcher._not_ready_reason() == "vehicle_bridge has sent no status yet"
    bus.status("the rover moves")
    assert bus.launcher._not_ready_reason() == "the rover moves"
