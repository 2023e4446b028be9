"""A stack whose rover has a computer of its own, the service `rover`."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import zenoh

from jezero.base.codec import decode
from jezero.base.zenoh_client import client_config, data_of
from jezero.schemas import topics
from jezero.schemas.health import ServiceHealth
from jezero.schemas.sensors import RoverOdometry
from tests.system.conftest import Stack, wait_for

TIMEOUT_S = 20.0
SILENCE_S = 0.5
"""Time in which a dozen readings would arrive."""


@contextmanager
def rover_computer(stack: Stack) -> Iterator["subprocess.Popen[bytes]"]:
    """The service `rover`, started by hand, so that nobody starts it again."""
    process = subprocess.Popen([sys.executable, "-m", "jezero.services.rover"], env=stack.service_environment)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def falls_silent(readings: list[RoverOdometry]) -> bool:
    """Whether no reading arrives for `SILENCE_S`."""
    count, start_s = len(readings), time.monotonic()
    while len(readings) == count:
        if time.monotonic() - start_s > SILENCE_S:
            return True
        time.sleep(0.01)
    return False


def await_more(readings: list[RoverOdometry], description: str) -> None:
    count = len(readings)
    wait_for(lambda: len(readings) >= count + 10, TIMEOUT_S, description)


@pytest.mark.long
def test_the_rovers_computer_publishes_and_drives_and_the_simulator_takes_over_when_it_dies(stack: Stack) -> None:
    readings: list[RoverOdometry] = []
    texts: list[str] = []
    vehicle_name = stack.instance.vehicle
    with zenoh.open(client_config(stack.instance.router)) as session, stack.connect() as vehicle:
        session.declare_subscriber(
            topics.key(vehicle_name, topics.ROVER_ODOMETRY.name),
            lambda sample: readings.append(decode(RoverOdometry, data_of(sample))),
        )
        session.declare_subscriber(
            topics.key(vehicle_name, topics.health_of("simulator").name),
            lambda sample: texts.append(decode(ServiceHealth, data_of(sample)).text),
        )
        await_more(readings, "the simulator publishes while there is no rover's computer")
        with rover_computer(stack) as process:
            wait_for(lambda: texts and "rover's computer is connected" in texts[-1], TIMEOUT_S, "it is connected")
            await_more(readings, "the rover's computer publishes")

            process.send_signal(signal.SIGSTOP)
            wait_for(lambda: falls_silent(readings), TIMEOUT_S, "without it nobody publishes: it was the one")
            process.send_signal(signal.SIGCONT)
            await_more(readings, "it publishes again")

            start = readings[-1]
            vehicle.rover.drive(1.0, for_s=2.0)
            moved_m = readings[-1].pos_odom_m[0] - start.pos_odom_m[0], readings[-1].pos_odom_m[1] - start.pos_odom_m[1]
            assert (moved_m[0] ** 2 + moved_m[1] ** 2) ** 0.5 > 0.5

            os.kill(process.pid, signal.SIGKILL)
            wait_for(lambda: "rover's computer is gone" in texts[-1], TIMEOUT_S, "the simulator notices its death")
            await_more(readings, "the simulator publishes again")
    times_ns = [reading.t_ns for reading in readings]
    assert len(times_ns) == len(set(times_ns)), "no reading was published twice"
