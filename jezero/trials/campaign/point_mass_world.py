"""The point-mass world: one service, cheap to run, in place of simulator and autopilot.

It is the master of vehicle time, publishes the sensors and the truth, and exchanges MAVLink with the bridge. Arming,
modes, failsafes, land detector, commands, parameters and telemetry are the embedded autopilot's own code.
"""

from collections.abc import Callable, Iterable, Iterator
from math import cos
from random import Random
from typing import Any

from jezero.frames import Vec3, altitude_m, geodetic_from_ned, rotate_yaw, z_ned_m
from jezero.runtime.service import Health, Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Clock, Truth
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.hil import SensorSample
from jezero.services.autopilot.mavlink_interface import MavlinkInterface
from jezero.services.autopilot.parameters import Parameters
from jezero.services.autopilot.telemetry import OFFBOARD
from jezero.services.autopilot.vehicle import Vehicle
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.schedule import Schedule
from jezero.trials.campaign.point_mass import NO_RATES, Point, PointEstimate, PointPilot
from jezero.vehicle_config import VehicleConfig

NAME = "point_mass"
STEPS_PER_S = 20.0
STEP_MAX_S = 0.2
SENSORS_HZ = 5.0
"""Rate of GNSS, barometer and magnetometer, which only the point mass' own estimate reads."""
ALTIMETER_HZ = 10.0
TRUTH_HZ = 5.0
STD_BARO_M = 0.1
EPOCH_LIMIT = 2**53
SensorFilter = Callable[[str, int, Any], Iterable[Any]]
"""Returns, from (sensor, t_ns, reading), the readings that arrive instead."""

SPEC = Spec(
    name=NAME,
    outputs=(topics.CLOCK, topics.ALTIMETER, topics.TRUTH),
    links=(OFFBOARD,),
    rate_hz=STEPS_PER_S,
)


