"""The simulator: one physics step per service step, and the readings of all sensors."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import hypot, inf
from typing import TypeVar

from jezero.base.frames import Vec3, euler_from_quat, subtract
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import (
    Health,
    Inbox,
    Output,
    Publish,
    Reconnect,
    Reply,
    Request,
    Send,
    SetPace,
    Spec,
)
from jezero.schemas import sensors as messages
from jezero.schemas import simulator as control
from jezero.schemas import topics
from jezero.schemas.health import ServiceState
from jezero.schemas.state import Clock, Scene, Truth
from jezero.schemas.terrain import Ground
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator import sensors
from jezero.services.simulator.body import BodyState
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.faults import InjectedFaults
from jezero.services.simulator.hil import HilPort
from jezero.services.simulator.noise import generator, normals_of
from jezero.services.simulator.obstacles import make_obstacles, obstacle_message, obstacle_place
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
PAUSED_CLOCK_NS = 100_000_000
"""Period of the clock, in wall time, while vehicle time stands still."""
SPEED_WINDOW_NS = NS_PER_S
PLACED_FLYING_MIN_M = 1.0
ROVER_CLEARANCE_M, ROVER_CLEARANCE_HEIGHT_M = 1.5, 2.0
"""Distance from the rover's middle, below this height, at which the vehicle would touch it."""
OBSTACLE_CLEARANCE_M = 1.0
R = TypeVar("R", messages.Gnss, messages.Barometer, messages.Magnetometer, messages.Altimeter, messages.RoverOdometry)
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
    serves=(topics.GROUND, topics.CONTROL_SIMULATOR),
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
        self._obstacles = make_obstacles(config.terrain, terrain)
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
        self._world = World(config, vehicle, terrain, self._rover.state, self._obstacles)
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
        self._faults = InjectedFaults(
            seed,
            vehicle.planet,
            {"motor": len(vehicle.airframe.pos_rotors_frd_m), "uwb": len(vehicle.uwb.pos_anchors_rover_body_m)},
        )
        self._t_ns = 0
        """Vehicle time of the last step in which the world moved."""
        self._paused = False
        self._speed = config.pace
        self._speed_reached: float | None = None
        self._measured_from: tuple[int, int] | None = None
        """Wall time and vehicle time from which the speed is measured."""
        self._step_until: tuple[int, int] | None = None
        """Vehicle time at which to pause, and id of the request that waits for it."""
        self._clock_wall_ns = 0
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
        if self._paused:
            yield from self._stand_still(self._t_ns, inbox)
            return
        self._t_ns = t_ns
        yield from self._clock(t_ns, inbox.wall_ns)
        if self._faults.any:
            self._faults.end_over(t_ns)
        self._drive.update(t_ns, self._rover_port.commands(inbox))
        yield from self._health()
        self._drive_rover(t_ns)
        state = self._advance()
        yield from self._autopilot_sensors(t_ns, state)
        yield from self._navigation_sensors(t_ns, state)
        if self._when_truth.due(t_ns):
            yield Publish(topics.TRUTH, self._truth(t_ns, state))
        if self._when_scene.due(t_ns) and not (self._faults.any and self._faults.loses("camera")):
            yield Publish(topics.SCENE, self._scene(t_ns, state))
        yield from self._requests(t_ns, inbox)

    def _stand_still(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """A step while vehicle time stands still: the world waits, requests are served."""
        yield from self._health()
        if inbox.wall_ns - self._clock_wall_ns >= PAUSED_CLOCK_NS:
            yield self._clock_now(t_ns, inbox.wall_ns)
        yield from self._requests(t_ns, inbox)

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
            yield self._clock_now(t_ns, wall_ns)
            self._measure_speed(t_ns, wall_ns)

    def _clock_now(self, t_ns: int, wall_ns: int) -> Publish:
        self._clock_wall_ns = wall_ns
        pace = 0.0 if self._paused else self._speed
        return Publish(topics.CLOCK, Clock(t_ns=t_ns, epoch_id=self._epoch_id, wall_ns=wall_ns, pace=pace))

    def _measure_speed(self, t_ns: int, wall_ns: int) -> None:
        if self._measured_from is None:
            self._measured_from = (wall_ns, t_ns)
        since_ns, from_ns = self._measured_from
        if wall_ns - since_ns >= SPEED_WINDOW_NS:
            self._speed_reached = round((t_ns - from_ns) / (wall_ns - since_ns), 3)
            self._measured_from = (wall_ns, t_ns)

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
        commands: Sequence[float] = self._hil.commands
        if self._faults.any:
            commands = [0.0 if self._faults.stops_motor(i) else command for i, command in enumerate(commands)]
        force_ned_n, torque_frd_nm = self._uav.step(commands, body, wind_ned_mps, self._height_rotor_m)
        return self._world.step(force_ned_n, torque_frd_nm)

    def _autopilot_sensors(self, t_ns: int, state: BodyState) -> Iterable[Output]:
        """Send the readings of the autopilot's HIL link; a part of the same readings is published on the bus."""
        acc, gyro = self._imu.measure(state)
        if self._faults.any:
            acc, gyro = self._faults.vector("accel", acc), self._faults.vector("gyro", gyro)
        if self._when_mag.due(t_ns) and self._vehicle.heading_by == "magnetometer":
            self._put("mag", self._when_mag, t_ns, self._mag.measure(t_ns, state))
        if self._when_baro.due(t_ns):
            self._put("baro", self._when_baro, t_ns, self._baro.measure(t_ns, state))
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
            self._put("gps", self._when_gnss, t_ns, self._gnss.measure(t_ns, state))
        if (fix := self._when_gnss.arrived(t_ns)) is not None:
            yield Send(HIL, self._hil.gps(fix))
            yield Publish(topics.GNSS, fix)

    def _navigation_sensors(self, t_ns: int, state: BodyState) -> Iterable[Output]:
        """Publish the readings that the autopilot does not get."""
        if self._when_altimeter.due(t_ns):
            mount = self._vehicle.altimeter
            range_m = self._world.range_m(mount.pos_altimeter_frd_m, DOWN_FRD, mount.range_max_m)
            self._height_rotor_m = inf if range_m is None else range_m + mount.pos_altimeter_frd_m[2]
            self._put("distance_sensor", self._when_altimeter, t_ns, self._altimeter.measure(t_ns, range_m))
        if (altimeter := self._when_altimeter.arrived(t_ns)) is not None:
            yield Publish(topics.ALTIMETER, altimeter)
            if self._config.altimeter.on_hil:
                yield Send(HIL, self._hil.distance(altimeter, self._vehicle.altimeter))
        if self._when_uwb.due(t_ns):
            uwb_round = self._uwb.measure(t_ns, state, self._rover.state)
            if not self._faults.any:
                self._when_uwb.put(t_ns, uwb_round)
            elif not self._faults.loses("uwb"):
                uwb_round = self._faults.ranges(uwb_round, self._vehicle.uwb.range_max_m)
                self._when_uwb.put(t_ns + self._faults.delay_ns("uwb"), uwb_round)
        if (uwb := self._when_uwb.arrived(t_ns)) is not None:
            yield Publish(topics.UWB, uwb)
        if self._when_odometry.due(t_ns):
            self._put("rover_odometry", self._when_odometry, t_ns, self._odometry.measure(t_ns, self._rover.state))
        if (odometry := self._when_odometry.arrived(t_ns)) is not None:
            yield self._rover_port.odometry(odometry)

    def _put(self, unit: control.FaultUnit, schedule: Schedule[R], t_ns: int, reading: R) -> None:
        """Add a sensor's reading to its schedule, with the sensor's fault."""
        if not self._faults.any:
            schedule.put(t_ns, reading)
        elif not self._faults.loses(unit):
            schedule.put(t_ns + self._faults.delay_ns(unit), self._faults.reading(unit, reading))

    # -- requests --

    def _requests(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        for request in inbox.requests(topics.GROUND):
            yield Reply(request.request_id, self._ground())
        for request in inbox.requests(topics.CONTROL_SIMULATOR):
            yield from self._serve(t_ns, inbox.wall_ns, request)
        if self._step_until is not None and not self._paused and t_ns >= self._step_until[0]:
            yield from self._pause(t_ns, inbox.wall_ns)

    def _serve(self, t_ns: int, wall_ns: int, request: Request) -> Iterable[Output]:
        """Make the change of a request, or refuse it."""
        change = request.payload.do
        if reason := self._refusal(change):
            yield self._reply(request.request_id, t_ns, reason)
            return
        match change:
            case control.ResetWorld():
                yield from self._reset(t_ns)
            case control.PlaceBody():
                self._place(change)
            case control.SetWind():
                self._wind.change(change.mean_mps, change.from_deg, change.std_gust_mps)
            case control.SetFault():
                self._faults.set(change, t_ns)
            case control.SetSpeed():
                self._speed = change.speed
                if not self._paused:
                    yield from self._run(t_ns, wall_ns)
            case control.PauseWorld():
                yield from self._pause(t_ns, wall_ns)
            case control.ResumeWorld():
                yield from self._run(t_ns, wall_ns)
            case control.StepWorld():
                self._step_until = (t_ns + round(change.duration_s * NS_PER_S), request.request_id)
                yield from self._run(t_ns, wall_ns)
                return  # the reply comes when the step is over
        yield self._reply(request.request_id, t_ns)

    def _refusal(self, change: control.Change | None) -> str:
        """Reason why a change is not possible; "" for one that is."""
        match change:
            case control.SetFault():
                return self._faults.refusal(change)
            case control.PlaceBody():
                return self._place_refusal(change)
            case control.StepWorld() if not self._paused:
                return "vehicle time runs; a step needs a paused simulator: jezero sim pause"
        return ""

    def _pause(self, t_ns: int, wall_ns: int) -> Iterable[Output]:
        self._paused = True
        yield SetPace(0.0)
        yield self._clock_now(t_ns, wall_ns)
        if self._step_until is not None:
            yield self._reply(self._step_until[1], t_ns)
            self._step_until = None

    def _run(self, t_ns: int, wall_ns: int) -> Iterable[Output]:
        self._paused = False
        self._measured_from = None
        yield SetPace(self._speed)
        yield self._clock_now(t_ns, wall_ns)

    def _reset(self, t_ns: int) -> Iterable[Output]:
        """Everything as at the start; the autopilot starts anew when it connects again, which respawns the vehicle."""
        wind = self._config.wind
        self._faults.clear()
        self._wind.change(wind.mean_mps, wind.from_deg, wind.std_gust_mps)
        self._respawn(t_ns)
        if self._up:
            yield Reconnect(HIL)

    def _place(self, place: control.PlaceBody) -> None:
        north_m, east_m = self._in_map(place)
        if place.what == "rover":
            self._drive = Drive(self._config.rover)
            yaw_rad = self._rover.state.yaw_rad if place.yaw_rad is None else place.yaw_rad
            self._world.move_rover(self._rover.place(north_m, east_m, yaw_rad))
            return
        yaw_rad = euler_from_quat(self._world.state.q_ned_from_frd)[2] if place.yaw_rad is None else place.yaw_rad
        down_m = -self._terrain.height_m(north_m, east_m) - place.height_m
        stand_m = self._vehicle.airframe.height_stand_m + self._config.uav.sag_legs_m
        self._world.place_uav((north_m, east_m, down_m - stand_m), yaw_rad)

    def _in_map(self, place: control.PlaceBody) -> tuple[float, float]:
        start_north_m, start_east_m, _ = self._world.start_ned_m
        return start_north_m + place.north_m, start_east_m + place.east_m

    def _place_refusal(self, place: control.PlaceBody) -> str:
        """Reason why nothing can be put there; "" where it can."""
        there, height_m = self._in_map(place), self._height_m()
        there_ned_m = (*there, -self._terrain.height_m(*there) - place.height_m)
        if near := [each.name for each in self._obstacles if each.is_near(there_ned_m, OBSTACLE_CLEARANCE_M)]:
            return f"{near[0]} is there: at least {OBSTACLE_CLEARANCE_M:g} m are needed around it"
        if place.what == "vehicle":
            near_rover = _apart_m(there, self._rover.state.pos_ned_m) < ROVER_CLEARANCE_M
            if near_rover and place.height_m < ROVER_CLEARANCE_HEIGHT_M:
                return f"the rover is there: at least {ROVER_CLEARANCE_M:g} m are needed between vehicle and rover"
            return self._height_refusal(place.height_m, height_m)
        if place.height_m:
            return "the rover stands on the ground: leave the height out"
        return self._rover_place_refusal(there, height_m)

    def _rover_place_refusal(self, there: tuple[float, float], height_m: float) -> str:
        """Reason why the rover can't be put to a place on the ground, with the vehicle at a height; "" if it can."""
        uav, rover = self._world.state.pos_ned_m, self._rover.state.pos_ned_m
        if _apart_m(uav, rover) < ROVER_CLEARANCE_M and 0.2 < height_m < ROVER_CLEARANCE_HEIGHT_M:
            return "the vehicle stands on the rover or lands on it: move the vehicle away first"
        if _apart_m(there, uav) < ROVER_CLEARANCE_M and height_m < ROVER_CLEARANCE_HEIGHT_M:
            return f"the vehicle is there: at least {ROVER_CLEARANCE_M:g} m are needed between vehicle and rover"
        return ""

    def _height_refusal(self, height_m: float, present_m: float) -> str:
        """Reason why the vehicle can't be put to a height above the ground from the present one; "" if it can."""
        if not any(self._hil.commands):
            return f"the motors stand still, so it would fall {height_m:g} m: take off first" if height_m else ""
        if height_m < PLACED_FLYING_MIN_M:
            least = f"a height of {PLACED_FLYING_MIN_M:g} m or more"
            return f"the motors run: land first, or put the flying vehicle into the air, with {least}"
        if present_m < 0.5 * PLACED_FLYING_MIN_M:
            return "the motors run and the vehicle is on the ground: take off first, or disarm"
        return ""

    def _height_m(self) -> float:
        """Height of the vehicle over the ground, 0 where it stands on it."""
        north_m, east_m, down_m = self._world.state.pos_ned_m
        return -down_m - self._vehicle.airframe.height_stand_m - self._terrain.height_m(north_m, east_m)

    def _reply(self, request_id: int, t_ns: int, reason: str = "") -> Reply:
        return Reply(request_id, control.SimulatorReply(accepted=not reason, reason=reason, state=self._state(t_ns)))

    def _state(self, t_ns: int) -> control.SimulatorState:
        """The world, in the frame of the truth."""
        truth = self._truth(t_ns, self._world.state)
        wind = self._wind
        return control.SimulatorState(
            t_ns=t_ns,
            epoch_id=self._epoch_id,
            paused=self._paused,
            speed=self._speed,
            speed_reached=self._speed_reached,
            autopilot=self._up,
            motors=truth.armed_motors,
            pos_uav_ned_m=truth.pos_uav_ned_m,
            vel_uav_ned_mps=truth.vel_uav_ned_mps,
            yaw_uav_rad=euler_from_quat(truth.q_ned_from_frd)[2],
            height_uav_m=round(self._height_m(), 3),
            pos_rover_ned_m=truth.pos_rover_ned_m,
            yaw_rover_rad=truth.yaw_rover_rad,
            speed_rover_mps=self._rover.state.speed_mps,
            wind_mean_mps=wind.mean_mps,
            wind_from_deg=wind.from_deg,
            std_gust_mps=wind.std_gust_mps,
            wind_ned_mps=wind.vel_ned_mps,
            faults=self._faults.active,
            obstacles=tuple(obstacle_place(each, self._origin_ned_m()) for each in self._obstacles),
        )

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
        origin_ned_m = self._origin_ned_m()
        return ground_reply(
            self._terrain, origin_ned_m, tuple(obstacle_message(each, origin_ned_m) for each in self._obstacles)
        )

    def _origin_ned_m(self) -> Vec3:
        """Origin of the frame of the truth, in the map."""
        north_m, east_m, down_m = self._world.start_ned_m
        return north_m, east_m, down_m + self._world.height_stand_m

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


def _apart_m(one: Sequence[float], other: Sequence[float]) -> float:
    """Horizontal distance."""
    return hypot(one[0] - other[0], one[1] - other[1])
