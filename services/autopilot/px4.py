"""PX4 itself in place of the embedded autopilot: how it is started, and a service that publishes its health."""

from collections.abc import Iterator
from pathlib import Path

from jezero.base.config import ConfigError
from jezero.base.vehicle_config import BatteryConfig
from jezero.runtime.service import Health, Inbox, Output, Spec

PX4 = "px4"
INSTANCE_MAX = 9
"""PX4's start script gives all higher instances the same port."""
MODEL = "none_iris"
"""Airframe 10016; the simulator has the same motors."""
START = Path(__file__).with_name("px4_start.sh")

SPEC = Spec(name="autopilot", links=(PX4,), triggers=(PX4,), rate_hz=10.0)


class Px4:
    """Publishes whether PX4 is connected to the simulator."""

    spec = SPEC

    def __init__(self) -> None:
        self._health: Health | None = None

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """See `Service`."""
        up = inbox.is_up(PX4)
        health = Health("ok", "PX4 is connected") if up else Health("starting", "PX4 waits for the simulator")
        if health != self._health:
            self._health = health
            yield health


def environment(battery: BatteryConfig) -> dict[str, str]:
    """Variables that PX4's start scripts read."""
    return {"PX4_SIM_MODEL": MODEL, "PX4_BATTERY_S": f"{1.0 / battery.used(1.0):.0f}"}


def command(runtime: Path | None, instance: int) -> tuple[str, ...]:
    """Command that starts PX4 in its working directory.

    Args:
        runtime: folder with PX4's `bin/px4` and `etc/`.

    Raises:
        ConfigError: there is no runtime, or PX4 does not support this instance.
    """
    if runtime is None:
        raise ConfigError("JEZERO_PX4_DIR is not set: it names the folder with PX4's bin/px4 and etc/")
    runtime = runtime.absolute()
    program, scripts = runtime / "bin" / "px4", runtime / "etc"
    if not program.is_file() or not scripts.is_dir():
        raise ConfigError(f"JEZERO_PX4_DIR: {runtime} has no bin/px4 or no etc/, so it is not a PX4 runtime")
    if instance > INSTANCE_MAX:
        raise ConfigError(f"JEZERO_INSTANCE is {instance}: with PX4 it is {INSTANCE_MAX} at most")
    return (str(program), "-i", str(instance), "-d", str(scripts), "-s", str(START))