class PointMass:
    """World, vehicle and autopilot in one service.

    Args:
        config: settings of the autopilot.
        robot: the vehicle: height of the platform, mass, battery, range of the altimeter.
        world: settings of the simulator: origin, gravity and the errors of the sensors.
        system_id: MAVLink system id.
        seed: seed of the sensors' errors.
        boot_id: id of this run, from which the epoch id follows.

    Attributes:
        sensor_filter: applies sensor faults to each reading; None, the default, changes nothing.
    """

    spec = SPEC

    def __init__(
        self,
        config: AutopilotConfig,
        world: SimulatorConfig,
        robot: VehicleConfig,
        system_id: int,
        seed: int,
        boot_id: int,
    ) -> None:
        self.sensor_filter: SensorFilter | None = None
        self._world = world
        self._robot = robot
        self._epoch_id = boot_id % EPOCH_LIMIT
        self._rng = Random(f"{seed}/{boot_id}")
        self._parameters = Parameters(config, robot.battery, system_id)
        self._point = Point(world.gravity_mps2)
        self._estimate = PointEstimate(config.estimator, self._point, world.origin.origin_deg)
        self._pilot = PointPilot(config, self._point, self._estimate)
        self._vehicle = Vehicle(self._parameters, system_id, self._estimate, self._pilot)
        self._side = MavlinkInterface(self._vehicle, self._parameters, system_id, (OFFBOARD,), {})
        self._t_ns: int | None = None
        self._health: Health | None = None
        self._when_clock = Schedule[None](topics.CLOCK.rate_hz or 10.0)
        self._when_sensors = Schedule[None](SENSORS_HZ)
        self._when_altimeter = Schedule[None](ALTIMETER_HZ)
        self._when_truth = Schedule[None](TRUTH_HZ)

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Advance the point to `t_ns`, handle requests and MAVLink, and control the point anew."""
        if self._when_clock.due(t_ns):
            yield Publish(topics.CLOCK, Clock(t_ns=t_ns, epoch_id=self._epoch_id, wall_ns=inbox.wall_ns))
        dt = 0.0 if self._t_ns is None else min(STEP_MAX_S, (t_ns - self._t_ns) * 1e-9)
        self._t_ns = t_ns
        self._point.step(dt, self._pilot.wanted_ned_mps2, self._pilot.yaw_rate_rps)
        self._estimate.tick(t_ns // 1000)
        yield from self._side.handle_messages(inbox)
        self._vehicle.step(self._read(t_ns))
        yield from self._side.send_telemetry(inbox)
        if self._when_altimeter.due(t_ns):
            yield from (
                Publish(topics.ALTIMETER, reading) for reading in self._filtered("altimeter", t_ns, self._range(t_ns))
            )
        if self._when_truth.due(t_ns):
            yield Publish(topics.TRUTH, self._truth(t_ns))
        health = Health("ok", f"{self._side.malformed} malformed messages")
        if health != self._health:
            self._health = health
            yield health

    def _read(self, t_ns: int) -> SensorSample:
        """Readings of the autopilot's sensors. There is no IMU: the estimate knows the point's motion."""
        field_frd_gauss = pressure_altitude_m = None
        if self._when_sensors.due(t_ns):
            for fix in self._filtered("gnss", t_ns, self._fix()):
                self._vehicle.on_fix(fix)
            field_frd_gauss = _last(self._filtered("mag", t_ns, self._field_frd_gauss()))
            up_m = altitude_m(self._point.pos_ned_m[2]) + self._rng.gauss(0.0, STD_BARO_M)
            pressure_altitude_m = _last(self._filtered("baro", t_ns, up_m))
        return SensorSample(t_ns // 1000, None, field_frd_gauss, pressure_altitude_m)

    def _filtered(self, sensor: str, t_ns: int, reading: Any) -> Iterable[Any]:
        return (reading,) if self.sensor_filter is None else self.sensor_filter(sensor, t_ns, reading)

    def _fix(self) -> Fix:
        config, gauss, (north_m, east_m, down_m) = self._world.gnss, self._rng.gauss, self._point.pos_ned_m
        north_m, east_m = north_m + gauss(0.0, config.std_horizontal_m), east_m + gauss(0.0, config.std_horizontal_m)
        position_deg = geodetic_from_ned((north_m, east_m, down_m), self._world.origin.origin_deg)
        return Fix(0, position_deg, self._point.vel_ned_mps, True, config.satellites)

    def _field_frd_gauss(self) -> Vec3:
        """(3,) magnetic field at the origin as a level vehicle measures it, FRD."""
        x, y, z = rotate_yaw(self._world.origin.field_ned_gauss, -self._point.yaw_rad)
        return (x + self._rng.gauss(0.0, self._world.magnetometer.std_gauss), y, z)

    def _range(self, t_ns: int) -> Altimeter:
        """Range along the body's down axis to the level ground."""
        std_m, mount, point = self._world.altimeter.std_m, self._robot.altimeter, self._point
        range_m = altitude_m(point.pos_ned_m[2]) / cos(point.tilt_rad) + std_m * self._rng.gauss(0.0, 1.0)
        within = mount.range_min_m <= range_m <= mount.range_max_m
        return Altimeter(t_ns=t_ns, range_m=range_m if within else None)

    def _truth(self, t_ns: int) -> Truth:
        point, rover = self._point, self._world.rover
        return Truth(
            t_ns=t_ns,
            epoch_id=self._epoch_id,
            pos_uav_ned_m=point.pos_ned_m,
            vel_uav_ned_mps=point.vel_ned_mps,
            q_ned_from_frd=point.attitude(point.yaw_rad),
            rates_uav_frd_rps=NO_RATES,
            pos_rover_ned_m=(rover.start_north_m, rover.start_east_m, z_ned_m(self._robot.platform.height_m)),
            vel_rover_ned_mps=(0.0, 0.0, 0.0),
            yaw_rover_rad=rover.start_yaw_rad,
            wind_ned_mps=(0.0, 0.0, 0.0),
            contact_force_n=self._robot.airframe.mass_kg * self._world.gravity_mps2 if point.stands else 0.0,
            armed_motors=self._vehicle.commander.armed,
        )


def _last(readings: Iterable[Any]) -> Any:
    """The last reading, or None without any."""
    return next(iter(reversed([*readings])), None)
