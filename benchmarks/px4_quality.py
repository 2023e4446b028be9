"""PX4 and the embedded autopilot side by side, in the same world, wind and sensor errors, with the same setpoints.

`JEZERO_PX4_DIR=<folder> python -m benchmarks.px4_quality [--seeds N]`: 3 m/s mean wind, gusts of 0.6 m/s. PX4 flies as
a process of its own, in lockstep with the simulated world and faster than real time, with the parameters that the
bridge gives it; nothing but the autopilot is exchanged.
"""

import argparse
import os
import select
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, redirect_stdout
from math import degrees, inf
from pathlib import Path
from statistics import median

import msgspec

from benchmarks.flight_quality import CLIMB_S, HEIGHT_M, READY_S, Flight, Make, Target, embedded, fly, hold, track
from jezero.deploy.launcher.ports import HOST, reserved_instance
from jezero.frames import tilt_from_quat
from jezero.mavlink import MavlinkCodec, dialect
from jezero.runtime.child import ChildLink
from jezero.runtime.config import Instance, load_config
from jezero.runtime.links import TcpServer, Udp
from jezero.runtime.service import Inbox, Output, Send, Service, Spec
from jezero.services.autopilot import px4
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.parameters import ParameterSetter

HIL, OFFBOARD = "hil", "offboard"
FIRST_ANSWER_WITHIN_S = 0.02
ANSWER_WITHIN_S = 0.5
"""Longer than a busy machine ever makes it wait; PX4 leaves only its first few readings unanswered."""
STARTS_WITHIN_S = 10.0
DOWN_S = READY_S + CLIMB_S
DOWN_MPS = 0.5


