"""Profiles started apart, each by a launcher of its own, as on a real drone, whose autopilot is on first."""

import json
import socket
import time
from dataclasses import replace
from pathlib import Path

import pytest

from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.runtime.instance import Instance
from tests.system.conftest import Stack, wait_for

TIMEOUT_S = 60.0


def get_ready_apart(first: Stack, folder: Path, profiles: tuple[str, str]) -> None:
    """Start one profile, then another that finds it running, and take off.

    Args:
        first: the stack of the first profile, not started.
        folder: for the run folder of the second profile.
        profiles: the two profiles in the order of their start.
    """
    folder = folder / "second"
    second = replace(first, run_dir=folder, environment=first.environment | {"JEZERO_RUN_DIR": str(folder)})
    try:
        first.jezero("up", "-d", "--profile", profiles[0])
        if profiles[0] == "sim":
            _await_origin(first.instance)
        second.jezero("up", "--wait", "--profile", profiles[1])
        wait_for(lambda: _is_ready(first), TIMEOUT_S, f"the launcher of {profiles[0]} says ready")
        for stack in (first, second):
            assert {row["health"] for row in _rows(stack)} == {"ok"}, stack.jezero("ps").stdout
        assert _state_of_router(second) == "external"
        with first.connect() as vehicle:
            vehicle.wait_ready(TIMEOUT_S)
            vehicle.takeoff(altitude_m=2.0).result(timeout_s=TIMEOUT_S)
    finally:
        second.jezero("down", check=False)
    assert _state_of_router(first) == "running"


def _await_origin(instance: Instance) -> None:
    """Wait in the bridge's place until the autopilot has sent its origin, which it does once."""
    codec = MavlinkCodec(instance.system_id, dialect.MAV_COMP_ID_ONBOARD_COMPUTER)
    deadline_s = time.monotonic() + TIMEOUT_S
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", instance.bridge_port))
        listener.settimeout(TIMEOUT_S)
        while time.monotonic() < deadline_s:
            messages = codec.parse(listener.recv(65536))
            if any(message.get_msgId() == dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN for message in messages):
                return
    raise AssertionError("the autopilot has sent no origin")


def _rows(stack: Stack) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = json.loads(stack.jezero("ps", "--json").stdout)
    return rows


def _state_of_router(stack: Stack) -> object:
    (row,) = (row for row in _rows(stack) if row["service"] == "router")
    return row["state"]


def _is_ready(stack: Stack) -> bool:
    return bool(json.loads((stack.run_dir / "state.json").read_text())["ready"])


@pytest.mark.long
@pytest.mark.parametrize("profiles", [("sim", "control"), ("control", "sim")])
def test_profiles_started_apart_get_ready_in_either_order(
    unstarted: Stack, tmp_path: Path, profiles: tuple[str, str]
) -> None:
    get_ready_apart(unstarted, tmp_path, profiles)
