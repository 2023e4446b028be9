"""Inputs of the estimator in an approach to the rover, without physics: a given path, and the sensors' own models.

The autopilot's errors are those that its filter shows in flight: a velocity error that wanders, a position that drifts,
and an attitude that is tilted and turned by a constant part and a small wandering one. Hundreds of such flights take
minutes, and each error is known.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import cos, hypot, pi, radians, sin, tan
from typing import Any

import numpy as np

from jezero.base.frames import (
    Quat,
    Vec3,
    add,
    norm,
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    rotate_yaw,
    scale,
    subtract,
    wrap_pi,
    yaw_from_quat,
)
from jezero.base.vehicle_config import GRAVITY_EARTH_MPS2, VehicleConfig
from jezero.schemas import topics
from jezero.schemas.estimate import TagEstimate
from jezero.schemas.rows import Topic
from jezero.schemas.state import Clock, Odometry
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.body import BodyState, RoverState
from jezero.services.simulator.config import SimulatorConfig, UwbConfig
from jezero.services.simulator.noise import Wander, generator, normals_of
from jezero.services.simulator.sensors import AltimeterModel, RoverOdometryModel, UwbModel

TICK_NS = 4_000_000
HEIGHT_STAND_M = VehicleConfig().airframe.height_stand_m
APPROACH_S = 6.0
APPROACH_HEIGHT_M = 2.5
DESCENT_MPS = 0.5
END_HEIGHT_M = 0.25
SWAY_M, SWAY_HZ = 0.08, 0.35
WIND_TILT_RAD = radians(6.0)
TAG_SEEN_M = (0.2, 10.0)
TAG_RANGES_M = (0.3, 1.0, 2.0, 4.0, 8.0, 10.0)
TAG_STDS_M = (0.002, 0.002, 0.004, 0.007, 0.016, 0.026)
"""Standard deviations along the line of sight; across it they are half. Measured on rendered pictures."""
HALF_WIDTH, HALF_HEIGHT = tan(radians(40.0)), 0.75 * tan(radians(40.0))
STD_TAG_YAW_RAD = 0.01
Arrival = tuple[int, Topic[Any], Any]
"""Time of arrival, topic and message."""


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Conditions of a flight.

    Attributes:
        uwb_std_m: standard deviation of a UWB range.
        uwb_blocked: fraction of UWB ranges without line of sight.
        latency_s: time from exposure to the tag's estimate.
        hidden_s: (from, to) before the end, in which the tag is hidden.
        speed_mps: speed of the rover.
        yaw_rate_rps: yaw rate of the rover.
    """

    uwb_std_m: float = 0.01
    uwb_blocked: float = 0.0
    latency_s: float = 0.1
    hidden_s: tuple[tuple[float, float], ...] = ()
    speed_mps: float = 0.0
    yaw_rate_rps: float = 0.0


@dataclass(frozen=True)
class TrueState:
    """Positions of the vehicle as in `schemas.state.Truth`."""

    pos_uav_m: Vec3
    vel_uav_mps: Vec3
    q_ned_from_frd: Quat
    rover: RoverState

    @property
    def pos_rel_m(self) -> Vec3:
        return subtract(self.pos_uav_m, self.rover.pos_ned_m)

    @property
    def vel_rel_mps(self) -> Vec3:
        return subtract(self.vel_uav_mps, self.rover.vel_ned_mps)


