"""The vehicle: the autopilot without its links. Takes measurements and commands; returns motor commands."""

from dataclasses import replace
from math import inf, sqrt
from typing import Protocol

from jezero.base.detectors import SLOPE_SINE_MAX, TILT_SINE_MAX, FrozenSensorDetector
from jezero.base.frames import Quat, Vec3, subtract
from jezero.base.vehicle_config import HeadingSource
from jezero.services.autopilot.alignment import FIX_AGE_MAX_US, Fix
from jezero.services.autopilot.battery import BatteryModel
from jezero.services.autopilot.commander import Commander, CommanderState
from jezero.services.autopilot.config import AutopilotConfig, StateEstimatorConfig
from jezero.services.autopilot.control import Axes, ControlSetpoint, Kinematics, stopping_point_ned_m
from jezero.services.autopilot.gimbal import NOBODY, GimbalManager
from jezero.services.autopilot.hil import RangeSample, SensorSample
from jezero.services.autopilot.land_detector import LandDetector
from jezero.services.autopilot.mixer import STOPPED, Commands
from jezero.services.autopilot.modes import Mode
from jezero.services.autopilot.navigator import Navigator
from jezero.services.autopilot.parameters import Parameters, Value
from jezero.services.autopilot.streams import Snapshot

STEP_MAX_S = 0.05
SWAPPED_BELOW = 0.5
"""A battery with more charge, as a fraction of the capacity, is not changed."""
COMMANDER_PERIOD_US = 10_000
"""Source: PX4's COMMANDER_MONITORING_INTERVAL."""
SENSOR_TIMEOUT_S = 1.0
"""A sensor without data for this time forbids arming."""
ARM_TILT_MAX_RAD = 0.52
"""A vehicle that is tilted further can't be armed."""
GCS_HEARTBEAT_TIMEOUT_S = 2.5
"""The connection to a ground station is lost this long after its last heartbeat. Source: PX4's HEARTBEAT_TIMEOUT_US."""

PUSH_AGE_MAX_S = 0.2
"""A setpoint this old may come from a program that has stopped, and can't judge what the vehicle touches."""


# -- the interfaces of the two replaceable parts ---------------------------------------------------------
#
# `StateEstimator` and `MulticopterController` implement them with sensors and motors, the fault campaign's point mass
# without.


class StateEstimate(Protocol):
    """Estimated state of the vehicle. It is updated with the measurements of the sensors as they arrive."""

    @property
    def running(self) -> bool:
        """Whether the estimate has started."""

    @property
    def invalid_reason(self) -> str:
        """Why the estimate is invalid, as a text for people; empty when it is valid."""

    @property
    def pos_ned_m(self) -> Vec3: ...
    @property
    def vel_ned_mps(self) -> Vec3: ...
    @property
    def q_ned_from_frd(self) -> Quat: ...
    @property
    def rates_frd_rps(self) -> Vec3: ...
    @property
    def yaw_rad(self) -> float: ...
    @property
    def tilt_rad(self) -> float: ...

    @property
    def var_pos_ned_m2(self) -> Vec3:
        """(3,) variance of the position, NED."""

    @property
    def origin_deg(self) -> Vec3 | None: ...
    @property
    def reset_counter(self) -> int: ...

    @property
    def reset_offset_ned_m(self) -> Vec3:
        """Sum of the steps by which resets moved the position."""

    def configure(self, config: StateEstimatorConfig) -> None: ...
    def on_imu(self, t_us: int, acc_frd_mps2: Vec3, gyro_frd_rps: Vec3) -> None: ...
    def on_fix(self, fix: Fix) -> None: ...
    def on_baro(self, altitude_pressure_m: float) -> None: ...
    def on_mag(self, field_frd_gauss: Vec3) -> None: ...

    def on_landed(self, landed: bool) -> None:
        """Update the state of the land detector."""


class FlightController(Protocol):
    """Follows setpoints and detects the landing."""

    @property
    def detector(self) -> LandDetector: ...
    @property
    def kinematics(self) -> Kinematics: ...

    @property
    def vel_setpoint_ned_mps(self) -> Vec3:
        """(3,) velocity setpoint after position control and limits."""

    def contact_lean_ned(self, sine_max: float) -> tuple[float, float] | None:
        """North and east part of the body's up axis while something on one side tilts the vehicle, otherwise None.

        Args:
            sine_max: sine of the largest tilt that doesn't count.
        """

    def configure(self, config: AutopilotConfig) -> None: ...

    def leave_contact(self) -> None:
        """Set the state to flying and allow full thrust, to get away from a contact."""

    def stop(self) -> Commands:
        """Reset all controllers of a disarmed vehicle; returns commands of stopped motors."""

    def step(self, dt: float, setpoint: ControlSetpoint, *, allow_takeoff: bool) -> Commands:
        """Run the controllers of an armed vehicle; a climb setpoint makes it take off only if `allow_takeoff`."""


