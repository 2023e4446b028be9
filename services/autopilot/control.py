"""Cascade of the position, velocity, attitude and rate controllers."""

from math import hypot, pi, sqrt, tan

import msgspec

from jezero.base.frames import Vec3, add, norm, scale, wrap_pi
from jezero.base.vehicle_config import AirframeConfig, PlanetConfig, VehicleConfig
from jezero.services.autopilot.config import ControlConfig
from jezero.services.autopilot.mixer import IDLE, STOPPED, Commands, Mixer

Axes = tuple[float | None, float | None, float | None]
"""North, east, down; None: this quantity does not control the axis."""

FREE: Axes = (None, None, None)
ACC_FILTER_HZ = 5.0
"""Low-pass filter of the acceleration for the D term."""
RATE_INTEGRAL_LIMIT_RPS2 = 10.0
VELOCITY_INTEGRAL_LIMIT_MPS2 = 5.0
"""Greatest integral of the velocity loop on the Earth. It holds the vehicle in the wind by a tilt, so that its limit is
proportional to gravity."""


class ControlSetpoint(msgspec.Struct, frozen=True, gc=False):
    """Position, velocity and acceleration setpoints. Without yaw and yaw rate the heading stays as it is."""

    pos_ned_m: Axes = FREE
    vel_ned_mps: Axes = FREE
    acc_ned_mps2: Axes = FREE
    yaw_rad: float | None = None
    yaw_rate_rps: float | None = None

    @property
    def is_horizontally_free(self) -> bool:
        """Whether no quantity controls the horizontal motion."""
        return self.pos_ned_m[:2] == self.vel_ned_mps[:2] == self.acc_ned_mps2[:2] == (None, None)

    def shifted(self, step_ned_m: Vec3) -> "ControlSetpoint":
        """The same setpoint after a reset of the position estimate by `step_ned_m`."""
        n, e, d = (None if p is None else p + s for p, s in zip(self.pos_ned_m, step_ned_m, strict=True))
        return ControlSetpoint((n, e, d), self.vel_ned_mps, self.acc_ned_mps2, self.yaw_rad, self.yaw_rate_rps)


class Kinematics(msgspec.Struct, frozen=True, gc=False):
    """Estimated motion of the vehicle, for controllers and navigator."""

    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    acc_ned_mps2: Vec3
    yaw_rad: float


def approach_speed_mps(distance_m: float, gain: float, acc_mps2: float) -> float:
    """Speed towards a point: proportional to a short distance, otherwise for a constant deceleration."""
    near_m = acc_mps2 / (gain * gain)
    if distance_m <= near_m:
        return gain * distance_m
    return sqrt(acc_mps2 * (2.0 * distance_m - near_m))


def stopping_distance_m(speed_mps: float, gain: float, acc_mps2: float) -> float:
    """Distance at which `approach_speed_mps` equals the present speed."""
    near_mps = acc_mps2 / gain
    if speed_mps <= near_mps:
        return speed_mps / gain
    return (speed_mps * speed_mps / acc_mps2 + acc_mps2 / (gain * gain)) / 2.0


def stopping_point_ned_m(at: Kinematics, config: ControlConfig) -> Vec3:
    """Point where the vehicle comes to rest when it brakes now."""
    speed_mps = norm(at.vel_ned_mps)
    if speed_mps < 1e-6:
        return at.pos_ned_m
    ahead_m = stopping_distance_m(speed_mps, config.mpc_xy_p, config.mpc_acc_hor_mps2)
    return add(at.pos_ned_m, scale(at.vel_ned_mps, ahead_m / speed_mps))


