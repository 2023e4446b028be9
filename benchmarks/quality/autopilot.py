"""Flight quality of the embedded autopilot, in virtual time, in 3 m/s mean wind with gusts of 0.6 m/s.

`python -m benchmarks.quality.autopilot [--seeds N]` prints hold accuracy, velocity tracking, the rise of a velocity
step, and the largest distance between the autopilot's estimate and the truth.
"""

import argparse
from collections.abc import Callable, Iterator
from math import sqrt

import msgspec

from jezero.base.config import load_config
from jezero.base.frames import Vec3, distance, norm, subtract
from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import UDP_DELAY, MemoryBus
from jezero.runtime.service import Inbox, Output, Send, Service, Spec
from jezero.schemas import topics
from jezero.schemas.state import Truth
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.service import Autopilot
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.service import Simulator
from jezero.trials.stack import SYSTEM_ID, boot_id

WIND_MPS = 3.0
GUST_MPS = 0.6
READY_S = 8.0
CLIMB_S = 12.0
HEIGHT_M = 5.0
TURN_RPS = 0.2
"""Largest yaw rate of the rover."""
Target = tuple[Vec3 | None, Vec3 | None]
"""Position and velocity setpoint in NED."""
Make = Callable[[], tuple[Service, int]]
"""Function that makes an autopilot; returns it with its MAVLink system id."""


class Sample(msgspec.Struct, frozen=True):
    """The autopilot's own estimate at one instant, in NED."""

    t_s: float
    pos_ned_m: Vec3
    vel_ned_mps: Vec3


class Pilot:
    """Streams setpoints at 50 Hz, engages offboard mode, arms, and records the odometry.

    Args:
        target: setpoint at a vehicle time; while it has neither position nor velocity, nothing is streamed.
        system_id: MAVLink system id of the autopilot.

    Attributes:
        samples: odometry so far.
        resets: (vehicle time, reset counter) of each odometry.
    """

    spec = Spec(name="pilot", links=("autopilot",), triggers=("autopilot",), rate_hz=50)

    def __init__(self, target: Callable[[float], Target], system_id: int) -> None:
        self._target = target
        self._system_id = system_id
        self._codec = MavlinkCodec(system_id, dialect.MAV_COMP_ID_ONBOARD_COMPUTER)
        self._sent_ns = 0
        self._ordered_ns = 0
        self.samples: list[Sample] = []
        self.resets: list[tuple[float, int]] = []

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for message in self._codec.parse(inbox.received("autopilot")):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_ODOMETRY:
                t_s = message.time_usec * 1e-6
                self.samples.append(
                    Sample(t_s, (message.x, message.y, message.z), (message.vx, message.vy, message.vz))
                )
                self.resets.append((t_s, message.reset_counter))
        pos_ned_m, vel_ned_mps = self._target(t_ns * 1e-9)
        if t_ns - self._sent_ns >= 20_000_000 and (pos_ned_m or vel_ned_mps):
            self._sent_ns = t_ns
            yield Send("autopilot", self._setpoint(pos_ned_m, vel_ned_mps))
        if READY_S * 1e9 < t_ns < (READY_S + 3.0) * 1e9 and t_ns - self._ordered_ns > 500_000_000:
            self._ordered_ns = t_ns
            interval = dialect.MAV_CMD_SET_MESSAGE_INTERVAL
            yield Send("autopilot", self._command(interval, dialect.MAVLINK_MSG_ID_ODOMETRY, 20_000.0))
            yield Send("autopilot", self._command(dialect.MAV_CMD_DO_SET_MODE, 1.0, 6.0))
            yield Send("autopilot", self._command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0))

    def _setpoint(self, pos: Vec3 | None, vel: Vec3 | None) -> bytes:
        mask = 0b1001_1100_0000 | (0 if pos else 7) | (0 if vel else 56)
        none: Vec3 = (0.0, 0.0, 0.0)
        return self._codec.pack(
            dialect.MAVLink_set_position_target_local_ned_message(
                0, self._system_id, 1, 1, mask, *(pos or none), *(vel or none), *none, 0.0, 0.0
            )
        )

    def _command(self, command: int, first: float, second: float) -> bytes:
        return self._codec.pack(
            dialect.MAVLink_command_long_message(self._system_id, 1, command, 0, first, second, 0, 0, 0, 0, 0)
        )


class Flight(msgspec.Struct, frozen=True):
    """Records of one flight.

    Attributes:
        samples: odometry of the autopilot.
        resets: (vehicle time, reset counter) of each odometry.
        truth: truth of the simulator.
    """

    samples: list[Sample]
    resets: list[tuple[float, int]]
    truth: list[Truth]


def embedded() -> tuple[Service, int]:
    """The embedded autopilot and its system id."""
    config, vehicle = load_config(AutopilotConfig, "autopilot"), load_config(VehicleConfig, "vehicle")
    return Autopilot(config, vehicle, SYSTEM_ID), SYSTEM_ID


