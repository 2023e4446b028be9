"""The simulator: one physics step per service step, and the readings of all sensors."""

from collections.abc import Iterable
from dataclasses import replace
from math import inf

from jezero.base.frames import Vec3, euler_from_quat, subtract
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Health, Inbox, Output, Publish, Reply, Send, Spec
from jezero.schemas import sensors as messages
from jezero.schemas import topics
from jezero.schemas.health import ServiceState
from jezero.schemas.state import Clock, Scene, Truth
from jezero.schemas.terrain import Ground
from jezero.services.simulator import sensors
from jezero.services.simulator.body import BodyState
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.hil import HilPort
from jezero.services.simulator.noise import generator, normals_of
from jezero.services.simulator.rover import Drive, RoverModel
from jezero.services.simulator.rover_port import ROVER, RoverPort
from jezero.services.simulator.schedule import DT_S, STEPS_PER_S, Schedule
from jezero.services.simulator.sea import make_sea
from jezero.services.simulator.terrain import ground_reply, make_terrain
from jezero.services.simulator.uav import Uav
from jezero.services.simulator.wind import WindModel

HIL = "hil"
DOWN_FRD: Vec3 = (0.0, 0.0, 1.0)
BEHIND_NS = 20_000_000
EPOCHS_PER_BOOT = 1000
EPOCH_LIMIT = 2**53
"""Integers below it survive JSON readers that only know doubles."""

SPEC = Spec(
    name="simulator",
    inputs=(topics.ROVER_COMMAND,),
    outputs=(
        topics.CLOCK,
        topics.IMU,
        topics.GNSS,
        topics.BARO,
        topics.MAG,
        topics.ALTIMETER,
        topics.UWB,
        topics.ROVER_ODOMETRY,
        topics.TRUTH,
        topics.SCENE,
    ),
    serves=(topics.GROUND,),
    links=(HIL, ROVER),
    rate_hz=STEPS_PER_S,
    lockstep=HIL,
)


