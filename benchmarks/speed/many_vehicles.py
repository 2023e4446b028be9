"""Number of vehicles in real time on one router, each with a simulator and a stack without camera and tag detector."""

import time
from contextlib import ExitStack
from pathlib import Path

import msgspec
import zenoh

from benchmarks.speed.bare import direct
from benchmarks.speed.stack import HOVER_ALTITUDE_M, compose_file, running_stack
from jezero import JezeroError, Vehicle
from jezero.base.codec import decode
from jezero.base.zenoh_client import client_config
from jezero.deploy.launcher.ports import reserved_instance
from jezero.runtime.instance import Instance
from jezero.schemas.state import Clock
from jezero.schemas.topics import CLOCK, key

REAL_TIME = 0.98
"""Least ratio of vehicle time to wall time that counts as real time."""
MEASURE_S = 10.0


class Fleet(msgspec.Struct, frozen=True):
    """Result with a number of vehicles.

    Attributes:
        vehicles: number of vehicles.
        rates: ratio of vehicle time to wall time of each vehicle; empty when not all could be started.
        text: reason why not all could be started.
    """

    vehicles: int
    rates: tuple[float, ...]
    text: str = ""

    @property
    def in_real_time(self) -> bool:
        return bool(self.rates) and min(self.rates) >= REAL_TIME


def measure(folder: Path, most: int) -> list[Fleet]:
    """Add hovering vehicles one by one, until one falls behind or there are `most`."""
    fleets: list[Fleet] = []
    instances: list[Instance] = []
    path = compose_file(folder, without=("camera", "tag_detector"))
    with ExitStack() as stack:
        while len(fleets) < most and (not fleets or fleets[-1].in_real_time):
            instance = stack.enter_context(reserved_instance(vehicle=f"fleet{len(fleets) + 1}"))
            if instances:
                instance = msgspec.structs.replace(instance, router=instances[0].router)
            instances.append(instance)
            try:
                stack.enter_context(running_stack(instance, folder / instance.vehicle, "-f", str(path)))
                _take_off(instance)
            except (RuntimeError, JezeroError) as error:
                fleets.append(Fleet(len(instances), (), str(error)))
            else:
                fleets.append(Fleet(len(instances), _clock_rates(instances)))
    return fleets


def _take_off(instance: Instance) -> None:
    with Vehicle.connect(instance.vehicle, router=instance.router) as uav:
        uav.wait_ready()
        uav.takeoff(altitude_m=HOVER_ALTITUDE_M).result(timeout_s=60)


def _clock_rates(instances: list[Instance]) -> tuple[float, ...]:
    """Ratio of vehicle time to wall time, of each vehicle."""
    times_by_vehicle: dict[str, list[tuple[int, int]]] = {instance.vehicle: [] for instance in instances}
    with zenoh.open(client_config(instances[0].router)) as session:
        for instance in instances:

            def on_clock(
                sample: zenoh.Sample, times: list[tuple[int, int]] = times_by_vehicle[instance.vehicle]
            ) -> None:
                times.append((time.monotonic_ns(), decode(Clock, sample.payload.to_bytes()).t_ns))

            session.declare_subscriber(key(instance.vehicle, CLOCK.name), direct(on_clock))
        time.sleep(MEASURE_S)
    return tuple(
        (times[-1][1] - times[0][1]) / (times[-1][0] - times[0][0]) if len(times) > 1 else 0.0
        for times in times_by_vehicle.values()
    )
