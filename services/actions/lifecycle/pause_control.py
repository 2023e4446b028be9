"""Pause of a goal: the goal's own time slows down to a stop, and the vehicle with it.

A behaviour gets the goal's own time. In a pause this time stands still, so that no path goes on and no time-out passes.
The setpoints of the behaviour are slowed down by the same rate: velocities follow from the path's own time, and
positions never jump, whatever the behaviour is.
"""

from msgspec.structs import replace

from jezero.base.frames import Vec3, add, distance, norm, scale, subtract
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.behaviour import (
    Behaviour,
    Done,
    Move,
    MovingFrame,
    VehicleState,
    hold_of,
    pause_refusal_of,
)

STEP_MAX_S = 0.1
"""The rate changes by the step of this time at most, also when the server was frozen."""
SPEED_MIN_MPS = 0.5
"""A slower vehicle is braked as if it were as fast as this: the brake takes half a second at least."""
STOPPING_S = 0.25
"""Time by which the vehicle's velocity follows its setpoint late: it comes to rest so much farther on."""
STILL = MovingFrame()


class PauseControl:
    """The pause of one goal, and the goal's own time.

    Args:
        t_ns: vehicle time at the goal's start.
        acceleration_mps2: with which the vehicle brakes and goes on.

    Attributes:
        wanted: whether a client wants the pause.
        changing: whether the goal stops for a change of its fields.
        rate: of the goal's time relative to the vehicle's: 1 while the goal is flown, 0 while it is paused.
        behind_ns: time for which the goal's time has stood still so far.
    """

    def __init__(self, t_ns: int, acceleration_mps2: float) -> None:
        self.wanted = self.changing = False
        self.rate = 1.0
        self.behind_ns = 0
        self._acceleration_mps2 = acceleration_mps2
        self._t_ns = t_ns
        self._rate_per_s = 0.0
        self._speed_mps = 0.0
        """Speed of the behaviour's last setpoint, relative to the behaviour's frame."""
        self._held_m: Vec3 | None = None
        """Hover point relative to the frame of a behaviour that commands velocities; None while it moves."""
        self._left_mps = STILL.vel_ned_mps
        """Velocity, relative to its frame, that the behaviour's own hover had; it decays when the goal goes on."""
        self._holds = False
        """Whether the hover has begun; a goal that is paused again at once comes to rest first."""

    @property
    def paused(self) -> bool:
        """Whether the goal is paused by a client, and the vehicle hovers."""
        return self.wanted and self.hovers

    @property
    def hovers(self) -> bool:
        """Whether the goal's time stands still, and the vehicle is at rest or in the behaviour's own hover."""
        return self._holds

    def step(self, t_ns: int, behaviour: Behaviour, state: VehicleState) -> Move | Done:
        """Next setpoint of the behaviour, slowed down by the pause."""
        dt_s = max(t_ns - self._t_ns, 0) / NS_PER_S
        stops = self.wanted or self.changing
        refused = stops and not self.hovers and bool(pause_refusal_of(behaviour, state))
        self._advance(t_ns, stops=stops and not refused)
        if refused:
            self.rate = 1.0  # what must not be interrupted, such as a touchdown, must not be slowed down either
        goal_ns = t_ns - self.behind_ns
        self._holds = self.rate == 0.0 and (self._holds or not any(self._left_mps))
        if self._holds and (held := hold_of(behaviour, goal_ns, min(dt_s, STEP_MAX_S), state)) is not None:
            if isinstance(held, Move) and held.vel_ned_mps is not None:
                self._left_mps = subtract(held.vel_ned_mps, (held.frame or STILL).vel_ned_mps)
            return held
        self._left_mps = _shortened(self._left_mps, self._acceleration_mps2 * min(dt_s, STEP_MAX_S))
        move = behaviour.step(goal_ns, state)
        return self._slowed(move, state) if isinstance(move, Move) else move

    def _advance(self, t_ns: int, *, stops: bool) -> None:
        """Advance the goal's time, and the rate towards rest or full speed."""
        passed_ns = max(t_ns - self._t_ns, 0)
        self._t_ns = t_ns
        if self.rate == 1.0 and not stops:
            self._rate_per_s = 0.0
            return
        dt_s = min(passed_ns / NS_PER_S, STEP_MAX_S)
        change = dt_s * self._acceleration_mps2 / max(self._speed_mps, SPEED_MIN_MPS)
        before = self.rate
        self.rate = max(before - change, 0.0) if stops else min(before + change, 1.0)
        self._rate_per_s = (self.rate - before) / dt_s if dt_s > 0.0 else 0.0
        self.behind_ns += int(passed_ns * (1.0 - 0.5 * (before + self.rate)))

    def _slowed(self, move: Move, state: VehicleState) -> Move:
        """The same setpoint, passed at `rate` times the speed in its frame; at rate 0 a hover."""
        frame = move.frame or STILL
        if move.vel_ned_mps is not None:
            self._speed_mps = distance(move.vel_ned_mps, frame.vel_ned_mps)
        if not self._holds:
            self._held_m = None
        if self.rate == 1.0 and self._rate_per_s == 0.0 and not any(self._left_mps):
            return move
        slowed = replace(
            move,
            vel_ned_mps=None if move.vel_ned_mps is None else self._velocity(move.vel_ned_mps, frame),
            acc_ned_mps2=None if move.acc_ned_mps2 is None else self._acceleration(move, move.acc_ned_mps2, frame),
            yaw_rate_rps=None if move.yaw_rate_rps is None else self.rate * move.yaw_rate_rps,
        )
        if not self._holds or move.pos_ned_m is not None:
            return slowed
        if self._held_m is None:
            relative_mps = subtract(state.vel_uav_ned_mps, frame.vel_ned_mps)
            stop_ned_m = add(state.pos_uav_ned_m, scale(relative_mps, STOPPING_S + state.age_s))
            self._held_m = subtract(stop_ned_m, frame.pos_ned_m)
        return replace(slowed, pos_ned_m=add(self._held_m, frame.pos_ned_m), target_ned_m=None)

    def _velocity(self, vel_ned_mps: Vec3, frame: MovingFrame) -> Vec3:
        slowed_mps = scale(subtract(vel_ned_mps, frame.vel_ned_mps), self.rate)
        return add(frame.vel_ned_mps, add(slowed_mps, self._left_mps))

    def _acceleration(self, move: Move, acc_ned_mps2: Vec3, frame: MovingFrame) -> Vec3:
        """Derivative of the slowed velocity: d(r v)/dt, where v depends on the goal's time."""
        slowed = add(frame.acc_ned_mps2, scale(subtract(acc_ned_mps2, frame.acc_ned_mps2), self.rate * self.rate))
        if move.vel_ned_mps is None:
            return slowed
        return add(slowed, scale(subtract(move.vel_ned_mps, frame.vel_ned_mps), self._rate_per_s))


def _shortened(vector: Vec3, by: float) -> Vec3:
    """The vector, shortened by a length; zero when it is shorter."""
    length = norm(vector)
    return STILL.vel_ned_mps if length <= by else scale(vector, 1.0 - by / length)
