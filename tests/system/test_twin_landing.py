"""A stack that flies the twin: time, telemetry, ranges and odometry come by lines, as from real hardware."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from math import hypot
from pathlib import Path

import pytest
import zenoh

from jezero import TimedOut, Unreachable, Vehicle
from jezero.base.codec import decode
from jezero.base.zenoh_client import client_config, data_of
from jezero.deploy.twin.twin import SETTINGS, VEHICLE
from jezero.runtime.instance import socket_of
from jezero.schemas.health import ServiceHealth
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import StatusCode, Truth
from jezero.schemas.topics import ALTIMETER, TRUTH, health_of, key
from tests.system.conftest import Stack, settings_without_pictures, wait_for, wait_for_status

TIMEOUT_S = 240.0
"""Of each step of the flight: two stacks on two processors may be slow."""


@contextmanager
def running_twin(folder: Path) -> Iterator[Path]:
    """A twin whose own camera renders nothing; gives its folder, when a stack can start."""
    settings = settings_without_pictures(folder / "settings")
    twin = folder / "twin"
    words = [sys.executable, "-m", "jezero.cli.main", "twin", "--folder", str(twin)]
    environment = {**os.environ, "JEZERO_CONFIG_DIR": str(settings)}
    with subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            lines = iter(process.stdout.readline, "")
            assert any("fly it with" in line for line in lines), "the twin has ended"
            yield twin
        finally:
            process.terminate()


def is_ready(vehicle: Vehicle) -> bool:
    """Whether a takeoff is possible; not while the bridge still starts."""
    try:
        return vehicle.status().ready
    except (Unreachable, TimedOut):
        return False


def is_ok(healths: dict[str, ServiceHealth], service: str) -> bool:
    return service in healths and healths[service].state == "ok"


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_the_stack_finds_the_twins_rover_by_uwb_and_lands_on_it(unstarted: Stack, tmp_path: Path) -> None:
    stack = unstarted
    truths: list[Truth] = []
    ranges: list[Altimeter] = []
    healths: dict[str, ServiceHealth] = {}

    def on_health(sample: zenoh.Sample) -> None:
        health = decode(ServiceHealth, data_of(sample))
        healths[str(sample.key_expr).rpartition("/")[2]] = health

    with running_twin(tmp_path) as twin:
        stack.environment["JEZERO_CONFIG_DIR"] = str(twin / SETTINGS)
        stack.jezero("up", "-d", "--profile", "onboard", "--profile", "rover")
        hardware = client_config(socket_of(twin / "hardware" / "run"))
        name = stack.instance.vehicle
        with (
            zenoh.open(hardware) as world,
            zenoh.open(client_config(stack.instance.router)) as session,
            stack.connect() as uav,
        ):
            world.declare_subscriber(key(VEHICLE, TRUTH.name), lambda s: truths.append(decode(Truth, data_of(s))))
            session.declare_subscriber(
                key(name, ALTIMETER.name), lambda s: ranges.append(decode(Altimeter, data_of(s)))
            )
            for service in ("uwb", "rover_driver"):
                session.declare_subscriber(key(name, health_of(service).name), on_health)
            wait_for(lambda: is_ready(uav), TIMEOUT_S, "ready")
            for service in ("uwb", "rover_driver"):
                wait_for(partial(is_ok, healths, service), TIMEOUT_S, f"{service} is ok")
            uav.takeoff(altitude_m=3.0).result(timeout_s=TIMEOUT_S)
            assert any(each.range_m is not None and each.range_m > 1.0 for each in ranges), "of the flight controller"
            wait_for(lambda: uav.relative(timeout_s=10.0).valid, TIMEOUT_S, "the rover is found")
            uav.land_on_spot(use_tag=False).result(timeout_s=TIMEOUT_S)
            wait_for_status(uav, lambda status: status.code == StatusCode.IDLE, TIMEOUT_S, "landed")
    truth = truths[-1]
    (north_m, east_m, down_m), (rover_north_m, rover_east_m, rover_down_m) = truth.pos_uav_ned_m, truth.pos_rover_ned_m
    assert hypot(north_m - rover_north_m, east_m - rover_east_m) < 0.5, "on the platform, whose side is 1 m"
    assert abs(down_m - rover_down_m) < 0.1
