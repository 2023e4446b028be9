"""The point mass: one service, cheap to run, in place of simulator and autopilot.

The vehicle is one point mass, with a simple estimate and controller, which replace rigid body, estimator, attitude
control and mixer. Arming, modes, failsafes, land detector, commands, parameters and telemetry are the embedded
autopilot's own code. The service is the master of vehicle time, publishes the sensors and the truth, and exchanges
MAVLink with the bridge.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from math import atan2, cos, hypot, sin, sqrt
from random import Random
from typing import Any

from jezero.base.frames import (
    Quat,
    Vec3,
    add,
    altitude_m,
    geodetic_from_ned,
    ned_from_geodetic,
    quat_from_euler,
    rotate_yaw,
    subtract,
    wrap_pi,
    z_ned_m,
)
from jezero.base.vehicle_config import PlanetConfig, VehicleConfig
from jezero.runtime.service import Health, Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Clock, Truth
from jezero.services.autopilot.alignment import ALIGN_US, Fix
from jezero.services.autopilot.config import AutopilotConfig, StateEstimatorConfig
from jezero.services.autopilot.control import ControlSetpoint, Kinematics, VelocityLoop
from jezero.services.autopilot.hil import SensorSample
from jezero.services.autopilot.land_detector import CLIMB_SETPOINT_MIN_MPS, LandDetector
from jezero.services.autopilot.mavlink_interface import MavlinkInterface
from jezero.services.autopilot.mixer import IDLE, STOPPED, Commands
from jezero.services.autopilot.multicopter import LIFTOFF_SPEED_MIN_MPS, SPOOLUP_TIME_S
from jezero.services.autopilot.parameters import Parameters
from jezero.services.autopilot.reset_detector import ResetDetector
from jezero.services.autopilot.telemetry import OFFBOARD
from jezero.services.autopilot.vehicle import AutopilotVehicle
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.schedule import Schedule
from jezero.trials.campaign.faults import AUTOPILOT, HIL, MAVLINK, SENSOR_KINDS, SIMULATOR, Fault, SensorFault

LAG_S = 0.1
"""Time constant of the acceleration behind its setpoint; tilting takes as long."""
LIFT_OFF = 1.3
"""Thrust at lift-off as a share of the weight."""
FALLING = 0.1
"""Share of the weight below which the attitude cannot be derived from the thrust."""
FALL_MAX_MPS = 30.0
PULL_1PS = 0.5
HEADING_SHARE = 0.1
"""PULL_1PS: rate, per second, at which the estimate approaches position and height of valid sensors.
HEADING_SHARE: share of the heading's error that each valid magnetometer reading corrects."""
STD_POS_M = 0.3
NO_RATES: Vec3 = (0.0, 0.0, 0.0)