def fly(
    target: Callable[[float], Target],
    seed: int,
    until_s: float,
    config: SimulatorConfig | None = None,
    autopilot: Make = embedded,
) -> Flight:
    """Fly a target over vehicle time; the vehicle takes off by itself when the target is above it."""
    config = config or windy()
    bus = MemoryBus(seed)
    service, system_id = autopilot()
    pilot = Pilot(target, system_id)
    truth: list[Truth] = []
    decoder = msgspec.json.Decoder(Truth)
    bus.observe(lambda _t, topic, data: truth.append(decoder.decode(data)) if topic == topics.TRUTH.name else None)
    bus.wire(("simulator", "hil"), ("autopilot", "hil"))
    bus.wire(("autopilot", "offboard"), ("pilot", "autopilot"), UDP_DELAY)
    simulator = Simulator(config, load_config(VehicleConfig, "vehicle"), seed, boot_id(seed, "simulator"))
    bus.add(simulator)
    bus.add(service)
    bus.add(pilot)
    bus.run_until(int(until_s * 1e9))
    simulator.close()
    return Flight(pilot.samples, pilot.resets, truth)


def windy(mean_mps: float = WIND_MPS, gust_mps: float = GUST_MPS) -> SimulatorConfig:
    """The shipped settings with other wind."""
    config = load_config(SimulatorConfig, "simulator")
    wind = msgspec.structs.replace(config.wind, mean_mps=mean_mps, std_gust_mps=gust_mps)
    return msgspec.structs.replace(config, wind=wind)


class Hold(msgspec.Struct, frozen=True):
    """Errors of a held position: distances from the setpoint, by the vehicle's own estimate."""

    p95_m: float
    rms_m: float
    rms_vertical_m: float
    wander_max_m: float


def hold(seed: int, span_s: float = 60.0, autopilot: Make = embedded) -> Hold:
    """Hover at 5 m for `span_s`.

    `wander_max_m` is the largest distance between estimate and truth over the span.
    """
    point: Vec3 = (0.0, 0.0, -HEIGHT_M)
    start_s = READY_S + CLIMB_S
    flight = fly(lambda t: (point, None), seed, start_s + span_s, autopilot=autopilot)
    samples = [s for s in flight.samples if s.t_s >= start_s]
    errors = sorted(distance(s.pos_ned_m, point) for s in samples)
    vertical = [s.pos_ned_m[2] - point[2] for s in samples]
    return Hold(errors[int(0.95 * len(errors))], _rms(errors), _rms(vertical), max(_wander(flight, start_s)))


class Tracking(msgspec.Struct, frozen=True):
    """Tracking of velocity setpoints: RMS error in steady flight, rise time and overshoot of a 2 m/s step."""

    rms_mps: float
    rise_s: float
    overshoot: float


def track(seed: int, autopilot: Make = embedded) -> Tracking:
    """Fly a 2 m/s step north for 6 s, then 2 m/s once around a circle for 32 s.

    The RMS leaves out the first 1.5 s after the step.
    """
    start_s = READY_S + CLIMB_S
    turn_s = start_s + 6.0

    def target(t_s: float) -> Target:
        from math import cos, sin

        if t_s < start_s:
            return (0.0, 0.0, -HEIGHT_M), None
        phase = TURN_RPS * max(0.0, t_s - turn_s)
        return None, (2.0 * cos(phase), 2.0 * sin(phase), 0.0)

    flight = fly(target, seed, turn_s + 32.0, autopilot=autopilot)
    step = [s for s in flight.samples if start_s <= s.t_s < turn_s]
    rise_s = next(s.t_s for s in step if s.vel_ned_mps[0] >= 1.8) - start_s
    steady = [s for s in flight.samples if s.t_s >= start_s + 1.5]
    errors = [norm(subtract(s.vel_ned_mps, target(s.t_s)[1] or (0.0, 0.0, 0.0))) for s in steady]
    return Tracking(_rms(errors), rise_s, max(s.vel_ned_mps[0] for s in step) / 2.0 - 1.0)


def jump(seed: int) -> float:
    """Overshoot in m of a position setpoint that jumps by 8 m."""
    start_s = READY_S + CLIMB_S
    ahead: Vec3 = (8.0, 0.0, -HEIGHT_M)
    flight = fly(lambda t: ((0.0, 0.0, -HEIGHT_M) if t < start_s else ahead, None), seed, start_s + 12.0)
    return max(s.pos_ned_m[0] - ahead[0] for s in flight.samples)


def _wander(flight: Flight, start_s: float) -> Iterator[float]:
    truth = {round(t.t_ns * 1e-9, 2): t.pos_uav_ned_m for t in flight.truth}
    for sample in flight.samples:
        true = truth.get(round(sample.t_s, 2))
        if true is not None and sample.t_s >= start_s:
            yield distance(sample.pos_ned_m, true)


def _rms(values: list[float]) -> float:
    return sqrt(sum(v * v for v in values) / len(values))


def main() -> None:
    """Print the figures of some seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    for seed in range(parser.parse_args().seeds):
        h, v = hold(seed), track(seed)
        print(
            f"seed {seed}: hold p95 {h.p95_m:.3f} m, rms {h.rms_m:.3f}, vertical {h.rms_vertical_m:.3f}, "
            f"estimate off by up to {h.wander_max_m:.2f} m; velocity rms {v.rms_mps:.3f} m/s, "
            f"rise {v.rise_s:.2f} s, overshoot {100 * v.overshoot:.1f} %; 8 m jump overshoots {jump(seed):.2f} m"
        )


if __name__ == "__main__":
    main()