class EstimatorFlight:
    """The flight of one seed: hover, approach, descent.

    Attributes:
        end_s: time of its end.
        conditions: its conditions.
    """

    def __init__(self, seed: int, conditions: Conditions) -> None:
        self.conditions = conditions
        self._rng = rng = generator(seed, "flight")
        self._hover_s = 3.0
        self._height_m = float(rng.uniform(4.0, 8.0))
        away_m, bearing_rad = float(rng.uniform(1.0, 8.0)), float(rng.uniform(-pi, pi))
        self._start_m = (away_m * cos(bearing_rad), away_m * sin(bearing_rad))
        self._yaw_uav_rad = float(rng.uniform(-pi, pi))
        self._yaw_start_rad = float(rng.uniform(-pi, pi))
        self._wind_rad = float(rng.uniform(-pi, pi))
        self._pos_rover_m: Vec3 = (float(rng.uniform(-5, 5)), float(rng.uniform(-5, 5)), -0.5)
        self.end_s = self._hover_s + APPROACH_S + (APPROACH_HEIGHT_M - END_HEIGHT_M) / DESCENT_MPS
        self._seed = seed

    def truth(self, t_s: float) -> TrueState:
        """True state at one time."""
        rover = self._rover(t_s)
        step_s = 0.01
        before, now, after = (self._pos_uav(t_s + i * step_s) for i in (-1, 0, 1))
        vel_mps = scale(subtract(after, before), 0.5 / step_s)
        acc_mps2 = scale(subtract(add(after, before), scale(now, 2.0)), 1.0 / step_s**2)
        push = WIND_TILT_RAD * GRAVITY_EARTH_MPS2
        lean = rotate_yaw(
            (acc_mps2[0] + push * cos(self._wind_rad), acc_mps2[1] + push * sin(self._wind_rad), 0.0),
            -self._yaw_uav_rad,
        )
        q = quat_from_euler(lean[1] / GRAVITY_EARTH_MPS2, -lean[0] / GRAVITY_EARTH_MPS2, self._yaw_uav_rad)
        return TrueState(now, vel_mps, q, rover)

    def arrivals(self) -> Iterator[Arrival]:
        """Messages of all topics in the order of their arrival."""
        clock = ((t_ns, topics.CLOCK, Clock(t_ns=t_ns, epoch_id=1, wall_ns=t_ns)) for t_ns in self._times(10.0, 0))
        arrivals = [*clock, *self._odometry(), *self._sensors(), *self._tags()]
        yield from sorted(arrivals, key=lambda arrival: arrival[0])

    # -- the path ------------------------------------------------------------------------------------------

    def _rover(self, t_s: float) -> RoverState:
        """State of the rover, on an arc or a straight line."""
        speed, rate = self.conditions.speed_mps, self.conditions.yaw_rate_rps
        yaw_rad = self._yaw_start_rad + rate * t_s
        x, y, z = self._pos_rover_m
        if rate:
            radius_m = speed / rate
            x += radius_m * (sin(yaw_rad) - sin(self._yaw_start_rad))
            y += radius_m * (cos(self._yaw_start_rad) - cos(yaw_rad))
        else:
            x, y = x + speed * t_s * cos(yaw_rad), y + speed * t_s * sin(yaw_rad)
        vel_mps = (speed * cos(yaw_rad), speed * sin(yaw_rad), 0.0)
        attitude, rates_rps = quat_from_euler(0.0, 0.0, yaw_rad), (0.0, 0.0, rate)
        return RoverState((x, y, z), vel_mps, attitude, rates_rps, wrap_pi(yaw_rad), speed, rate)

    def _pos_uav(self, t_s: float) -> Vec3:
        share = min(max((t_s - self._hover_s) / APPROACH_S, 0.0), 1.0)
        share = share**3 * (10.0 - 15.0 * share + 6.0 * share * share)
        height_m = self._height_m + share * (APPROACH_HEIGHT_M - self._height_m)
        late_s = max(t_s - self._hover_s - APPROACH_S, 0.0)
        height_m -= DESCENT_MPS * late_s * min(1.0, late_s)
        sway_m = SWAY_M * min(1.0, height_m)
        north_m = (1.0 - share) * self._start_m[0] + sway_m * sin(2.0 * pi * SWAY_HZ * t_s)
        east_m = (1.0 - share) * self._start_m[1] + sway_m * cos(2.0 * pi * 0.8 * SWAY_HZ * t_s)
        return add(self._rover(t_s).pos_ned_m, (north_m, east_m, -height_m))

    # -- sensors -------------------------------------------------------------------------------------------

    def _times(self, rate_hz: float, phase_ns: int) -> range:
        return range(phase_ns, int(self.end_s * NS_PER_S), int(NS_PER_S / rate_hz))

    def _attitude_errors(self) -> Callable[[int], Quat]:
        """Rotation from the true attitude to the estimated one at multiples of 20 ms."""
        normals = normals_of(generator(self._seed, "attitude"))
        tilt, heading = radians(0.6), radians(1.2)
        constant = (tilt * normals(), tilt * normals(), heading * normals())
        wander = [Wander(radians(std), 5.0, 0.02, normals) for std in (0.1, 0.1, 0.25)]
        errors: list[Quat] = []

        def at(index: int) -> Quat:
            while len(errors) <= index:
                x, y, z = (c + w.step() for c, w in zip(constant, wander, strict=True))
                errors.append(quat_from_rotation_vector(rotate_yaw((x, y, z), self._yaw_uav_rad)))
            return errors[index]

        return at

    def _odometry(self) -> Iterator[Arrival]:
        normals = normals_of(generator(self._seed, "autopilot"))
        vel_error = [Wander(0.018, 2.0, 0.02, normals) for _ in range(3)]
        pos_error = [Wander(0.3, 60.0, 0.02, normals) for _ in range(3)]
        self._attitude_error = self._attitude_errors()
        for i, t_ns in enumerate(self._times(50.0, 0)):
            now, soon = self.truth(t_ns / NS_PER_S), self.truth(t_ns / NS_PER_S + 0.01)
            turn = quat_multiply(quat_conjugate(now.q_ned_from_frd), soon.q_ned_from_frd)
            yield (
                t_ns + 1_000_000,
                topics.ODOMETRY,
                Odometry(
                    t_ns=t_ns,
                    epoch_id=1,
                    pos_uav_ned_m=_shaken(now.pos_uav_m, pos_error),
                    vel_uav_ned_mps=_shaken(now.vel_uav_mps, vel_error),
                    q_ned_from_frd=quat_normalize(quat_multiply(self._attitude_error(i), now.q_ned_from_frd)),
                    rates_uav_frd_rps=(200.0 * turn[1], 200.0 * turn[2], 200.0 * turn[3]),
                ),
            )

    def _sensors(self) -> Iterator[Arrival]:
        shipped, vehicle = SimulatorConfig(), VehicleConfig()
        c = self.conditions
        settings = UwbConfig(std_m=c.uwb_std_m, share_blocked=c.uwb_blocked)
        uwb = UwbModel(settings, vehicle.uwb, self._seed)
        for t_ns in self._times(settings.rate_hz, 12_000_000):
            body, state = self._body(t_ns)
            yield t_ns + int(settings.delay_s * NS_PER_S), topics.UWB, uwb.measure(t_ns, body, state.rover)
        altimeter = AltimeterModel(shipped.altimeter, vehicle.altimeter, self._seed)
        for t_ns in self._times(shipped.altimeter.rate_hz, TICK_NS):
            reading = altimeter.measure(t_ns, self._beam_m(t_ns, vehicle.altimeter.pos_altimeter_frd_m))
            yield t_ns + int(shipped.altimeter.delay_s * NS_PER_S), topics.ALTIMETER, reading
        odometry = RoverOdometryModel(shipped.rover_odometry, self._seed)
        for t_ns in self._times(shipped.rover_odometry.rate_hz, 16_000_000):
            message = odometry.measure(t_ns, self._rover(t_ns / NS_PER_S))
            yield t_ns + int(shipped.rover_odometry.delay_s * NS_PER_S), topics.ROVER_ODOMETRY, message

    def _body(self, t_ns: int) -> tuple[BodyState, TrueState]:
        state = self.truth(t_ns / NS_PER_S)
        center_m = add(state.pos_uav_m, (0.0, 0.0, -HEIGHT_STAND_M))
        zero = (0.0, 0.0, 0.0)
        return BodyState(center_m, state.vel_uav_mps, state.q_ned_from_frd, zero, zero), state

    def _beam_m(self, t_ns: int, mount_frd_m: Vec3) -> float:
        """True range of the laser: to the platform, or past its edge to level ground."""
        body, state = self._body(t_ns)
        beam = quat_rotate(body.q_ned_from_frd, (0.0, 0.0, 1.0))
        laser_m = add(subtract(body.pos_ned_m, state.rover.pos_ned_m), quat_rotate(body.q_ned_from_frd, mount_frd_m))
        range_m = -laser_m[2] / beam[2]
        foot_m = rotate_yaw(add(laser_m, scale(beam, range_m)), -state.rover.yaw_rad)
        return range_m if max(abs(foot_m[0]), abs(foot_m[1])) < 0.5 else range_m + 0.5 / beam[2]

    def _tags(self) -> Iterator[Arrival]:
        rng = generator(self._seed, "tags")
        for t_ns in self._times(15.0, int(rng.uniform(0.0, 6e7))):
            left_s = self.end_s - t_ns / NS_PER_S
            if not any(start <= left_s < end for start, end in self.conditions.hidden_s):
                tag = self._tag(t_ns, rng)
                if tag is not None:
                    yield t_ns + int(self.conditions.latency_s * NS_PER_S), topics.ESTIMATE_TAG, tag

    def _tag(self, t_ns: int, rng: np.random.Generator) -> TagEstimate | None:
        """Position of the tag in the true body axes, rotated by the estimated attitude."""
        body, state = self._body(t_ns)
        arm_m = subtract(body.pos_ned_m, state.rover.pos_ned_m)
        seen_frd_m = quat_rotate(quat_conjugate(body.q_ned_from_frd), scale(arm_m, -1.0))
        range_m, (ahead, right, down) = norm(arm_m), seen_frd_m
        half_m = 0.3 if range_m > 0.8 else 0.04
        outside = abs(right) + half_m > HALF_WIDTH * down or abs(ahead) + half_m > HALF_HEIGHT * down
        if outside or not TAG_SEEN_M[0] < range_m < TAG_SEEN_M[1]:
            return None
        q_error = self._attitude_error(t_ns // 20_000_000)
        q = quat_normalize(quat_multiply(q_error, body.q_ned_from_frd))
        std_m = float(np.interp(range_m, TAG_RANGES_M, TAG_STDS_M))
        along = np.array(scale(seen_frd_m, 1.0 / range_m))
        error_m = std_m * rng.standard_normal() * along + 0.5 * std_m * rng.standard_normal(3)
        x, y, z = (error_m - np.array(seen_frd_m)).tolist()
        sight = np.array(quat_rotate(q, (float(along[0]), float(along[1]), float(along[2]))))
        cov = std_m**2 * (0.25 * np.eye(3) + np.outer(sight, sight))
        yaw_rad = state.rover.yaw_rad + yaw_from_quat(q) - yaw_from_quat(body.q_ned_from_frd)
        return TagEstimate(
            t_ns=t_ns,
            tag_ids=(0,),
            pos_uav_rel_rover_ned_m=quat_rotate(q, (x, y, z)),
            cov_pos_ned_m2=tuple(cov[np.triu_indices(3)].tolist()),
            range_m=hypot(*arm_m),
            yaw_rover_rad=wrap_pi(yaw_rad + STD_TAG_YAW_RAD * float(rng.standard_normal())),
            std_yaw_rover_rad=STD_TAG_YAW_RAD,
            reprojection_px=0.2,
        )


def _shaken(v: Vec3, errors: list[Wander]) -> Vec3:
    x, y, z = (value + error.step() for value, error in zip(v, errors, strict=True))
    return (x, y, z)
