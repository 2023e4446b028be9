"""The action `fly_velocity`: follow the newest velocity command of the goal's client.

The commands move a reference point, which the vehicle follows: with limited speed and acceleration, only as far as the
walls around it allow (`walls`), and no faster than the vehicle comes along. Without commands the reference comes to
rest, and the vehicle hovers there.
"""

from functools import partial
from math import cos, hypot, sin

from jezero.base.frames import Vec3, add, dot, norm, scale, subtract, wrap_pi, z_ned_m
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.commands import Phase, VelocityCommand
from jezero.schemas.goals import FlyVelocityGoal, VelocityFeedback, VelocityResult
from jezero.schemas.state import Status
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.fly_velocity.config import FlyVelocityConfig
from jezero.services.actions.fly_velocity.walls import held_back, walls
from jezero.services.actions.motion.behaviour import Done, Move, Plan, Refusal, VehicleState
from jezero.services.actions.motion.limits import speed_refusal
from jezero.services.actions.motion.tracking import ZERO

STEP_MAX_S = 0.1
"""A server that was frozen goes on where it was instead of jumping ahead."""
LEAD_M, LEAD_S = 1.0, 0.5
"""The reference waits when it is more than LEAD_M + LEAD_S * speed ahead of the vehicle."""
LEAD_GAIN_1PS = 4.0
CLIMB_GAIN_1PS, CLIMB_MAX_MPS = 1.0, 1.0
"""Speed at which a vehicle that is too near to the ground climbs, per missing height, and its greatest value."""
REST_MPS, REST_RPS = 0.02, 0.02