class Point:
    """A mass over level ground at height 0, with a heading.

    Attributes:
        pos_ned_m: (3,) position.
        vel_ned_mps: (3,) velocity.
        acc_ned_mps2: (3,) acceleration of its motion, gravity included; zero at rest.
        yaw_rad: heading.
    """

    def __init__(self, gravity_mps2: float) -> None:
        self.pos_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self.vel_ned_mps: Vec3 = (0.0, 0.0, 0.0)
        self.acc_ned_mps2: Vec3 = (0.0, 0.0, 0.0)
        self.yaw_rad = 0.0
        self._gravity_mps2 = gravity_mps2

    @property
    def stands(self) -> bool:
        """Whether the point is on the ground."""
        return self.pos_ned_m[2] >= 0.0

    @property
    def tilt_rad(self) -> float:
        """Tilt of the thrust that gives the present acceleration; zero in free fall."""
        north, east, down = self.acc_ned_mps2
        up = self._gravity_mps2 - down
        return atan2(hypot(north, east), up) if up > FALLING * self._gravity_mps2 else 0.0

    def step(self, dt: float, wanted_ned_mps2: Vec3, yaw_rate_rps: float) -> None:
        """Advance by `dt` seconds.

        Args:
            dt: length of the step in s.
            wanted_ned_mps2: (3,) acceleration setpoint, gravity included.
            yaw_rate_rps: yaw rate.
        """
        share = dt / (dt + LAG_S)
        (an, ae, ad), (vn, ve, vd), (pn, pe, pd) = self.acc_ned_mps2, self.vel_ned_mps, self.pos_ned_m
        an += share * (wanted_ned_mps2[0] - an)
        ae += share * (wanted_ned_mps2[1] - ae)
        ad += share * (wanted_ned_mps2[2] - ad)
        vn, ve, vd = vn + an * dt, ve + ae * dt, min(FALL_MAX_MPS, vd + ad * dt)
        pn, pe, pd = pn + vn * dt, pe + ve * dt, pd + vd * dt
        if pd >= 0.0:
            pd, vn, ve, vd, an, ae, ad = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, min(0.0, ad)
        self.acc_ned_mps2, self.vel_ned_mps, self.pos_ned_m = (an, ae, ad), (vn, ve, vd), (pn, pe, pd)
        self.yaw_rad = wrap_pi(self.yaw_rad + yaw_rate_rps * dt)

    def attitude(self, yaw_rad: float) -> Quat:
        """Attitude with the given heading whose thrust gives the present acceleration."""
        (an, ae, ad), c, s = self.acc_ned_mps2, cos(yaw_rad), sin(yaw_rad)
        up = self._gravity_mps2 - ad
        if up <= FALLING * self._gravity_mps2:
            return quat_from_euler(0.0, 0.0, yaw_rad)
        forward, right = an * c + ae * s, ae * c - an * s
        pitch_rad = -atan2(forward, up)
        return quat_from_euler(atan2(right, hypot(forward, up)), pitch_rad, yaw_rad)


