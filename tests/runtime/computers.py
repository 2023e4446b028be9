"""Computers with a router and a gate of their own, as real processes that end with the test."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import zenoh

from jezero.base.zenoh_client import client_config
from jezero.keys.bundle import secured
from jezero.keys.team import Team
from jezero.runtime.instance import socket_of
from tests.keys.rig import free_port

LATEST_S = 30.0
"""A busy machine takes a second or two for the start of a process."""


def wait_until(condition: Callable[[], object], latest_s: float = LATEST_S) -> bool:
    """Whether a condition becomes true in time."""
    deadline_s = time.monotonic() + latest_s
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.02)
    return True


class Computer:
    """A router and a gate with the bundle of one member of a team.

    Args:
        team: the team.
        member: name of the member whose computer it is.
        folder: for the run folder, logs, and this computer's copy of the bundle.
        connect: addresses of other computers' gates.
        vehicle: name of the vehicle.

    Attributes:
        bundle: this computer's copy of the bundle.
        address: where its gate listens.
        people, bus: addresses of the router for programs and for services.
        log: of the gate.
        gate: process of the gate.
    """

    def __init__(
        self,
        team: Team,
        member: str,
        folder: Path,
        ends: ExitStack,
        connect: tuple[str, ...] = (),
        vehicle: str = "uav1",
    ) -> None:
        self.team, self.bundle = team, folder / member
        self._member, self._ends = member, ends
        self.copy_bundle()
        self.address, self.people = f"tls/127.0.0.1:{free_port()}", f"tcp/127.0.0.1:{free_port()}"
        self.bus, self.log = socket_of(folder), folder / "gate.log"
        self._environment = {
            **os.environ,
            "JEZERO_VEHICLE": vehicle,
            "JEZERO_RUN_DIR": str(folder),
            "JEZERO_LISTEN": "" if connect else self.address,
            "JEZERO_CONNECT": " ".join(connect),
            "JEZERO_KEYS": str(self.bundle),
        }
        self._run("router", folder / "router.log", JEZERO_ROUTER=self.people)
        self.gate = self._run("gate", self.log, JEZERO_ROUTER=self.bus)

    def _run(self, name: str, log: Path, **variables: str) -> "subprocess.Popen[bytes]":
        with log.open("wb") as out:
            process = subprocess.Popen(
                [sys.executable, "-m", f"jezero.runtime.{name}"],
                env={**self._environment, **variables},
                stdout=out,
                stderr=out,
            )
        self._ends.callback(process.wait, LATEST_S)
        self._ends.callback(process.terminate)
        return process

    def copy_bundle(self) -> None:
        """Copy the member's bundle as it is now to this computer, as a person does after each change."""
        self.bundle.mkdir(mode=0o700, exist_ok=True)
        for file in self.team.bundle(self._member).iterdir():
            new = self.bundle / f"{file.name}.new"
            new.touch(mode=0o600)
            new.write_bytes(file.read_bytes())
            new.replace(self.bundle / file.name)

    def program(self) -> zenoh.Session:
        """A program of this computer, closed at the end of the test."""
        return self._open(self.people)

    def service(self) -> zenoh.Session:
        """A service of this computer, closed at the end of the test."""
        return self._open(self.bus)

    def _open(self, address: str) -> zenoh.Session:
        return self._ends.enter_context(zenoh.open(client_config(address, LATEST_S)))

    def visitor(self, name: str, timeout_s: float = LATEST_S) -> zenoh.Session:
        """The session of a member on another computer, which the caller closes."""
        return zenoh.open(client_config(secured(self.address, self.team.bundle(name)), timeout_s))


@contextmanager
def computer(team: Team, folder: Path, member: str = "vehicle-uav1") -> Iterator[Computer]:
    """One computer until the end of the block."""
    with ExitStack() as ends:
        yield Computer(team, member, folder, ends)
