"""Forces of a quadrotor's motors and of the air on its body."""

from collections.abc import Sequence
from math import exp, sqrt

from jezero.base.frames import Vec3, quat_conjugate, quat_rotate, subtract
from jezero.base.vehicle_config import VehicleConfig
from jezero.services.simulator.body import BodyState
from jezero.services.simulator.config import SimulatorConfig

GROUND_EFFECT_MAX = 1.3


def ground_effect(height_rotor_m: float, radius_rotor_m: float) -> float:
    """Factor on the thrust near the ground, 1 far from it and at most 1.3.

    Source: Cheeseman and Bennett 1955, 1 / (1 - (R / 4z)^2).
    """
    ratio = radius_rotor_m / (4.0 * max(height_rotor_m, 0.5 * radius_rotor_m))
    return min(1.0 / (1.0 - ratio * ratio), GROUND_EFFECT_MAX)


class Uav:
    """Rotors with first-order lag, thrust and reaction torque, rotor drag and body drag.

    Thrust is proportional to the command once the rotors have caught up: their speed goes to the command's root.

    Args:
        dt_s: duration of a step.
    """

    def __init__(self, config: SimulatorConfig, vehicle: VehicleConfig, dt_s: float) -> None:
        uav, airframe = config.uav, vehicle.airframe
        self._follow = 1.0 - exp(-dt_s / uav.tau_motor_s)
        self._thrust_max_n = uav.thrust_to_weight * vehicle.weight_n / 4.0
        self._rotors = tuple(
            (forward, right, moment)
            for (forward, right), moment in zip(airframe.pos_rotors_frd_m, airframe.moment_per_thrust_m, strict=True)
        )
        speed_hover = sqrt(1.0 / uav.thrust_to_weight)
        self._drag_rotors = airframe.drag_rotors_nspm / (4.0 * speed_hover)
        self._drag_side = 0.5 * vehicle.planet.density_air_kgpm3 * airframe.drag_area_side_m2
        self._drag_top = 0.5 * vehicle.planet.density_air_kgpm3 * airframe.drag_area_top_m2
        self._damping = uav.damping_rates_nms
        self._radius_m = airframe.radius_rotor_m
        self._speeds = [0.0, 0.0, 0.0, 0.0]

    @property
    def speeds(self) -> Sequence[float]:
        """(4,) rotor speeds relative to full speed."""
        return self._speeds

    def stop(self) -> None:
        """Rotors at rest."""
        self._speeds = [0.0, 0.0, 0.0, 0.0]

    def step(
        self, commands: Sequence[float], body: BodyState, wind_ned_mps: Vec3, height_rotor_m: float
    ) -> tuple[Vec3, Vec3]:
        """Advance the rotors by one step.

        Args:
            commands: (4,) in 0..1, in the autopilot's order.
            body: present state.
            wind_ned_mps: velocity of the air.
            height_rotor_m: height of the rotor plane above the surface below it.
        Returns:
            force_ned_n and torque_frd_nm on the centre of mass, gravity not included.
        """
        scale_n = self._thrust_max_n * ground_effect(height_rotor_m, self._radius_m)
        speeds, follow = self._speeds, self._follow
        thrust_n = roll_nm = pitch_nm = yaw_nm = speed_sum = 0.0
        for i, (forward, right, moment) in enumerate(self._rotors):
            speed = speeds[i] + follow * (sqrt(commands[i]) - speeds[i])
            speeds[i] = speed
            speed_sum += speed
            one_n = scale_n * speed * speed
            thrust_n += one_n
            roll_nm -= right * one_n
            pitch_nm += forward * one_n
            yaw_nm += moment * one_n
        ax, ay, az = quat_rotate(quat_conjugate(body.q_ned_from_frd), subtract(body.vel_ned_mps, wind_ned_mps))
        airspeed = sqrt(ax * ax + ay * ay + az * az)
        side = self._drag_side * airspeed + self._drag_rotors * speed_sum
        force_frd_n = (-side * ax, -side * ay, -self._drag_top * airspeed * az - thrust_n)
        damping = self._damping
        torque_frd_nm = (
            roll_nm - damping * body.rates_frd_rps[0],
            pitch_nm - damping * body.rates_frd_rps[1],
            yaw_nm - damping * body.rates_frd_rps[2],
        )
        return quat_rotate(body.q_ned_from_frd, force_frd_n), torque_frd_nm