class PointEstimate:
    """The vehicle's estimate of its state: the truth plus the errors of valid sensors.

    Small innovations correct the estimate gradually. An innovation above the gate that lasts some seconds resets the
    estimate to the sensor, as in the autopilot's estimator.
    """

    def __init__(self, config: StateEstimatorConfig, point: Point, origin_deg: Vec3) -> None:
        self.origin_deg: Vec3 | None = origin_deg
        self.t_us = 0
        self.reset_counter = 0
        self.reset_offset_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self._config = config
        self._point = point
        self._origin_deg = origin_deg
        self._started_us: int | None = None
        self._error_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self._yaw_error_rad = 0.0
        self._fix_us = self._baro_us = 0
        self._pos_differs = ResetDetector()
        self._height_differs = ResetDetector()

    def tick(self, t_us: int) -> None:
        """Set the present time."""
        self.t_us = t_us
        if self._started_us is None:
            self._started_us = t_us

    def configure(self, config: StateEstimatorConfig) -> None:
        """Apply new settings."""
        self._config = config

    # -- the estimate --------------------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        return self._started_us is not None and self.t_us - self._started_us >= ALIGN_US

    @property
    def invalid_reason(self) -> str:
        """Why the estimate cannot be flown with, or ""."""
        if not self.running:
            return "aligning, keep the vehicle still"
        if self._pos_differs.mean_innovation:
            return f"GNSS is {hypot(*self._pos_differs.mean_innovation):.1f} m away from the estimate"
        if self._height_differs.mean_innovation:
            return f"the barometer is {abs(self._height_differs.mean_innovation[0]):.1f} m away from the estimate"
        return ""

    @property
    def pos_ned_m(self) -> Vec3:
        return add(self._point.pos_ned_m, self._error_ned_m)

    @property
    def vel_ned_mps(self) -> Vec3:
        return self._point.vel_ned_mps

    @property
    def acc_ned_mps2(self) -> Vec3:
        return self._point.acc_ned_mps2

    @property
    def yaw_rad(self) -> float:
        return wrap_pi(self._point.yaw_rad + self._yaw_error_rad)

    @property
    def q_ned_from_frd(self) -> Quat:
        return self._point.attitude(self.yaw_rad)

    @property
    def tilt_rad(self) -> float:
        return self._point.tilt_rad

    @property
    def rates_frd_rps(self) -> Vec3:
        return NO_RATES

    @property
    def var_pos_ned_m2(self) -> Vec3:
        return (STD_POS_M**2, STD_POS_M**2, STD_POS_M**2)

    # -- sensors -------------------------------------------------------------------------------------------

    def on_imu(self, t_us: int, acc_frd_mps2: Vec3, gyro_frd_rps: Vec3) -> None:
        """Ignored: the point mass has no IMU."""

    def on_fix(self, fix: Fix) -> None:
        """Update the horizontal position."""
        if not fix.valid:
            return
        dt, self._fix_us = (self.t_us - self._fix_us) * 1e-6, self.t_us
        north, east, _ = subtract(ned_from_geodetic(fix.position_deg, self._origin_deg), self.pos_ned_m)
        if hypot(north, east) < self._config.ekf2_gps_p_gate_m:
            self._pos_differs.clear()
            self._pull(dt, (north, east, 0.0))
        elif self._pos_differs.update(self.t_us, (north, east), self._config.ekf2_gps_p_gate_m):
            north, east = self._pos_differs.mean_innovation
            self._pos_differs.clear()
            self._reset((north, east, 0.0))

    def on_baro(self, altitude_pressure_m: float) -> None:
        """Update the height."""
        dt, self._baro_us = (self.t_us - self._baro_us) * 1e-6, self.t_us
        down = -altitude_pressure_m - self.pos_ned_m[2]
        if abs(down) < self._config.ekf2_baro_gate_m:
            self._height_differs.clear()
            self._pull(dt, (0.0, 0.0, down))
        elif self._height_differs.update(self.t_us, (down,), self._config.ekf2_baro_gate_m):
            (down,) = self._height_differs.mean_innovation
            self._height_differs.clear()
            self._reset((0.0, 0.0, down))

    def on_landed(self, landed: bool) -> None:
        """Ignored: no sensor resets the point mass' heading."""

    def on_mag(self, field_frd_gauss: Vec3) -> None:
        """Update the heading, unless the innovation is above the gate."""
        c, (x, y, _) = self._config, field_frd_gauss
        error_rad = wrap_pi(c.declination_rad - atan2(y, x) - self.yaw_rad)
        if abs(error_rad) < c.ekf2_head_gate_rad:
            self._yaw_error_rad += HEADING_SHARE * error_rad

    def _pull(self, dt: float, away_ned_m: Vec3) -> None:
        share = min(1.0, PULL_1PS * dt)
        n, e, d = self._error_ned_m
        self._error_ned_m = (n + share * away_ned_m[0], e + share * away_ned_m[1], d + share * away_ned_m[2])

    def _reset(self, step_ned_m: Vec3) -> None:
        self._error_ned_m = add(self._error_ned_m, step_ned_m)
        self.reset_offset_ned_m = add(self.reset_offset_ned_m, step_ned_m)
        self.reset_counter += 1