class VelocityLoop:
    """Position and velocity controllers; their output is the specific force in NED."""

    def __init__(self, config: ControlConfig, planet: PlanetConfig) -> None:
        self._gravity_mps2 = planet.gravity_mps2
        self._integral_limit_mps2 = VELOCITY_INTEGRAL_LIMIT_MPS2 * planet.gravity_ratio
        self._force_max = planet.gravity_mps2 / config.mpc_thr_hover
        self.configure(config)
        self.vel_setpoint_ned_mps: Vec3 = (0.0, 0.0, 0.0)
        self.reset()

    def configure(self, config: ControlConfig) -> None:
        """Apply new settings at once."""
        self._config = config
        self._force_min = config.mpc_thr_min * self._force_max
        self._tan_tilt = tan(config.mpc_tiltmax_air_rad)

    def reset(self) -> None:
        self._integral = [0.0, 0.0, 0.0]
        self._acc_smooth = [0.0, 0.0, 0.0]

    def reset_downward_integral(self) -> None:
        """Remove the downward part of the integral, which a blocked descent has wound up."""
        self._integral[2] = min(0.0, self._integral[2])

    def velocity_setpoint(self, at: Kinematics, setpoint: ControlSetpoint) -> Vec3:
        """Velocity setpoint: output of the position controller plus the velocity of the setpoint, limited."""
        c = self._config
        position, velocity = setpoint.pos_ned_m, setpoint.vel_ned_mps
        n, e, d = (v or 0.0 for v in velocity)
        dn = 0.0 if position[0] is None else position[0] - at.pos_ned_m[0]
        de = 0.0 if position[1] is None else position[1] - at.pos_ned_m[1]
        away = hypot(dn, de)
        if away > 1e-9:
            pull = approach_speed_mps(away, c.mpc_xy_p, c.mpc_acc_hor_mps2) / away
            n, e = n + pull * dn, e + pull * de
        speed = hypot(n, e)
        if speed > c.mpc_xy_vel_max_mps:
            n, e = n * c.mpc_xy_vel_max_mps / speed, e * c.mpc_xy_vel_max_mps / speed
        if position[2] is not None:
            d += c.mpc_z_p * (position[2] - at.pos_ned_m[2])
        self.vel_setpoint_ned_mps = (n, e, max(-c.mpc_z_vel_max_up_mps, min(c.mpc_z_vel_max_dn_mps, d)))
        return self.vel_setpoint_ned_mps

    def specific_force(self, dt: float, at: Kinematics, setpoint: ControlSetpoint) -> Vec3:
        """(3,) specific force setpoint of the rotors in NED, m/s²; (0, 0, -g) in hover."""
        c = self._config
        vel = self.velocity_setpoint(at, setpoint)
        smooth = min(1.0, 2.0 * pi * ACC_FILTER_HZ * dt)
        error, acc_setpoint = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        for i in range(3):
            p, d = (c.mpc_z_vel_p_acc, c.mpc_z_vel_d_acc) if i == 2 else (c.mpc_xy_vel_p_acc, c.mpc_xy_vel_d_acc)
            self._acc_smooth[i] += smooth * (at.acc_ned_mps2[i] - self._acc_smooth[i])
            feedforward = setpoint.acc_ned_mps2[i] or 0.0
            if setpoint.pos_ned_m[i] is not None or setpoint.vel_ned_mps[i] is not None:
                error[i] = vel[i] - at.vel_ned_mps[i]
            acc_setpoint[i] = p * error[i] + self._integral[i] - d * (self._acc_smooth[i] - feedforward) + feedforward
        force = self._limit_force(acc_setpoint)
        saturated = (
            acc_setpoint[0] - force[0],
            acc_setpoint[1] - force[1],
            acc_setpoint[2] - (force[2] + self._gravity_mps2),
        )
        for i in range(3):
            p, gain = (c.mpc_z_vel_p_acc, c.mpc_z_vel_i_acc) if i == 2 else (c.mpc_xy_vel_p_acc, c.mpc_xy_vel_i_acc)
            integral = self._integral[i] + gain * (error[i] - 2.0 / p * saturated[i]) * dt
            self._integral[i] = max(-self._integral_limit_mps2, min(self._integral_limit_mps2, integral))
        return force

    def _limit_force(self, acc_ned_mps2: list[float]) -> Vec3:
        """Limit thrust and tilt. The vertical part has priority; the horizontal part is shortened."""
        n, e, d = acc_ned_mps2
        d = max(-self._force_max, min(-self._force_min, d - self._gravity_mps2))
        horizontal_max = min(-d * self._tan_tilt, sqrt(max(0.0, self._force_max * self._force_max - d * d)))
        size = hypot(n, e)
        if size > horizontal_max:
            n, e = n * horizontal_max / size, e * horizontal_max / size
        return (n, e, d)


