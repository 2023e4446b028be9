"""A vehicle that is one point mass, with a simple estimate and controller.

It replaces rigid body, estimator, attitude control and mixer; the rest of the autopilot is the embedded autopilot's.
"""

from math import atan2, cos, hypot, sin, sqrt

from jezero.frames import Quat, Vec3, add, ned_from_geodetic, quat_from_euler, subtract, wrap_pi
from jezero.schemas.units import GRAVITY_MPS2
from jezero.services.autopilot.alignment import ALIGN_US, Fix
from jezero.services.autopilot.config import AutopilotConfig, EstimatorConfig
from jezero.services.autopilot.control import Kinematics, Setpoint, VelocityLoop
from jezero.services.autopilot.land_detector import CLIMB_SETPOINT_MIN_MPS, LandDetector
from jezero.services.autopilot.mixer import IDLE, STOPPED, Commands
from jezero.services.autopilot.multicopter import LIFTOFF_SPEED_MIN_MPS, SPOOLUP_TIME_S
from jezero.services.autopilot.reset_detector import ResetDetector

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

    def __init__(self, config: EstimatorConfig, point: Point, origin_deg: Vec3) -> None:
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

    def configure(self, config: EstimatorConfig) -> None:
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

    def __init__(self, config: AutopilotConfig, point: Point, estimate: PointEstimate) -> None:
        self.detector = LandDetector(config.land_detector)
        self._hover = config.control.mpc_thr_hover
        self._control = config.control
        self._point = point
        self._estimate = estimate
        self._loop = VelocityLoop(config.control)
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
        self.wanted_ned_mps2: Vec3 = (0.0, 0.0, GRAVITY_MPS2)

    def step(self, dt: float, setpoint: Setpoint, *, allow_takeoff: bool) -> Commands:
        """See `FlightController`."""
        at, detector, armed_s = self.kinematics, self.detector, self._armed_s + dt
        force_ned_mps2: Vec3 = (0.0, 0.0, -LIFT_OFF * GRAVITY_MPS2)
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

    def _turn(self, dt: float, yaw_rad: float, setpoint: Setpoint) -> None:
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
        wanted = self._hover * sqrt(n * n + e * e + d * d) / GRAVITY_MPS2
        self._thrust = min(wanted, self._limit)
        share = self._thrust / wanted if wanted > 0.0 else 0.0
        self.wanted_ned_mps2 = (share * n, share * e, share * d + GRAVITY_MPS2)
        return (self._thrust,) * 4