class PointPilot:
    """Controller that turns a setpoint into an acceleration of the point, with the autopilot's velocity loop.

    Attributes:
        detector: the land detector.
        wanted_ned_mps2: (3,) acceleration setpoint of the point, gravity included.
        yaw_rate_rps: yaw rate setpoint of the point.
    """

    def __init__(self, config: AutopilotConfig, point: Point, estimate: PointEstimate, planet: PlanetConfig) -> None:
        self.detector = LandDetector(config.land_detector)
        self._hover = config.control.mpc_thr_hover
        self._control = config.control
        self._point = point
        self._estimate = estimate
        self._loop = VelocityLoop(config.control, planet)
        self._gravity_mps2 = planet.gravity_mps2
        self._rest()

    def configure(self, config: AutopilotConfig) -> None:
        """Apply new settings."""
        self._control = config.control
        self._loop.configure(config.control)
        self.detector.configure(config.land_detector)

    @property
    def kinematics(self) -> Kinematics:
        e = self._estimate
        return Kinematics(e.pos_ned_m, e.vel_ned_mps, e.acc_ned_mps2, e.yaw_rad)

    @property
    def vel_setpoint_ned_mps(self) -> Vec3:
        return self._loop.vel_setpoint_ned_mps

    def contact_lean_ned(self, sine_max: float) -> None:
        """None: a point does not tilt."""

    def leave_contact(self) -> None:
        """Never called, as a point does not tilt."""

    def stop(self) -> Commands:
        """Stop the thrust: the point falls, or stands."""
        self.detector.reset()
        self._rest()
        return STOPPED

    def _rest(self) -> None:
        self._loop.reset()
        self._armed_s = 0.0
        self._limit = 0.0
        self._thrust = 0.0
        self._yaw_rad = self._estimate.yaw_rad
        self.yaw_rate_rps = 0.0
        self.wanted_ned_mps2: Vec3 = (0.0, 0.0, self._gravity_mps2)

    def step(self, dt: float, setpoint: ControlSetpoint, *, allow_takeoff: bool) -> Commands:
        """See `FlightController`."""
        at, detector, armed_s = self.kinematics, self.detector, self._armed_s + dt
        force_ned_mps2: Vec3 = (0.0, 0.0, -LIFT_OFF * self._gravity_mps2)
        if detector.landed:
            climbs = self._loop.velocity_setpoint(at, setpoint)[2] < -CLIMB_SETPOINT_MIN_MPS
            if not (allow_takeoff and climbs and armed_s >= SPOOLUP_TIME_S):
                self._rest()
                self._armed_s = armed_s
                return IDLE
            if at.vel_ned_mps[2] < -LIFTOFF_SPEED_MIN_MPS:
                detector.on_takeoff()
        else:
            self._turn(dt, at.yaw_rad, setpoint)
            force_ned_mps2 = self._loop.specific_force(dt, at, setpoint)
        self._armed_s = armed_s
        commands = self._push(dt, force_ned_mps2)
        if not detector.landed:
            thrust_hover_ratio = self._thrust / self._hover
            detector.step(dt, at.vel_ned_mps, NO_RATES, self._loop.vel_setpoint_ned_mps[2], thrust_hover_ratio)
        return commands

    def _turn(self, dt: float, yaw_rad: float, setpoint: ControlSetpoint) -> None:
        c, rate_rps = self._control, setpoint.yaw_rate_rps or 0.0
        if setpoint.yaw_rad is not None:
            self._yaw_rad = setpoint.yaw_rad
        elif rate_rps != 0.0:
            self._yaw_rad = wrap_pi(yaw_rad + rate_rps * dt)
        turn_rps = c.mc_yaw_p * wrap_pi(self._yaw_rad - yaw_rad) + rate_rps
        self.yaw_rate_rps = max(-c.mc_yawrate_max_rps, min(c.mc_yawrate_max_rps, turn_rps))

    def _push(self, dt: float, force_ned_mps2: Vec3) -> Commands:
        """Limit the thrust: it ramps up after the start, and down while the vehicle touches the ground in a descent."""
        ramp = dt / self._control.mpc_tko_ramp_t_s
        held_down = self.detector.contact and not self.detector.landed
        self._limit = (
            max(0.0, min(self._limit, self._thrust) - 2.0 * ramp) if held_down else min(1.0, self._limit + ramp)
        )
        n, e, d = force_ned_mps2
        wanted = self._hover * sqrt(n * n + e * e + d * d) / self._gravity_mps2
        self._thrust = min(wanted, self._limit)
        share = self._thrust / wanted if wanted > 0.0 else 0.0
        self.wanted_ned_mps2 = (share * n, share * e, share * d + self._gravity_mps2)
        return (self._thrust,) * 4