# -- the vehicle -----------------------------------------------------------------------------------------


class AutopilotVehicle:
    """One vehicle in the simulator, from the first sensor sample to a restart.

    Attributes:
        t_us: time stamp of the newest sensor sample.
        gimbal: of the simulated camera.
        commander: arming and modes.
        estimator: the estimate of the motion.
        landed: state of the land detector.
    """

    def __init__(
        self,
        parameters: Parameters,
        system_id: int,
        estimator: StateEstimate,
        flight_controller: FlightController,
        heading_by: HeadingSource = "magnetometer",
    ) -> None:
        config = parameters.config
        self._parameters = parameters
        self._system_id = system_id
        self.t_us = 0
        self.estimator = estimator
        self.commander = Commander(config.commander, config.failsafe)
        self._config = config
        self._flight_controller = flight_controller
        self._navigator = Navigator(config.navigator, config.control)
        self._battery = BatteryModel(parameters.battery, config.charge_at_start, config.control.mpc_thr_hover)
        self._fix: Fix | None = None
        self._fix_us: int | None = None
        self._heading_by = heading_by
        self._yaw_us: int | None = None
        self.newest_range: RangeSample | None = None
        self.gimbal = GimbalManager()
        self._valid_fix_us: int | None = None
        self._mag_us: int | None = None
        self._baro_us: int | None = None
        self._gnss_freeze = FrozenSensorDetector()
        self._mag_freeze = FrozenSensorDetector()
        self._baro_freeze = FrozenSensorDetector()
        self._gcs_heartbeat_us: int | None = None
        self._offboard = ControlSetpoint()
        self._offboard_us: int | None = None
        self._active_setpoint: ControlSetpoint | None = None
        self._thrust = 0.0
        self._stood_s: float | None = None
        """Time since the last flight; None before the first one."""
        self._commander_due_us = 0
        self._mode = self.commander.mode
        self._reset_offset_ned_m: Vec3 = (0.0, 0.0, 0.0)

    @property
    def landed(self) -> bool:
        return self._flight_controller.detector.landed

    @property
    def home_ned_m(self) -> Vec3:
        """Position of the last arming; before that, of the start of the estimator."""
        return self._navigator.home_ned_m

    # -- sensors -------------------------------------------------------------------------------------------

    def on_fix(self, fix: Fix) -> None:
        """Update the estimate with a GNSS fix. A frozen fix, or one of another time, is marked as invalid."""
        frozen = self._gnss_freeze.is_frozen((fix.position_deg, fix.vel_ned_mps))
        if frozen or (fix.t_us and abs(self.t_us - fix.t_us) > FIX_AGE_MAX_US):
            fix = replace(fix, valid=False)
        self._fix, self._fix_us = fix, self.t_us
        if fix.valid:
            self._valid_fix_us = self.t_us
        if fix.valid and fix.yaw_rad is not None:
            self._yaw_us = self.t_us
        self.estimator.on_fix(fix)
        self._apply_position_reset()

    def step(self, sample: SensorSample) -> Commands:
        """Advance to a sensor sample; returns the (4,) motor commands."""
        dt = min((sample.t_us - self.t_us) * 1e-6, STEP_MAX_S) if self.t_us else 0.0
        self.t_us = sample.t_us
        estimator = self.estimator
        if sample.imu is not None:
            estimator.on_imu(sample.t_us, *sample.imu)
        field_frd_gauss, altitude_m = sample.field_frd_gauss, sample.altitude_pressure_m
        if field_frd_gauss is not None and not self._mag_freeze.is_frozen(field_frd_gauss):
            self._mag_us = sample.t_us
            estimator.on_mag(field_frd_gauss)
        if altitude_m is not None and not self._baro_freeze.is_frozen(altitude_m):
            self._baro_us = sample.t_us
            estimator.on_baro(altitude_m)
        self._apply_position_reset()
        if self.t_us >= self._commander_due_us:
            self._commander_due_us = self.t_us + COMMANDER_PERIOD_US
            estimator.on_landed(self.landed)
            self.commander.update(self._state())
            self._activate_mode()
        commands = STOPPED
        self._active_setpoint = None
        if not self.commander.armed:
            commands = self._flight_controller.stop()
        elif estimator.running:
            commands = self._fly(dt)
        self._battery.step(dt, commands)
        self._swap_battery(dt)
        self._thrust = sum(commands) / 4.0
        return commands

    def _swap_battery(self, dt: float) -> None:
        """Put in a full battery after a flight, as a person does, if that is set."""
        if self.commander.armed:
            self._stood_s = 0.0
        elif self._stood_s is not None and self._config.battery_swap_s:
            self._stood_s += dt
            if self._stood_s >= self._config.battery_swap_s and self._battery.remaining < SWAPPED_BELOW:
                self._battery.swap()

    def _fly(self, dt: float) -> Commands:
        commander = self.commander
        mode = commander.mode
        at = self._flight_controller.kinematics
        lean_max = SLOPE_SINE_MAX if self._is_pushed_down else TILT_SINE_MAX
        contact_lean_ned = self._flight_controller.contact_lean_ned(lean_max)
        if contact_lean_ned is not None and self._navigator.leave_contact(mode, at, contact_lean_ned, self.t_us):
            self._flight_controller.leave_contact()
        if mode is Mode.OFFBOARD:
            setpoint = self._offboard
        else:
            if not self.landed and self._navigator.is_takeoff_done(mode, at):
                commander.switch(Mode.HOLD)
                self._mode = Mode.HOLD  # no mode activation, so that hold mode keeps the point of the takeoff
            setpoint = self._navigator.setpoint(commander.mode, at, self.t_us)
        allow_takeoff = mode is Mode.OFFBOARD or (mode is Mode.TAKEOFF and self._navigator.requires_takeoff(at))
        commands = self._flight_controller.step(dt, setpoint, allow_takeoff=allow_takeoff)
        if not self.landed:
            self._active_setpoint = setpoint
        return commands

    @property
    def _is_pushed_down(self) -> bool:
        """Whether a program commands the descent just now: it judges what the vehicle touches, and may use a slope."""
        if self.commander.mode is not Mode.OFFBOARD or self._offboard_us is None:
            return False
        down_mps = self._offboard.vel_ned_mps[2]
        fresh = (self.t_us - self._offboard_us) * 1e-6 < PUSH_AGE_MAX_S
        return fresh and down_mps is not None and down_mps > 0.0

    def _apply_position_reset(self) -> None:
        """Move stored setpoints and points along with a reset of the position estimate."""
        offset = self.estimator.reset_offset_ned_m
        if offset != self._reset_offset_ned_m:
            step = subtract(offset, self._reset_offset_ned_m)
            self._reset_offset_ned_m = offset
            self._navigator.on_position_reset(step)
            self._offboard = self._offboard.shifted(step)

    def _activate_mode(self) -> None:
        """Activate a new mode in the navigator, at the point where the vehicle comes to rest."""
        if self.commander.mode is not self._mode:
            self._mode = self.commander.mode
            at = self._flight_controller.kinematics
            self._navigator.activate(self._mode, at, stopping_point_ned_m(at, self._config.control), self.t_us)

    # -- commands; each returns the reason of a refusal, or "" ---------------------------------------------

    def arm(self) -> str:
        """Arm, and set home to the present position."""
        was_armed = self.commander.armed
        reason = self.commander.arm(self._state())
        if self.commander.armed and not was_armed:
            self._navigator.home_ned_m = self.estimator.pos_ned_m
            self._navigator.activate(
                self._mode, self._flight_controller.kinematics, self.estimator.pos_ned_m, self.t_us
            )
        return reason

    def disarm(self, *, force: bool) -> str:
        reason = self.commander.disarm(self._state(), force=force)
        self._activate_mode()
        return reason

    def set_mode(self, mode: Mode) -> str:
        reason = self.commander.set_mode(mode, self._state())
        self._activate_mode()
        return reason

    def take_off(self, point_ned_m: Axes) -> str:
        """Enter takeoff mode to a point. A None keeps the horizontal position; a height of None is MIS_TAKEOFF_ALT."""
        if reason := self.set_mode(Mode.TAKEOFF):
            return reason
        down = point_ned_m[2]
        if down is not None and down > self.estimator.pos_ned_m[2]:
            self.commander.add_status_text(2, "Already higher than takeoff altitude")
        self._navigator.climb_to(self._flight_controller.kinematics, point_ned_m)
        return ""

    def reposition(self, point_ned_m: Vec3, yaw_rad: float | None) -> str:
        """Enter hold mode at another point; a heading of None stays as it is."""
        if self.landed:
            return "the vehicle is on the ground"
        if reason := self.set_mode(Mode.HOLD):
            return reason
        self._navigator.go_to(point_ned_m, yaw_rad)
        return ""

    def on_offboard_setpoint(self, setpoint: ControlSetpoint) -> None:
        """Store a setpoint for offboard mode."""
        self._offboard, self._offboard_us = setpoint, self.t_us

    def on_gcs_heartbeat(self) -> None:
        self._gcs_heartbeat_us = self.t_us

    def set_parameter(self, name: str, value: Value) -> bool:
        """Set a parameter and apply it; returns whether it was accepted, see `Parameters.set`."""
        done = self._parameters.set(name, value)
        config = self._parameters.config
        if config is not self._config:
            self._config = config
            self.commander.configure(config.commander, config.failsafe)
            self.estimator.configure(config.estimator)
            self._flight_controller.configure(config)
            self._navigator.configure(config.navigator, config.control)
            self._battery.configure(self._parameters.battery)
        return done

    # -- state ---------------------------------------------------------------------------------------------

    def _state(self) -> CommanderState:
        return CommanderState(
            t_us=self.t_us,
            arming_refusal="" if self.commander.armed else self._sensor_refusal(),
            position_invalid_reason=self._position_invalid_reason(),
            offboard_setpoint_age_s=self._age_s(self._offboard_us),
            landed=self.landed,
            tilt_rad=self.estimator.tilt_rad,
            gcs_lost_s=max(0.0, self._age_s(self._gcs_heartbeat_us) - GCS_HEARTBEAT_TIMEOUT_S),
            battery_remaining=self._battery.remaining,
        )

    def _position_invalid_reason(self) -> str:
        estimator, c = self.estimator, self._config.failsafe
        if not estimator.running:
            return estimator.invalid_reason
        north_m2, east_m2, _ = estimator.var_pos_ned_m2
        variance = north_m2 + east_m2
        if variance > c.com_pos_fs_eph_m * c.com_pos_fs_eph_m:
            return f"the position is uncertain by {sqrt(variance):.0f} m"
        age_s = self._age_s(self._valid_fix_us)
        return f"no GNSS fix for {age_s:.0f} s" if age_s > c.ekf2_noaid_tout_s else ""

    def _sensor_refusal(self) -> str:
        """Why sensors and estimate forbid arming, as a text for people; "" when they allow it."""
        if self.t_us == 0:
            return "no sensor data"
        if invalid_reason := self.estimator.invalid_reason:
            return invalid_reason
        by_gnss = self._heading_by == "gnss"
        heading = ("GNSS heading", self._yaw_us) if by_gnss else ("magnetometer", self._mag_us)
        ages = (("GNSS", self._fix_us), heading, ("barometer", self._baro_us))
        for name, last_us in ages:
            if self._age_s(last_us) > SENSOR_TIMEOUT_S:
                return f"no {name} data for {self._age_s(last_us):.1f} s"
        if self.estimator.tilt_rad > ARM_TILT_MAX_RAD:
            return "the vehicle is tilted too much"
        return ""

    def _age_s(self, last_us: int | None) -> float:
        return inf if last_us is None else (self.t_us - last_us) * 1e-6

    def snapshot(self) -> Snapshot:
        """State of the vehicle for telemetry."""
        estimator, commander, battery = self.estimator, self.commander, self._battery
        return Snapshot(
            system_id=self._system_id,
            t_us=self.t_us,
            armed=commander.armed,
            failsafe=commander.failsafe,
            custom_mode=commander.mode.custom_mode,
            landed=self.landed,
            armable=commander.armed or not commander.arming_refusal(self._state()),
            estimate_valid=estimator.running,
            pos_ned_m=estimator.pos_ned_m,
            vel_ned_mps=estimator.vel_ned_mps,
            q_ned_from_frd=estimator.q_ned_from_frd,
            rates_frd_rps=estimator.rates_frd_rps,
            var_pos_ned_m2=estimator.var_pos_ned_m2,
            reset_counter=estimator.reset_counter,
            origin_deg=estimator.origin_deg,
            home_ned_m=self.home_ned_m,
            has_magnetometer=self._heading_by == "magnetometer",
            setpoint=self._active_setpoint,
            vel_setpoint_ned_mps=self._flight_controller.vel_setpoint_ned_mps,
            fix=self._fix,
            fix_us=self._fix_us or 0,
            newest_range=self.newest_range,
            gimbal=None if self.gimbal.controller == NOBODY else self.gimbal,
            thrust=self._thrust,
            battery_v=battery.voltage_v,
            battery_a=battery.current_a,
            battery_used_mah=battery.used_mah,
            battery_remaining=battery.remaining,
            battery_level=commander.battery_level(battery.remaining),
        )