class Simulator:
    """The world with its vehicle, rover and sensors; the master of vehicle time.

    Vehicle and rover respawn, in a new epoch, whenever an autopilot connects; while none is there the motors stand
    still.

    Args:
        seed: seed of wind and sensor errors. The ground has a seed of its own in the settings.
        boot_id: number that differs between two runs; part of the epoch's id.
    """

    def __init__(self, config: SimulatorConfig, vehicle: VehicleConfig, seed: int, boot_id: int) -> None:
        from jezero.services.simulator.world import World

        made_with = {"config": config, "vehicle": vehicle, "seed": seed, "boot_id": boot_id}
        self.spec = replace(SPEC, pace=config.pace, made_with=made_with)
        self._terrain = terrain = make_terrain(config.terrain)
        self._config = config
        self._vehicle = vehicle
        self._boot_id = boot_id
        self._connections = 0
        self._up = False
        self._behind_ns = 0
        """Delay of vehicle time behind wall time when the clock was last published, up to a constant."""
        self._hil = HilPort()
        self._rover_port = RoverPort()
        self._reported = Health("ok", "")
        self._sea = make_sea(config.rover.sea, seed, vehicle.planet.gravity_mps2)
        self._rover = RoverModel(config.rover, terrain, vehicle.platform.height_m, self._sea)
        self._drive = Drive(config.rover)
        self._world = World(config, vehicle, terrain, self._rover.state)
        self._uav = Uav(config, vehicle, DT_S)
        self._wind = WindModel(config.wind, DT_S, normals_of(generator(seed, "wind")))
        self._height_rotor_m = inf
        self._imu = sensors.ImuModel(config.imu, seed, DT_S)
        self._gnss = sensors.GnssModel(config.gnss, config.origin, seed, vehicle.heading_by)
        self._baro = sensors.BarometerModel(config.barometer, config.origin, vehicle.planet, seed)
        self._mag = sensors.MagnetometerModel(config.magnetometer, config.origin, seed)
        self._altimeter = sensors.AltimeterModel(config.altimeter, vehicle.altimeter, seed)
        self._uwb = sensors.UwbModel(config.uwb, vehicle.uwb, seed)
        self._odometry = sensors.RoverOdometryModel(config.rover_odometry, seed)
        self._make_schedules(config)

    def _make_schedules(self, config: SimulatorConfig) -> None:
        """Make the schedules of all messages; their phases spread the sensors over the steps."""
        self._when_clock = Schedule[Clock](topics.CLOCK.rate_hz or 10.0)
        self._when_truth = Schedule[Truth](topics.TRUTH.rate_hz or 50.0)
        self._when_scene = Schedule[Scene](topics.SCENE.rate_hz or 15.0, phase_s=0.02)
        self._when_imu = Schedule[messages.Imu](config.imu.rate_hz, config.imu.delay_s)
        self._when_mag = Schedule[messages.Magnetometer](config.magnetometer.rate_hil_hz, config.magnetometer.delay_s)
        self._when_mag_bus = Schedule[None](config.magnetometer.rate_hz)
        self._when_baro = Schedule[messages.Barometer](
            config.barometer.rate_hil_hz, config.barometer.delay_s, phase_s=0.008
        )
        self._when_baro_bus = Schedule[None](config.barometer.rate_hz, phase_s=0.008)
        self._when_gnss = Schedule[messages.Gnss](config.gnss.rate_hz, config.gnss.delay_s, phase_s=0.052)
        self._when_altimeter = Schedule[messages.Altimeter](
            config.altimeter.rate_hz, config.altimeter.delay_s, phase_s=0.004
        )
        self._when_uwb = Schedule[messages.Uwb](config.uwb.rate_hz, config.uwb.delay_s, phase_s=0.012)
        self._when_odometry = Schedule[messages.RoverOdometry](
            config.rover_odometry.rate_hz, config.rover_odometry.delay_s, phase_s=0.016
        )

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Advance the world by 4 ms to `t_ns`, with or without a new motor command."""
        self._follow_link(t_ns, inbox)
        yield from self._clock(t_ns, inbox.wall_ns)
        self._drive.update(t_ns, self._rover_port.commands(inbox))
        yield from self._health()
        self._drive_rover(t_ns)
        state = self._advance()
        yield from self._autopilot_sensors(t_ns, state)
        yield from self._navigation_sensors(t_ns, state)
        if self._when_truth.due(t_ns):
            yield Publish(topics.TRUTH, self._truth(t_ns, state))
        if self._when_scene.due(t_ns):
            yield Publish(topics.SCENE, self._scene(t_ns, state))
        for request in inbox.requests(topics.GROUND):
            yield Reply(request.request_id, self._ground())

    def change_wind(self, mean_mps: float, from_deg: float) -> None:
        """Change the mean wind from now on, see `WindConfig`."""
        self._wind.change(mean_mps, from_deg)

    def turn_compass(self, error_rad: float) -> None:
        """Turn the magnetic field at the vehicle about the vertical, so that its compass is wrong by this angle."""
        self._mag.error_yaw_rad = error_rad

    def close(self) -> None:
        """Free the physics engine."""
        self._world.close()

    def _clock(self, t_ns: int, wall_ns: int) -> Iterable[Output]:
        """Publish the clock periodically, and at once when vehicle time has fallen behind: services extrapolate it."""
        behind_ns = wall_ns - t_ns
        if self._when_clock.due(t_ns) or behind_ns - self._behind_ns > BEHIND_NS:
            self._behind_ns = behind_ns
            yield Publish(topics.CLOCK, Clock(t_ns=t_ns, epoch_id=self._epoch_id, wall_ns=wall_ns))

    @property
    def _epoch_id(self) -> int:
        return (self._boot_id * EPOCHS_PER_BOOT + self._connections) % EPOCH_LIMIT

    def _follow_link(self, t_ns: int, inbox: Inbox) -> None:
        """Take the newest motor commands; a new autopilot finds a new vehicle, a lost one leaves the motors off."""
        connections = inbox.connections(HIL)
        up = inbox.is_up(HIL)
        if connections != self._connections:
            self._connections = connections
            self._respawn(t_ns)
        if up:
            self._hil.receive(inbox.received(HIL))
        elif self._up:
            self._hil = HilPort()
        self._up = up

    def _health(self) -> Iterable[Output]:
        """State of the two links, when it has changed."""
        state: ServiceState = "ok" if self._up else "degraded"
        text = (
            "an autopilot is connected" if self._up else "the autopilot is gone: motors are stopped until one connects"
        )
        text += self._rover_port.text
        if text != self._reported.text:
            self._reported = Health(state, text)
            yield self._reported

    def _respawn(self, t_ns: int) -> None:
        """Put vehicle and rover back to their start; delayed readings of the old epoch are dropped."""
        self._hil = HilPort(t_ns if self._config.time_from_boot else 0)
        self._uav.stop()
        self._rover = RoverModel(self._config.rover, self._terrain, self._vehicle.platform.height_m, self._sea)
        self._drive = Drive(self._config.rover)
        self._odometry.restart()
        self._world.move_rover(self._rover.state)
        self._world.respawn()
        self._make_schedules(self._config)

    def _drive_rover(self, t_ns: int) -> None:
        moved = self._drive.moves
        self._drive.step(t_ns, DT_S)
        if moved or self._drive.moves or self._rover.moves_by_itself:
            self._world.move_rover(self._rover.drive(self._drive.speed_mps, self._drive.yaw_rate_rps, DT_S))

    def _advance(self) -> BodyState:
        body = self._world.state
        wind_ned_mps = self._wind.step(-body.pos_ned_m[2])
        force_ned_n, torque_frd_nm = self._uav.step(self._hil.commands, body, wind_ned_mps, self._height_rotor_m)
        return self._world.step(force_ned_n, torque_frd_nm)

    def _autopilot_sensors(self, t_ns: int, state: BodyState) -> Iterable[Output]:
        """Send the readings of the autopilot's HIL link; a part of the same readings is published on the bus."""
        acc, gyro = self._imu.measure(state)
        if self._when_mag.due(t_ns) and self._vehicle.heading_by == "magnetometer":
            self._when_mag.put(t_ns, self._mag.measure(t_ns, state))
        if self._when_baro.due(t_ns):
            self._when_baro.put(t_ns, self._baro.measure(t_ns, state))
        mag, baro = self._when_mag.arrived(t_ns), self._when_baro.arrived(t_ns)
        yield Send(HIL, self._hil.sensor(t_ns, acc, gyro, mag, baro))
        if self._when_imu.due(t_ns):
            self._when_imu.put(t_ns, messages.Imu(t_ns=t_ns, acc_imu_frd_mps2=acc, gyro_imu_frd_rps=gyro))
        if (imu := self._when_imu.arrived(t_ns)) is not None:
            yield Publish(topics.IMU, imu)
        if mag is not None and self._when_mag_bus.due(t_ns):
            yield Publish(topics.MAG, mag)
        if baro is not None and self._when_baro_bus.due(t_ns):
            yield Publish(topics.BARO, baro)
        if self._when_gnss.due(t_ns):
            self._when_gnss.put(t_ns, self._gnss.measure(t_ns, state))
        if (fix := self._when_gnss.arrived(t_ns)) is not None:
            yield Send(HIL, self._hil.gps(fix))
            yield Publish(topics.GNSS, fix)

    def _navigation_sensors(self, t_ns: int, state: BodyState) -> Iterable[Output]:
        """Publish the readings that the autopilot does not get."""
        if self._when_altimeter.due(t_ns):
            mount = self._vehicle.altimeter
            range_m = self._world.range_m(mount.pos_altimeter_frd_m, DOWN_FRD, mount.range_max_m)
            self._height_rotor_m = inf if range_m is None else range_m + mount.pos_altimeter_frd_m[2]
            self._when_altimeter.put(t_ns, self._altimeter.measure(t_ns, range_m))
        if (altimeter := self._when_altimeter.arrived(t_ns)) is not None:
            yield Publish(topics.ALTIMETER, altimeter)
            if self._config.altimeter.on_hil:
                yield Send(HIL, self._hil.distance(altimeter, self._vehicle.altimeter))
        if self._when_uwb.due(t_ns):
            self._when_uwb.put(t_ns, self._uwb.measure(t_ns, state, self._rover.state))
        if (uwb := self._when_uwb.arrived(t_ns)) is not None:
            yield Publish(topics.UWB, uwb)
        if self._when_odometry.due(t_ns):
            self._when_odometry.put(t_ns, self._odometry.measure(t_ns, self._rover.state))
        if (odometry := self._when_odometry.arrived(t_ns)) is not None:
            yield self._rover_port.odometry(odometry)

    def _scene(self, t_ns: int, state: BodyState) -> Scene:
        """State of vehicle and rover for one picture, in the map."""
        rover = self._rover.state
        roll_rad, pitch_rad, yaw_rad = euler_from_quat(rover.q_ned_from_rover_body)
        return Scene(
            t_ns=t_ns,
            epoch_id=self._epoch_id,
            pos_uav_ned_m=state.pos_ned_m,
            vel_uav_ned_mps=state.vel_ned_mps,
            q_ned_from_frd=state.q_ned_from_frd,
            rates_uav_frd_rps=state.rates_frd_rps,
            pos_rover_ned_m=rover.pos_ned_m,
            vel_rover_ned_mps=rover.vel_ned_mps,
            yaw_rover_rad=yaw_rad,
            pitch_rover_rad=pitch_rad,
            roll_rover_rad=roll_rad,
        )

    def _ground(self) -> Ground:
        """The terrain in the frame of the truth."""
        start_north_m, start_east_m, start_down_m = self._world.start_ned_m
        stand_down_m = start_down_m + self._world.height_stand_m
        return ground_reply(self._terrain, (start_north_m, start_east_m, stand_down_m))

    def _truth(self, t_ns: int, state: BodyState) -> Truth:
        """True state, in NED with its origin at the start of the vehicle.

        The vehicle's position is its centre of mass, lowered by the height at which it stands: the position of a
        standing vehicle has the height of the ground or the platform below it.
        """
        start_ned_m = self._world.start_ned_m
        rover = self._rover.state
        roll_rad, pitch_rad, yaw_rad = euler_from_quat(rover.q_ned_from_rover_body)
        north_m, east_m, down_m = subtract(rover.pos_ned_m, start_ned_m)
        return Truth(
            t_ns=t_ns,
            epoch_id=self._epoch_id,
            pos_uav_ned_m=subtract(state.pos_ned_m, start_ned_m),
            vel_uav_ned_mps=state.vel_ned_mps,
            q_ned_from_frd=state.q_ned_from_frd,
            rates_uav_frd_rps=state.rates_frd_rps,
            pos_rover_ned_m=(north_m, east_m, down_m - self._world.height_stand_m),
            vel_rover_ned_mps=rover.vel_ned_mps,
            yaw_rover_rad=yaw_rad,
            pitch_rover_rad=pitch_rad,
            roll_rover_rad=roll_rad,
            wind_ned_mps=self._wind.vel_ned_mps,
            contact_force_n=self._world.contact_force_n(),
            armed_motors=any(self._hil.commands),
        )
