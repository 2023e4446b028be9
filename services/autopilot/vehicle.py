"""The autopilot without its links: sensors in, motors out, and what others may ask of it."""

from dataclasses import replace
from math import inf, sqrt

from jezero.frames import Vec3, subtract
from jezero.frozen_sensor import FrozenSensorDetector
from jezero.services.autopilot.alignment import FIX_AGE_MAX_US, Fix
from jezero.services.autopilot.battery import Battery
from jezero.services.autopilot.commander import Commander, Condition
from jezero.services.autopilot.control import Axes, Setpoint, stopping_point_ned_m
from jezero.services.autopilot.hil import Reading
from jezero.services.autopilot.mixer import STOPPED, Commands
from jezero.services.autopilot.modes import Mode
from jezero.services.autopilot.navigator import Navigator
from jezero.services.autopilot.parameters import Parameters, Value
from jezero.services.autopilot.parts import Estimate, Pilot
from jezero.services.autopilot.streams import Snapshot

STEP_MAX_S = 0.05
COMMANDER_PERIOD_US = 10_000
"""Source: PX4's COMMANDER_MONITORING_INTERVAL."""
HEARTBEAT_HOLDS_S = 2.5
"""A ground station counts as heard for so long after each of its heartbeats. Source: PX4's HEARTBEAT_TIMEOUT_US."""