class AttitudeLoop:
    """Attitude and rate controllers; their output is torque. Tilt has priority over heading, which has its own gain."""

    def __init__(self, config: ControlConfig, airframe: AirframeConfig) -> None:
        self._inertia = airframe.inertia_frd_kgm2
        self.configure(config)
        self.reset()

    def configure(self, config: ControlConfig) -> None:
        """Apply new settings at once."""
        self._config = c = config
        rollpitch, yaw = (c.rollpitchrate_p_1ps, c.rollpitchrate_i_1ps2), (c.yawrate_p_1ps, c.yawrate_i_1ps2)
        self._gains = (rollpitch, rollpitch, yaw)

    def reset(self) -> None:
        self._integral = [0.0, 0.0, 0.0]

    def torques(
        self,
        dt: float,
        rates_frd_rps: Vec3,
        R_ned_from_frd: tuple[float, ...],
        up_ned: Vec3,
        yaw_rate_rps: float,
    ) -> Vec3:
        """(3,) torques in body FRD, N m.

        Args:
            R_ned_from_frd: rows one after the other.
            up_ned: (3,) unit vector, setpoint of the thrust direction.
            yaw_rate_rps: rate setpoint about the vertical.
        """
        c, r, (un, ue, ud) = self._config, R_ned_from_frd, up_ned
        ux = r[0] * un + r[3] * ue + r[6] * ud
        uy = r[1] * un + r[4] * ue + r[7] * ud
        uz = r[2] * un + r[5] * ue + r[8] * ud
        # The shortest turn from (0, 0, -1) to u is about (u_y, -u_x, 0) by the angle whose cosine is -u_z.
        # The rate setpoint is proportional to 2 sin(angle / 2) as in quaternion controllers: sin(angle) * stretch.
        stretch = sqrt(2.0 / max(0.02, 1.0 - uz))
        limit = c.mc_rollpitchrate_max_rps
        rate_setpoint = (
            max(-limit, min(limit, c.mc_rollpitch_p * stretch * uy)) + r[6] * yaw_rate_rps,
            max(-limit, min(limit, -c.mc_rollpitch_p * stretch * ux)) + r[7] * yaw_rate_rps,
            r[8] * yaw_rate_rps,
        )
        torque = [0.0, 0.0, 0.0]
        for i in range(3):
            error = rate_setpoint[i] - rates_frd_rps[i]
            p, gain = self._gains[i]
            torque[i] = self._inertia[i] * (p * error + self._integral[i])
            integral = self._integral[i] + gain * error * dt
            self._integral[i] = max(-RATE_INTEGRAL_LIMIT_RPS2, min(RATE_INTEGRAL_LIMIT_RPS2, integral))
        return (torque[0], torque[1], torque[2])


