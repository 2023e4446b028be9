"""What happens when the line to the flight controller is cut, or the flight controller boots anew, in each phase.

`python -m benchmarks.quality.twin_faults [--phases hover,landing] [--cuts 0.5,2,10] [--baud 921600]` flies the twin in
real time. In each phase the flight controller's plug is pulled for each time, and put back. Then the process of the
flight controller is stopped for 2 s, so that its clock falls behind, and killed on the ground and in the air. Prints a
row of a table for each: what the goal ended with, the statuses that followed, and when the vehicle was ready again.
"""

import argparse
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.quality.real_landings import INSTANCE, TWIN_READY_WITHIN_S
from benchmarks.speed.stack import running_stack, running_twin
from jezero import JezeroError, TimedOut, Unreachable, Vehicle
from jezero.base.config import config_directory
from jezero.client.goal import Goal
from jezero.deploy.launcher.state import RunFolder
from jezero.deploy.twin.twin import SETTINGS
from jezero.schemas.state import Status, StatusCode

SETTLES_WITHIN_S = 60.0
STILL_S = 3.0
"""The vehicle has settled when it was ready for this time without a change of the status."""
STEP_S = 0.05
AUTOPILOT_S = 120.0


class Phase(NamedTuple):
    """A phase of a flight.

    Attributes:
        after_s: time from the goal's start to the fault.
        start: sends the goal; None for a hover.
    """

    after_s: float
    start: Callable[[Vehicle], "Goal[Any, Any] | None"]


PHASES = {
    "takeoff": Phase(1.5, lambda uav: uav.takeoff(altitude_m=4.0)),
    "hover": Phase(0.5, lambda uav: None),
    "go_to": Phase(2.0, lambda uav: uav.go_to(6.0, 4.0, -4.0)),
    "get_images": Phase(4.0, lambda uav: uav.get_images((3.0, -2.0, -4.0), radius_m=2.5, num_images=6)),
    "approach": Phase(1.5, lambda uav: uav.land_on_spot()),
    "descent": Phase(8.0, lambda uav: uav.land_on_spot()),
}


class Observation(NamedTuple):
    """What followed a fault.

    Attributes:
        goal: outcome and reason of the goal; "" without one.
        statuses: codes of the status in their order, from the fault on.
        settled_s: time from the fault's beginning until the vehicle was ready and stayed so; None if it never was.
        epoch_changed: a new epoch began.
    """

    goal: str
    statuses: list[StatusCode]
    settled_s: float | None
    epoch_changed: bool


def status_of(uav: Vehicle) -> Status | None:
    """Newest status; None while no bridge replies."""
    try:
        return uav.status()
    except (Unreachable, TimedOut):
        return None


def observe(uav: Vehicle, goal: "Goal[Any, Any] | None", epoch_id: int, until_s: float) -> Observation:
    """Watch the status until the vehicle has settled.

    Args:
        until_s: monotonic time at which the fault is over; the vehicle doesn't count as settled before.
    """
    begin_s = changed_s = time.monotonic()
    seen: list[StatusCode] = []
    settled_s: float | None = None
    status: Status | None = None
    while time.monotonic() < until_s + SETTLES_WITHIN_S:
        status = status_of(uav)
        now_s = time.monotonic()
        code = None if status is None else StatusCode(status.code)
        if code is not None and (not seen or seen[-1] != code):
            seen.append(code)
            changed_s = now_s
        rests = status is not None and (status.ready or status.code in (StatusCode.HOVER, StatusCode.EXTERNAL))
        if not rests:
            changed_s = now_s
        elif now_s - max(changed_s, until_s) > STILL_S:
            settled_s = changed_s - begin_s
            break
        time.sleep(STEP_S)
    words = ""
    if goal is not None:
        try:
            goal.result(5.0)
            words = "succeeded"
        except JezeroError as error:
            words = str(error)
    return Observation(words, seen, settled_s, status is not None and status.epoch_id != epoch_id)


def bring_to_hover(uav: Vehicle) -> int:
    """Bring the vehicle into the air, and take control of it where another had it; returns the epoch."""
    deadline_s = time.monotonic() + AUTOPILOT_S
    while time.monotonic() < deadline_s:
        status = status_of(uav)
        try:
            if status is None:
                pass
            elif status.code == StatusCode.HOVER:
                uav.go_to(0.0, 0.0, -4.0).result(AUTOPILOT_S)
                return uav.status().epoch_id
            elif status.code == StatusCode.EXTERNAL:
                uav.hover()
            elif status.ready:
                uav.takeoff(altitude_m=4.0).result(AUTOPILOT_S)
        except JezeroError as error:
            print(f"  again: {error}", flush=True)
        time.sleep(0.5)
    raise RuntimeError("the vehicle doesn't hover")