class Vehicle:
    """One flight of the simulator, from the first sensor reading on.

    Attributes:
        t_us: time of the newest reading.
        commander, estimator: its parts, to be looked at.
        landed: the land detector's word.
    """

    def __init__(self, parameters: Parameters, system_id: int, estimator: Estimate, flight: Pilot) -> None:
        config = parameters.config
        self._parameters = parameters
        self._system_id = system_id
        self.t_us = 0
        self.estimator = estimator
        self.commander = Commander(config.commander, config.failsafe)
        self._config = config
        self._flight = flight
        self._navigator = Navigator(config.navigator, config.control)
        self._battery = Battery(config.battery, config.airframe)
        self._fix: Fix | None = None
        self._fix_us: int | None = None
        self._usable_fix_us: int | None = None
        self._mag_us: int | None = None
        self._baro_us: int | None = None
        self._gnss_freeze = FrozenSensorDetector()
        self._mag_freeze = FrozenSensorDetector()
        self._baro_freeze = FrozenSensorDetector()
        self._link_us: int | None = None
        self._offboard = Setpoint()
        self._offboard_us: int | None = None
        self._followed: Setpoint | None = None
        self._thrust = 0.0
        self._ticks_at_us = 0
        self._mode = self.commander.mode
        self._reset_offset_ned_m: Vec3 = (0.0, 0.0, 0.0)

    @property
    def landed(self) -> bool:
        return self._flight.detector.landed

    @property
    def home_ned_m(self) -> Vec3:
        """Where it last armed; before that, where its estimator started."""
        return self._navigator.home_ned_m

    # -- sensors -------------------------------------------------------------------------------------------

    def fix(self, fix: Fix) -> None:
        """One GNSS fix; one that repeats itself, or is of another time, is none to fly by."""
        stuck = self._gnss_freeze.is_frozen((fix.position_deg, fix.vel_ned_mps))
        if stuck or (fix.t_us and abs(self.t_us - fix.t_us) > FIX_AGE_MAX_US):
            fix = replace(fix, usable=False)
        self._fix, self._fix_us = fix, self.t_us
        if fix.usable:
            self._usable_fix_us = self.t_us
        self.estimator.fix(fix)
        self._follow_reset()

    def step(self, reading: Reading) -> Commands:
        """One sample of the sensors; returns the (4,) motor commands."""
        dt = min((reading.t_us - self.t_us) * 1e-6, STEP_MAX_S) if self.t_us else 0.0
        self.t_us = reading.t_us
        estimator = self.estimator
        if reading.imu is not None:
            estimator.imu(reading.t_us, *reading.imu)
        field_frd_gauss, altitude_m = reading.field_frd_gauss, reading.altitude_pressure_m
        if field_frd_gauss is not None and not self._mag_freeze.is_frozen(field_frd_gauss):
            self._mag_us = reading.t_us
            estimator.mag(field_frd_gauss)
        if altitude_m is not None and not self._baro_freeze.is_frozen(altitude_m):
            self._baro_us = reading.t_us
            estimator.baro(altitude_m)
        self._follow_reset()
        if self.t_us >= self._ticks_at_us:
            self._ticks_at_us = self.t_us + COMMANDER_PERIOD_US
            self.commander.tick(self._condition())
            self._enter()
        commands = STOPPED
        self._followed = None
        if not self.commander.armed:
            commands = self._flight.stopped()
        elif estimator.running:
            commands = self._fly(dt)
        self._battery.step(dt, commands)
        self._thrust = sum(commands) / 4.0
        return commands

    def _fly(self, dt: float) -> Commands:
        commander = self.commander
        mode = commander.mode
        at = self._flight.kinematics
        tips_ned = self._flight.tips_ned
        if tips_ned is not None and self._navigator.leave(mode, at, tips_ned, self.t_us):
            self._flight.leave()
        if mode is Mode.OFFBOARD:
            setpoint = self._offboard
        else:
            if not self.landed and self._navigator.finished(mode, at):
                commander.switch(Mode.HOLD)
                self._mode = Mode.HOLD  # the point to hold is the one that it climbed to
            setpoint = self._navigator.setpoint(commander.mode, at, self.t_us)
        may_lift = mode is Mode.OFFBOARD or (mode is Mode.TAKEOFF and self._navigator.leads_up(at))
        commands = self._flight.step(dt, setpoint, may_lift=may_lift)
        if not self.landed:
            self._followed = setpoint
        return commands

    def _follow_reset(self) -> None:
        """Move what is stored in the local frame along with a step of the estimate."""
        offset = self.estimator.reset_offset_ned_m
        if offset != self._reset_offset_ned_m:
            step = subtract(offset, self._reset_offset_ned_m)
            self._reset_offset_ned_m = offset
            self._navigator.moved(step)
            self._offboard = self._offboard.moved(step)

    def _enter(self) -> None:
        """A new mode starts where the vehicle comes to rest."""
        if self.commander.mode is not self._mode:
            self._mode = self.commander.mode
            at = self._flight.kinematics
            self._navigator.enter(self._mode, at, stopping_point_ned_m(at, self._config.control), self.t_us)

    # -- what others ask; each returns why it is refused, or "" --------------------------------------------

    def arm(self) -> str:
        """Arm; home is where that happens."""
        was_armed = self.commander.armed
        reason = self.commander.arm(self._condition())
        if self.commander.armed and not was_armed:
            self._navigator.home_ned_m = self.estimator.pos_ned_m
            self._navigator.enter(self._mode, self._flight.kinematics, self.estimator.pos_ned_m, self.t_us)
        return reason

    def disarm(self, *, force: bool) -> str:
        reason = self.commander.disarm(self._condition(), force=force)
        self._enter()
        return reason

    def set_mode(self, mode: Mode) -> str:
        reason = self.commander.set_mode(mode, self._condition())
        self._enter()
        return reason

    def take_off(self, point_ned_m: Axes) -> str:
        """Takeoff mode, to a point; what is None of it is above the vehicle, or the usual height."""
        if reason := self.set_mode(Mode.TAKEOFF):
            return reason
        down = point_ned_m[2]
        if down is not None and down > self.estimator.pos_ned_m[2]:
            self.commander.say(2, "Already higher than takeoff altitude")
        self._navigator.climb_to(self._flight.kinematics, point_ned_m)
        return ""

    def reposition(self, point_ned_m: Vec3, yaw_rad: float | None) -> str:
        """Hold at another point."""
        if self.landed:
            return "the vehicle is on the ground"
        if reason := self.set_mode(Mode.HOLD):
            return reason
        self._navigator.go_to(point_ned_m, yaw_rad)
        return ""

    def stream(self, setpoint: Setpoint) -> None:
        """A setpoint for offboard mode."""
        self._offboard, self._offboard_us = setpoint, self.t_us

    def hear_ground_station(self) -> None:
        self._link_us = self.t_us

    def set_parameter(self, name: str, value: Value) -> bool:
        """Whether the parameter has this value now; see `Parameters.set`."""
        done = self._parameters.set(name, value)
        config = self._parameters.config
        if config is not self._config:
            self._config = config
            self.commander.configure(config.commander, config.failsafe)
            self.estimator.configure(config.estimator)
            self._flight.configure(config)
            self._navigator.configure(config.navigator, config.control)
            self._battery.configure(config.battery)
        return done

    # -- what it is ----------------------------------------------------------------------------------------

    def _condition(self) -> Condition:
        return Condition(
            t_us=self.t_us,
            not_armable="" if self.commander.armed else self._not_armable(),
            position_lost=self._position_lost(),
            stream_age_s=self._age_s(self._offboard_us),
            landed=self.landed,
            tilt_rad=self.estimator.tilt_rad,
            link_age_s=max(0.0, self._age_s(self._link_us) - HEARTBEAT_HOLDS_S),
            battery_remaining=self._battery.remaining,
        )

    def _position_lost(self) -> str:
        estimator, c = self.estimator, self._config.failsafe
        if not estimator.running:
            return estimator.missing
        north_m2, east_m2, _ = estimator.var_pos_ned_m2
        variance = north_m2 + east_m2
        if variance > c.com_pos_fs_eph_m * c.com_pos_fs_eph_m:
            return f"the position is uncertain by {sqrt(variance):.0f} m"
        age_s = self._age_s(self._usable_fix_us)
        return f"no GNSS fix for {age_s:.0f} s" if age_s > c.ekf2_noaid_tout_s else ""

    def _not_armable(self) -> str:
        """Why the sensors and the estimate don't allow to arm, in words."""
        c = self._config.commander
        if self.t_us == 0:
            return "no sensor data"
        if missing := self.estimator.missing:
            return missing
        ages = (("GNSS", self._fix_us), ("magnetometer", self._mag_us), ("barometer", self._baro_us))
        for name, last_us in ages:
            if self._age_s(last_us) > c.sensor_timeout_s:
                return f"no {name} data for {self._age_s(last_us):.1f} s"
        if self.estimator.tilt_rad > c.arm_tilt_rad:
            return "the vehicle is tilted too much"
        return ""

    def _age_s(self, last_us: int | None) -> float:
        return inf if last_us is None else (self.t_us - last_us) * 1e-6

    def snapshot(self) -> Snapshot:
        """All that telemetry tells."""
        estimator, commander, battery = self.estimator, self.commander, self._battery
        return Snapshot(
            system_id=self._system_id,
            t_us=self.t_us,
            armed=commander.armed,
            failsafe=commander.failsafe,
            custom_mode=commander.mode.custom_mode,
            landed=self.landed,
            armable=commander.armed or not commander.not_armable(self._condition()),
            estimated=estimator.running,
            pos_ned_m=estimator.pos_ned_m,
            vel_ned_mps=estimator.vel_ned_mps,
            q_ned_from_frd=estimator.q_ned_from_frd,
            rates_frd_rps=estimator.rates_frd_rps,
            var_pos_ned_m2=estimator.var_pos_ned_m2,
            reset_counter=estimator.reset_counter,
            origin_deg=estimator.origin_deg,
            home_ned_m=self.home_ned_m,
            followed=self._followed,
            vel_followed_ned_mps=self._flight.vel_setpoint_ned_mps,
            fix=self._fix,
            fix_us=self._fix_us or 0,
            thrust=self._thrust,
            battery_v=battery.voltage_v,
            battery_a=battery.current_a,
            battery_used_mah=battery.used_mah,
            battery_remaining=battery.remaining,
            battery_level=commander.battery_level(battery.remaining),
        )