class CascadeController:
    """The whole cascade. `step_outer` runs the velocity loop at a lower rate, `step_inner` the rest per IMU sample."""

    def __init__(self, config: ControlConfig, vehicle: VehicleConfig) -> None:
        self._config = config
        self._velocity = VelocityLoop(config, vehicle.planet)
        self._attitude = AttitudeLoop(config, vehicle.airframe)
        self._mixer = Mixer(vehicle, config.mpc_thr_hover)
        self._mass_kg = vehicle.airframe.mass_kg
        self._gravity_mps2, self._weight_n = vehicle.planet.gravity_mps2, vehicle.weight_n
        self.reset(0.0)

    def configure(self, config: ControlConfig) -> None:
        """Apply new settings at once."""
        self._config = config
        self._velocity.configure(config)
        self._attitude.configure(config)

    def reset(self, yaw_rad: float) -> None:
        """Reset all controllers, as on the ground and when disarmed."""
        self._velocity.reset()
        self._attitude.reset()
        self._force_setpoint_ned_mps2: Vec3 = (0.0, 0.0, 0.0)
        self._yaw_rad = yaw_rad
        self._yaw_rate_rps = 0.0
        self._ramp = 0.0
        self.thrust_hover_ratio = 0.0

    @property
    def vel_setpoint_ned_mps(self) -> Vec3:
        return self._velocity.vel_setpoint_ned_mps

    def velocity_setpoint(self, at: Kinematics, setpoint: ControlSetpoint) -> Vec3:
        return self._velocity.velocity_setpoint(at, setpoint)

    @property
    def up_setpoint_ned(self) -> Vec3:
        """(3,) unit vector, setpoint of the body's up axis."""
        fn, fe, fd = self._force_setpoint_ned_mps2
        size = sqrt(fn * fn + fe * fe + fd * fd)
        return (fn / size, fe / size, fd / size) if size > 1e-6 else (0.0, 0.0, -1.0)

    def leave_contact(self) -> None:
        """End the thrust limit of a contact at once, so that the vehicle can get away from it."""
        self._ramp = 1.0
        self._velocity.reset_downward_integral()

    def step_outer(
        self, dt: float, at: Kinematics, setpoint: ControlSetpoint, *, airborne: bool, in_contact: bool = False
    ) -> None:
        """Run the position and velocity loops. On the ground only the thrust ramps up, level and without integrals.

        Args:
            in_contact: whether the land detector has contact, which makes the thrust ramp down quickly.
        """
        c = self._config
        if setpoint.yaw_rad is not None:
            self._yaw_rad = setpoint.yaw_rad
        rate = setpoint.yaw_rate_rps or 0.0
        if setpoint.yaw_rad is None and rate != 0.0:
            self._yaw_rad = wrap_pi(at.yaw_rad + rate * dt)
        turn = c.mc_yaw_p * wrap_pi(self._yaw_rad - at.yaw_rad) + rate
        self._yaw_rate_rps = max(-c.mc_yawrate_max_rps, min(c.mc_yawrate_max_rps, turn))
        if airborne:
            self._force_setpoint_ned_mps2 = self._velocity.specific_force(dt, at, setpoint)
        else:
            self._velocity.reset()
            self._attitude.reset()
            self._yaw_rad, self._yaw_rate_rps = at.yaw_rad, 0.0
            self._force_setpoint_ned_mps2 = (0.0, 0.0, -1.3 * self._gravity_mps2)
        ramp = dt / c.mpc_tko_ramp_t_s
        if in_contact:
            self._ramp = max(0.0, min(self._ramp, self.thrust_hover_ratio * c.mpc_thr_hover) - 2.0 * ramp)
        else:
            self._ramp = min(1.0, self._ramp + ramp)

    def step_inner(self, dt: float, rates_frd_rps: Vec3, R_ned_from_frd: tuple[float, ...]) -> Commands:
        """Run the attitude and rate loops and the mixer; returns the (4,) motor commands."""
        r, (fn, fe, fd) = R_ned_from_frd, self._force_setpoint_ned_mps2
        torques = self._attitude.torques(dt, rates_frd_rps, r, self.up_setpoint_ned, self._yaw_rate_rps)
        along = -(fn * r[2] + fe * r[5] + fd * r[8])
        thrust = max(self._config.mpc_thr_min * self._mixer.thrust_full_n, along * self._mass_kg)
        thrust = min(thrust, self._ramp * self._mixer.thrust_full_n)
        self.thrust_hover_ratio = thrust / self._weight_n
        return self._mixer.commands(thrust, torques)

    def idle(self, yaw_rad: float) -> Commands:
        """Reset all controllers; returns commands of idling rotors."""
        self.reset(yaw_rad)
        return IDLE

    def stop(self, yaw_rad: float) -> Commands:
        self.reset(yaw_rad)
        return STOPPED