# -- the service -----------------------------------------------------------------------------------------

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
        robot: the vehicle: height of the platform, weight, battery, range of the altimeter.
        world: settings of the simulator: origin and the errors of the sensors.
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
        self._point = Point(robot.planet.gravity_mps2)
        self._estimate = PointEstimate(config.estimator, self._point, world.origin.origin_deg)
        self._pilot = PointPilot(config, self._point, self._estimate, robot.planet)
        self._vehicle = AutopilotVehicle(self._parameters, system_id, self._estimate, self._pilot)
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
            contact_force_n=self._robot.weight_n if point.stands else 0.0,
            armed_motors=self._vehicle.commander.armed,
        )


def _last(readings: Iterable[Any]) -> Any:
    """The last reading, or None without any."""
    return next(iter(reversed([*readings])), None)


# -- faults of its sensors -------------------------------------------------------------------------------

SUBSTITUTES = {"imu": "mag", "uwb": "baro", "rover_odometry": "altimeter"}
"""Sensors that fail instead of those that the point mass does not have."""
WRONG_FIX_DEG = 4.5e-5
GARBLED_FIX_DEG = 4.5e-4
WRONG_HEIGHT_M = 10.0
GARBLED_HEIGHT_M = 20.0
WRONG_FIELD_GAUSS = 0.2


def point_mass_fault(fault: Fault) -> Fault:
    """The corresponding fault where simulator and autopilot are one service without a link between them."""
    if fault.kind in SENSOR_KINDS:
        return replace(fault, where=SUBSTITUTES.get(fault.where, fault.where))
    if fault.path == HIL:
        return replace(
            fault, where=fault.where.replace(SIMULATOR, "vehicle_bridge").replace(AUTOPILOT, NAME), path=MAVLINK
        )
    return replace(fault, where=fault.where.replace(SIMULATOR, NAME).replace(AUTOPILOT, NAME))


class FaultyPointMass:
    """Service that runs a point mass and applies the active sensor faults to its readings.

    Attributes:
        active: the active faults; the caller of `start` removes them.
    """

    def __init__(self, world: PointMass, rng: Random) -> None:
        self.spec = world.spec
        self.active: list[SensorFault] = []
        self._world = world
        self._rng = rng

    def start(self, fault: Fault) -> SensorFault:
        running = SensorFault(fault, self._rng)
        self.active.append(running)
        return running

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """See `Service`."""
        self._world.sensor_filter = self._filter if self.active else None
        yield from self._world.step(t_ns, inbox)

    def _filter(self, sensor: str, t_ns: int, reading: Any) -> Iterable[Any]:
        readings = [reading]
        for fault in self.active:
            if fault.sensor != sensor:
                continue
            if sensor == "altimeter":
                readings = [changed for r in readings for changed in fault.on_bus(t_ns, r)]
            else:
                readings = [changed for r in readings for changed in self._changed(fault, t_ns, r)]
        return readings

    def _changed(self, fault: SensorFault, t_ns: int, reading: Any) -> Iterator[Any]:
        rng, amount = self._rng, fault.amount

        def garbled(value: Any) -> Any:
            match fault.sensor:
                case "gnss":
                    return _shifted(value, rng.uniform(-GARBLED_FIX_DEG, GARBLED_FIX_DEG), valid=rng.random() < 0.5)
                case "mag":
                    return tuple(rng.uniform(-1.0, 1.0) for _ in range(3))
            return rng.uniform(-GARBLED_HEIGHT_M, GARBLED_HEIGHT_M)

        def wrong(value: Any) -> Any:
            match fault.sensor:
                case "gnss":
                    return _shifted(value, WRONG_FIX_DEG * amount)
                case "mag":
                    x, y, z = value
                    return (x + WRONG_FIELD_GAUSS * amount, y - WRONG_FIELD_GAUSS * amount, z)
            return value + WRONG_HEIGHT_M * amount

        yield from fault.readings(t_ns, reading, lambda first, now: first, garbled, wrong)


def _shifted(fix: Fix, north_deg: float, *, valid: bool = True) -> Fix:
    latitude_deg, longitude_deg, amsl_m = fix.position_deg
    return replace(fix, position_deg=(latitude_deg + north_deg, longitude_deg, amsl_m), valid=valid)