class FlyVelocity:
    """Follows velocity commands.

    Args:
        speed_max_mps: greatest horizontal speed.
    """

    def __init__(
        self, speed_max_mps: float, config: FlyVelocityConfig, vehicle: VehicleConfig, t_ns: int, state: VehicleState
    ) -> None:
        self._speed_max_mps = speed_max_mps
        self._config = config
        self._limits = vehicle.limits
        self._height_altimeter_m = vehicle.height_altimeter_m
        self._t_ns = t_ns
        self._commanded_ns = t_ns
        """Time of the last command; before the first one that of the start."""
        self._pos_ned_m, self._vel_ned_mps = state.pos_uav_ned_m, ZERO
        self._yaw_rad, self._yaw_rate_rps = state.yaw_rad, 0.0
        self._z_start_ned_m = state.pos_uav_ned_m[2]
        self._limited_by = ""

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        dt_s = min(max((t_ns - self._t_ns) / NS_PER_S, 0.0), STEP_MAX_S)
        self._t_ns = t_ns
        command = state.velocity_command
        if command is not None:
            self._commanded_ns = max(self._commanded_ns, command.t_ns)
        silent_s = (t_ns - self._commanded_ns) / NS_PER_S
        age_max_ns = int(self._config.command_age_max_s * NS_PER_S)
        follows = command is not None and t_ns - command.t_ns <= age_max_ns and not command.is_last
        before_mps = self._vel_ned_mps
        self._turn(command if follows else None, dt_s)
        self._advance(command if follows else None, dt_s, state)
        if command is not None and command.is_last and self._rests:
            return Done("succeeded", hover_pos_ned_m=self._pos_ned_m)
        if silent_s > self._config.silence_max_s:
            reason = f"no velocity command for {silent_s:.0f} s: its client has stopped sending them"
            return Done("aborted", reason, hover_pos_ned_m=self._pos_ned_m)
        change_mps2 = scale(subtract(self._vel_ned_mps, before_mps), 1.0 / dt_s) if dt_s > 0.0 else ZERO
        feedback = VelocityFeedback(
            pos_uav_ned_m=add(state.pos_uav_ned_m, state.shift_ned_m),
            follows=follows,
            limited_by=self._limited_by,
            refused=state.velocity_refusal,
        )
        return Move(
            Phase.ACTION,
            feedback,
            self._pos_ned_m,
            self._vel_ned_mps,
            _shortened(change_mps2, self._config.accel_mps2),
            self._yaw_rad,
            self._yaw_rate_rps,
        )

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        """The vehicle's position: where the commands lead is not known."""
        return (state.pos_uav_ned_m, state.pos_uav_ned_m)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> VelocityResult:
        return VelocityResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m)

    @property
    def _rests(self) -> bool:
        return norm(self._vel_ned_mps) < REST_MPS and abs(self._yaw_rate_rps) < REST_RPS

    def _turn(self, command: VelocityCommand | None, dt_s: float) -> None:
        """Turn the reference's heading by the command, or towards rest."""
        most_rps, change_rps = self._config.yaw_rate_max_rps, self._config.yaw_accel_rps2 * dt_s
        wanted_rps = 0.0 if command is None else min(max(command.yaw_rate_rps, -most_rps), most_rps)
        self._yaw_rate_rps += min(max(wanted_rps - self._yaw_rate_rps, -change_rps), change_rps)
        self._yaw_rad = wrap_pi(self._yaw_rad + self._yaw_rate_rps * dt_s)

    def _advance(self, command: VelocityCommand | None, dt_s: float, state: VehicleState) -> None:
        """Move the reference by the command, or towards rest."""
        z_low_ned_m, low_name = self._lowest(state)
        north, east, down = wanted = self._wanted(command)
        missing_m = self._pos_ned_m[2] + state.shift_ned_m[2] - z_low_ned_m
        if missing_m > 0.0 and low_name:
            down = min(down, -min(CLIMB_GAIN_1PS * missing_m, CLIMB_MAX_MPS))
        change_mps = self._config.accel_mps2 * dt_s
        now_n, now_e, now_d = self._vel_ned_mps
        step_n, step_e, _ = _shortened((north - now_n, east - now_e, 0.0), change_mps)
        step_d = min(max(down - now_d, -change_mps), change_mps)
        vel = self._with_vehicle((now_n + step_n, now_e + step_e, now_d + step_d), state)
        reach_m = norm(vel) ** 2 / self._config.accel_mps2 + LEAD_M
        place_ned_m = add(self._pos_ned_m, state.shift_ned_m)
        near = list(walls(place_ned_m, reach_m, state.fence, self._limits, z_low_ned_m, low_name or self._low_limit))
        self._vel_ned_mps, limited_by = held_back(vel, near, self._config.accel_mps2)
        # The wall that the commands lead to is named as long as they do, also when the vehicle rests in front of it.
        self._limited_by = limited_by or held_back(wanted, near, self._config.accel_mps2)[1]
        self._pos_ned_m = add(self._pos_ned_m, scale(self._vel_ned_mps, dt_s))

    def _wanted(self, command: VelocityCommand | None) -> Vec3:
        """The commanded velocity in NED, within the goal's speeds."""
        if command is None:
            return ZERO
        forward, right = command.forward_mps, command.right_mps
        part = min(1.0, self._speed_max_mps / max(hypot(forward, right), 1e-9))
        c, s = cos(self._yaw_rad), sin(self._yaw_rad)
        up = min(max(command.up_mps, -self._config.speed_down_mps), self._config.speed_up_mps)
        return part * (c * forward - s * right), part * (s * forward + c * right), z_ned_m(up)

    def _with_vehicle(self, vel_ned_mps: Vec3, state: VehicleState) -> Vec3:
        """The velocity, slowed down while it leads away from a vehicle that has fallen behind."""
        lead_ned_m = subtract(self._pos_ned_m, state.pos_uav_ned_m)
        if dot(lead_ned_m, vel_ned_mps) <= 0.0:
            return vel_ned_mps
        room_m = LEAD_M + LEAD_S * self._speed_max_mps - norm(lead_ned_m)
        return _shortened(vel_ned_mps, max(LEAD_GAIN_1PS * room_m, 0.0))

    @property
    def _low_limit(self) -> str:
        return f"the least height of {self._limits.altitude_min_m:g} m"

    def _lowest(self, state: VehicleState) -> tuple[float, str]:
        """z of the lowest place that the reference may go to, in the autopilot's present frame, and the ground's name.

        The name is "" where the limit of height counts, and not the measured ground. A goal that began lower than that
        limit, as on a slope, may stay there.
        """
        limit_ned_m = max(z_ned_m(self._limits.altitude_min_m), self._z_start_ned_m + state.shift_ned_m[2])
        if state.height_m is None:
            return limit_ned_m, ""
        clearance_m = self._config.clearance_min_m
        if state.fence is not None:
            clearance_m = max(clearance_m, state.fence.floor_over_ground_m)
        above_m = state.height_m - self._height_altimeter_m
        ground_ned_m = state.pos_uav_ned_m[2] + state.shift_ned_m[2] + above_m - clearance_m
        if ground_ned_m >= limit_ned_m:
            return limit_ned_m, ""
        return ground_ned_m, f"the ground, over which {clearance_m:g} m are kept"


def _shortened(vector: Vec3, length_max: float) -> Vec3:
    length = norm(vector)
    return vector if length <= length_max else scale(vector, length_max / length)


class FlyVelocityPlanner:
    """Plans flights by velocity within the limits."""

    def __init__(self, config: ActionsConfig) -> None:
        self._config = config

    def plan(self, goal: FlyVelocityGoal, status: Status) -> Plan | Refusal:
        """Plan a flight from where the vehicle hovers."""
        config = self._config.fly_velocity
        if reason := speed_refusal(goal.speed_max_mps, self._config.vehicle.limits):
            return Refusal(reason)
        limit_mps = self._config.vehicle.limits.speed_max_mps
        speed_max_mps = min(config.speed_mps, limit_mps) if goal.speed_max_mps is None else goal.speed_max_mps
        return Plan(partial(FlyVelocity, speed_max_mps, config, self._config.vehicle))