def bring_to_ground(uav: Vehicle) -> int:
    """Land where the vehicle is; returns the epoch."""
    bring_to_hover(uav)
    uav.land_on_spot((0.0, 0.0, 0.0), use_uwb=False, use_tag=False).result(AUTOPILOT_S)
    return uav.wait_ready(AUTOPILOT_S).epoch_id


def row(phase: str, fault: str, seen: Observation) -> str:
    codes = " → ".join(f"{code.value} {code.name.lower()}" for code in seen.statuses)
    epoch = "; new epoch" if seen.epoch_changed else ""
    settled = "never" if seen.settled_s is None else f"{seen.settled_s:.1f} s"
    return f"| {phase} | {fault} | {seen.goal or '–'} | {codes}{epoch} | {settled} |"


def cut(uav: Vehicle, twin: "subprocess.Popen[str]", phase: Phase, duration_s: float) -> Observation:
    """Pull the plug in a phase, and put it back after a time."""
    epoch_id = bring_to_ground(uav) if phase is PHASES["takeoff"] else bring_to_hover(uav)
    goal = phase.start(uav)
    time.sleep(phase.after_s)
    twin.send_signal(signal.SIGUSR1)
    until_s = time.monotonic() + duration_s
    with signalling("USR1", [twin.pid], until_s):
        return observe(uav, goal, epoch_id, until_s)


@contextmanager
def signalling(name: str, pids: Sequence[int], at_s: float) -> Iterator[None]:
    """Send a signal to processes at a monotonic time, while the caller watches."""
    seconds = max(at_s - time.monotonic(), 0.0)
    helper = subprocess.Popen(["/bin/sh", "-c", f"sleep {seconds:.2f}; kill -{name} {' '.join(map(str, pids))}"])
    try:
        yield
    finally:
        helper.wait(timeout=seconds + 10.0)


def processes_of(hardware: Path) -> dict[str, int]:
    """Process id of the twin's launcher and of each of its services."""
    state = RunFolder(hardware / "run").read()
    assert state is not None
    return {"launcher": state.launcher_pid, **{s.service: s.pid for s in state.services if s.pid is not None}}


def boot_anew(uav: Vehicle, hardware: Path, *, in_air: bool) -> Observation:
    """Kill the flight controller's process; the twin's launcher starts a new one."""
    epoch_id = bring_to_hover(uav) if in_air else bring_to_ground(uav)
    os.kill(processes_of(hardware)["autopilot"], signal.SIGKILL)
    return observe(uav, None, epoch_id, time.monotonic() + 5.0)


def stand_still(uav: Vehicle, hardware: Path, duration_s: float) -> Observation:
    """Stop the flight controller and its world for a time: its clock falls behind by this time."""
    epoch_id = bring_to_hover(uav)
    stopped = processes_of(hardware)
    launcher = stopped.pop("launcher")
    for pid in (launcher, *stopped.values()):
        os.kill(pid, signal.SIGSTOP)
    until_s = time.monotonic() + duration_s
    try:
        with signalling("CONT", list(stopped.values()), until_s):
            return observe(uav, None, epoch_id, until_s)
    finally:
        os.kill(launcher, signal.SIGCONT)  # last: it would kill what it has not heard of for 2 s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--phases", default=",".join(PHASES))
    parser.add_argument("--cuts", default="0.5,2,10")
    parser.add_argument("--baud", type=int, default=921_600)
    parser.add_argument("--no-boots", action="store_true", help="leave out the flight controller's boots and stops")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        profiles = ("--profile", "onboard", "--profile", "rover")
        with (
            running_twin(scratch / "twin", config_directory(), options.baud) as twin,
            running_stack(INSTANCE, scratch / "run", *profiles, settings=scratch / "twin" / SETTINGS),
            Vehicle.connect(INSTANCE.vehicle, router=INSTANCE.router) as uav,
        ):
            uav.wait_ready(TWIN_READY_WITHIN_S)
            print("| phase | fault | goal | status | ready or hovering after |\n|---|---|---|---|---|", flush=True)
            for phase in filter(None, options.phases.split(",")):
                for text in options.cuts.split(","):
                    print(row(phase, f"line cut for {text} s", cut(uav, twin, PHASES[phase], float(text))), flush=True)
            if options.no_boots:
                return
            hardware = scratch / "twin" / "hardware"
            print(row("hover", "the controller stands still for 2 s", stand_still(uav, hardware, 2.0)), flush=True)
            for in_air in (False, True):
                where = "in the air" if in_air else "on the ground"
                print(row(where, "the controller boots", boot_anew(uav, hardware, in_air=in_air)), flush=True)


if __name__ == "__main__":
    main()
