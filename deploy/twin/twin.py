"""Runs the twin: a stack of its own with simulator and autopilot, and the lines to it.

Nothing else crosses: the twin has a router, a name and ports of its own, and a clock that drifts.
"""

import os
import re
import select
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from jezero.base.config import WORLD_VARIABLE, config_directory
from jezero.deploy.launcher.ports import HOST, instance_environment, reserved_instance
from jezero.deploy.twin.camera import DELAY_S, serving_camera
from jezero.deploy.twin.line import Line
from jezero.deploy.twin.modules import Modules, running_modules
from jezero.keys.controller_key import CONTROLLER_KEY_VARIABLE
from jezero.runtime.instance import Instance

VEHICLE = "twin"
CONTROLLER = "flight-controller"
"""The device of the flight controller, in the twin's folder."""
SETTINGS = "config"
"""Folder of the settings for a stack that flies the twin, in the twin's folder."""
TURN_S = 0.002
START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 30.0
CHUNK = 65_536


class TwinError(RuntimeError):
    """The twin can't start; the message says why."""


def write_settings(folder: Path, instance: Instance, baud: int) -> Path:
    """Copy the settings, with the links to the twin; returns the new folder.

    Args:
        folder: the twin's.
        instance: the hardware's.
        baud: that of the flight controller's line.
    """
    settings = folder / SETTINGS
    shutil.copytree(config_directory(), settings, dirs_exist_ok=True)
    set_field(settings / "vehicle_bridge.toml", "system_id", str(instance.system_id))
    set_field(settings / "vehicle_bridge.toml", "link", f'"serial:{folder / CONTROLLER}:{baud}"')
    return settings


def set_field(path: Path, field: str, value: str, table: str = "") -> None:
    """Set a field of a table of a file of settings; without a table, one that stands above all tables."""
    text = re.sub(rf"^{field} *=.*\n", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    if not table:
        text = f"{field} = {value}\n{text}"
    elif f"[{table}]\n" in text:
        text = text.replace(f"[{table}]\n", f"[{table}]\n{field} = {value}\n", 1)
    else:
        text += f"\n[{table}]\n{field} = {value}\n"
    path.write_text(text, encoding="utf-8")


def flying_command(settings: Path) -> str:
    """The command that flies the twin, with the world and the key of this process, which its stack needs too.

    Args:
        settings: the folder of `write_settings`.
    """
    variables = {"JEZERO_CONFIG_DIR": str(settings)}
    for name in (WORLD_VARIABLE, CONTROLLER_KEY_VARIABLE):
        if given := os.environ.get(name):  # a world may be a name
            variables[name] = str(Path(given).resolve()) if Path(given).is_file() else given
    words = " ".join(f"{name}={shlex.quote(value)}" for name, value in variables.items())
    return f"{words} jezero up --profile onboard --profile rover --profile ground"


@contextmanager
def running_hardware(folder: Path, drift_ppm: float) -> Iterator[Instance]:
    """Run simulator and autopilot until the context ends.

    Args:
        folder: the twin's.
        drift_ppm: how much faster than this computer's its clock runs, in millionths.

    Raises:
        TwinError: they don't start.
    """
    settings, run_dir = folder / "hardware" / "config", folder / "hardware" / "run"
    shutil.copytree(config_directory(), settings, dirs_exist_ok=True)
    set_field(settings / "simulator.toml", "pace", f"{1.0 + 1e-6 * drift_ppm:.6f}")
    set_field(settings / "simulator.toml", "time_from_boot", "true")
    set_field(settings / "simulator.toml", "on_hil", "true", "altimeter")  # the rangefinder is the flight controller's
    with reserved_instance(VEHICLE) as instance:
        own = {"JEZERO_CONFIG_DIR": str(settings), "JEZERO_RUN_DIR": str(run_dir), "JEZERO_RECORD": "0"}
        dropped = ("JEZERO_LISTEN", "JEZERO_CONNECT", "JEZERO_KEYS")
        environment = {name: value for name, value in os.environ.items() if name not in dropped}
        environment |= {**instance_environment(instance), **own}
        jezero = (sys.executable, "-m", "jezero.cli.main")
        up = (*jezero, "up", "--profile", "sim", "-d")
        done = subprocess.run(up, env=environment, capture_output=True, text=True, check=False, timeout=START_TIMEOUT_S)
        try:
            if done.returncode != 0:
                raise TwinError(f"the twin's simulator does not start: {done.stderr.strip() or done.stdout.strip()}")
            yield instance
        finally:
            down = (*jezero, "down")
            subprocess.run(down, env=environment, capture_output=True, check=False, timeout=STOP_TIMEOUT_S)


class Twin:
    """Relays between the hardware and the lines to it.

    Args:
        folder: where the devices are made.
        instance: the hardware's.
        baud: that of the flight controller's line.
        modules: what is on other lines.
    """

    def __init__(self, folder: Path, instance: Instance, baud: int, modules: Modules) -> None:
        self._modules = modules
        self.controller = Line(folder / CONTROLLER, baud)
        self._autopilot = (HOST, instance.autopilot_offboard_port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((HOST, instance.bridge_port))
        self._socket.setblocking(False)
        self._stopping = False

    def stop(self, signum: int = 0, frame: FrameType | None = None) -> None:
        """End `run`; a signal handler."""
        self._stopping = True

    def pull_or_put_plug(self, signum: int = 0, frame: FrameType | None = None) -> None:
        """Pull the flight controller's plug, or put it back; a signal handler."""
        if self.controller.is_plugged:
            self.controller.unplug()
        else:
            self.controller.plug()

    def run(self) -> None:
        """Relay until `stop` is called."""
        while not self._stopping:
            select.select([self._socket], [], [], TURN_S)
            self._modules.turn(time.monotonic())
            with suppress(BlockingIOError, ConnectionRefusedError):
                while True:
                    self.controller.put(self._socket.recv(CHUNK))
            if data := self.controller.move(time.monotonic()):
                with suppress(OSError):
                    self._socket.sendto(data, self._autopilot)

    def close(self) -> None:
        """Remove the devices."""
        self.controller.close()
        self._socket.close()


def run_twin(folder: Path, baud: int, drift_ppm: float) -> int:
    """Run the twin until SIGTERM or SIGINT; SIGUSR1 pulls the flight controller's plug, or puts it back.

    Raises:
        TwinError: it can't start.
        OSError: its folder can't be written.
    """
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    with (
        running_hardware(folder, drift_ppm) as instance,
        running_modules(folder, instance) as modules,
        serving_camera(instance) as camera,
    ):
        settings = write_settings(folder, instance, baud)
        set_field(settings / "estimator.toml", "std_time_s", "0.05")
        set_field(settings / "camera_driver.toml", "source", f'"{camera}"')
        set_field(settings / "camera_driver.toml", "exposure_delay_s", f"{DELAY_S:g}")
        for file, table, field, value in modules.settings:
            set_field(settings / f"{file}.toml", field, value, table)
        twin = Twin(folder, instance, baud, modules)
        try:
            signal.signal(signal.SIGTERM, twin.stop)
            signal.signal(signal.SIGINT, twin.stop)
            signal.signal(signal.SIGUSR1, twin.pull_or_put_plug)
            print(f"flight controller  serial:{twin.controller.path}:{baud}")
            for name, device in modules.devices.items():
                print(f"{name:<18} {device}")
            print(f"camera             {camera}")
            print(f"fly it with        {flying_command(settings)}", flush=True)
            twin.run()
        finally:
            twin.close()
    return 0