class Px4Process:
    """PX4 behind the links of a service on the memory bus.

    It answers each HIL_SENSOR before virtual time goes on. Until it is ready, time runs no faster than the wall's, as
    its start-up script doesn't know of virtual time.
    """

    spec = Spec(name="autopilot", links=(HIL, OFFBOARD), triggers=(HIL, OFFBOARD), rate_hz=250.0)

    def __init__(self, runtime: Path, instance: Instance, gains: Mapping[str, float]) -> None:
        self._system_id = instance.system_id
        self._hil = TcpServer(HOST, instance.hil_port)
        self._offboard = Udp((HOST, instance.bridge_port), (HOST, instance.autopilot_offboard_port))
        command = px4.command(runtime, instance.number)
        self._child = ChildLink("PX4", command, px4.ENVIRONMENT, None, instance.hil_port)
        for link in (self._hil, self._offboard, self._child):
            link.start()
        self._begin_s = time.monotonic()
        while not self._hil.up:
            if time.monotonic() - self._begin_s > STARTS_WITHIN_S:
                raise TimeoutError("PX4 has not connected")
            self._child.poll(time.monotonic_ns())
            self._hil.poll(time.monotonic_ns())
            time.sleep(0.001)
        self._begin_s = time.monotonic()
        self._patience_s = FIRST_ANSWER_WITHIN_S
        self._setter = ParameterSetter({**load_config(VehicleBridgeConfig, "vehicle_bridge").parameters, **gains})
        self._codec = MavlinkCodec(instance.system_id, dialect.MAV_COMP_ID_ONBOARD_COMPUTER)

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Pass on what arrived in either direction."""
        self._child.poll(time.monotonic_ns())
        if setpoints := inbox.received(OFFBOARD):
            self._offboard.send(setpoints)
        if readings := inbox.received(HIL):
            self._hil.send(readings)
            select.select(self._hil.sockets(), [], [], self._patience_s)
            if commands := self._hil.poll(time.monotonic_ns()):
                self._patience_s = ANSWER_WITHIN_S
                yield Send(HIL, commands)
        if telemetry := self._offboard.poll(time.monotonic_ns()):
            self._set_parameters(t_ns, telemetry)
            yield Send(OFFBOARD, telemetry)
        if t_ns < READY_S * 1e9:
            time.sleep(max(0.0, self._begin_s + t_ns * 1e-9 - time.monotonic()))

    def _set_parameters(self, t_ns: int, telemetry: bytes) -> None:
        """As the bridge does when it first hears the autopilot."""
        if not self._setter.pending:
            return
        for message in self._codec.parse(telemetry):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
                self._setter.confirm(message.param_id, message.param_value, message.param_type)
        for name, value, kind in self._setter.due(t_ns):
            message = dialect.MAVLink_param_set_message(self._system_id, 1, name.encode(), value, kind)
            self._offboard.send(self._codec.pack(message))
        if self._setter.failed:
            raise RuntimeError(self._setter.complaint)

    def close(self) -> None:
        """End PX4."""
        for link in (self._child, self._hil, self._offboard):
            link.close()


@contextmanager
def real_px4(runtime: Path, gains: Mapping[str, float]) -> Iterator[Make]:
    """PX4 for one flight, with gains other than its own."""
    with reserved_instance() as instance:
        started: list[Px4Process] = []

        def make() -> tuple[Service, int]:
            started.append(Px4Process(runtime, instance, gains))
            return started[-1], instance.system_id

        try:
            yield make
        finally:
            for process in started:
                process.close()


class Landing(msgspec.Struct, frozen=True):
    """Of a flight that ended by itself; infinite when it did not.

    Attributes:
        impact_mps: downwards, just before the first contact.
        tilt_max_deg: from then on.
        off_s: from then until the autopilot has disarmed.
        whole_s: from the order, or the loss, until the autopilot has disarmed.
    """

    impact_mps: float
    tilt_max_deg: float
    off_s: float
    whole_s: float


def _landing(flight: Flight, from_s: float) -> Landing:
    """What the truth says of a landing; armed on the ground the motors idle, disarmed they stand still."""
    descent = [t for t in flight.truth if t.t_ns > from_s * 1e9]
    touched = next((i for i, t in enumerate(descent) if t.contact_force_n > 0.0), None)
    off_s = max((t.t_ns * 1e-9 for t in descent if t.armed_motors), default=inf)
    if touched is None or descent[-1].armed_motors:
        return Landing(inf, inf, inf, inf)
    return Landing(
        descent[touched - 1].vel_uav_ned_mps[2],
        max(degrees(tilt_from_quat(t.q_ned_from_frd)) for t in descent[touched:]),
        off_s - descent[touched].t_ns * 1e-9,
        off_s - from_s,
    )


def land(seed: int, autopilot: Make) -> Landing:
    """Descend at 0.5 m/s by velocity setpoints until the autopilot switches its motors off by itself."""

    def target(t_s: float) -> Target:
        return ((0.0, 0.0, -HEIGHT_M), None) if t_s < DOWN_S else (None, (0.0, 0.0, DOWN_MPS))

    return _landing(fly(target, seed, DOWN_S + HEIGHT_M / DOWN_MPS + 10.0, autopilot=autopilot), DOWN_S)


def lose_offboard(seed: int, autopilot: Make) -> Landing:
    """Stop the stream of setpoints 5 m up."""

    def target(t_s: float) -> Target:
        return ((0.0, 0.0, -HEIGHT_M) if t_s < DOWN_S else None), None

    return _landing(fly(target, seed, DOWN_S + 25.0, autopilot=autopilot), DOWN_S)


Figures = dict[str, float]


def figures(seed: int, autopilot: Callable[[], AbstractContextManager[Make]]) -> Figures:
    """All of one autopilot and seed, by what they are."""
    with autopilot() as make:
        held = hold(seed, autopilot=make)
    with autopilot() as make:
        tracked = track(seed, autopilot=make)
    with autopilot() as make:
        landed = land(seed, make)
    with autopilot() as make:
        lost = lose_offboard(seed, make)
    return {
        "hold, p95 over 60 s (m)": held.p95_m,
        "hold, vertical RMS (m)": held.rms_vertical_m,
        "estimate off the truth, at most (m)": held.wander_max_m,
        "velocity tracking, RMS (m/s)": tracked.rms_mps,
        "2 m/s step, 90 % rise (s)": tracked.rise_s,
        "2 m/s step, overshoot (%)": 100.0 * tracked.overshoot,
        "landing at 0.5 m/s: impact (m/s)": landed.impact_mps,
        "landing: tilt after contact, at most (deg)": landed.tilt_max_deg,
        "landing: contact to disarmed (s)": landed.off_s,
        "offboard lost 5 m up: impact (m/s)": lost.impact_mps,
        "offboard lost: tilt after contact, at most (deg)": lost.tilt_max_deg,
        "offboard lost: until landed and disarmed (s)": lost.whole_s,
    }


def embedded_gains() -> dict[str, float]:
    """Those of the embedded autopilot's velocity loop, under PX4's names."""
    control = load_config(AutopilotConfig, "autopilot").control
    return {
        "MPC_XY_VEL_P_ACC": control.mpc_xy_vel_p_acc,
        "MPC_XY_VEL_I_ACC": control.mpc_xy_vel_i_acc,
        "MPC_XY_VEL_D_ACC": control.mpc_xy_vel_d_acc,
    }


def main() -> None:
    """Print a table: median and largest of the seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    seeds = range(parser.parse_args().seeds)
    runtime = Path(os.environ["JEZERO_PX4_DIR"])
    flown = []
    with redirect_stdout(sys.stderr):
        for autopilot in (
            lambda: real_px4(runtime, {}),
            lambda: real_px4(runtime, embedded_gains()),
            lambda: nullcontext(embedded),
        ):
            flown.append([figures(seed, autopilot) for seed in seeds])
    print(f"| median (largest) of {len(seeds)} seeds | PX4 | PX4 with the gains of | embedded |\n|---|---|---|---|")
    for what in flown[0][0]:
        cells = ([flight[what] for flight in flights] for flights in flown)
        print(f"| {what} | {' | '.join(f'{median(values):.2f} ({max(values):.2f})' for values in cells)} |")


if __name__ == "__main__":
    main()
