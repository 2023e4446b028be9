"""The vehicle's state for one goal, in the world frame as it was when the goal started."""

from collections.abc import Sequence
from typing import Any

import msgspec

from jezero.base.frames import Quat, Vec3, add, quat_rotate, subtract
from jezero.runtime.service import Inbox
from jezero.schemas.estimate import Relative, RoverEstimate
from jezero.schemas.fence import Fence
from jezero.schemas.rows import Topic
from jezero.schemas.state import Odometry, Status, StatusCode
from jezero.schemas.struct import Message
from jezero.schemas.topics import ALTIMETER, FENCE, ODOMETRY, RELATIVE, ROVER_ESTIMATE, STATUS
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.lifecycle.leases import SelectionLease
from jezero.services.actions.lifecycle.steering import Steering
from jezero.services.actions.motion.behaviour import VehicleState

NO_SHIFT: Vec3 = (0.0, 0.0, 0.0)
AHEAD_MAX_NS = 300_000_000
"""A message may be ahead of the vehicle time by this much, because the clock of a process that stood still is late for
a moment."""
ODOMETRY_AGE_MAX_S = 0.5
ALTIMETER_AGE_MAX_S = 0.3
ESTIMATE_AGE_MAX_S = 0.3
"""Older readings and estimates count as lost."""


def is_fresh(message: Message | None, t_ns: int, age_max_s: float) -> bool:
    """Whether a message is there and its age is between -0.3 s and `age_max_s`."""
    return message is not None and -AHEAD_MAX_NS <= t_ns - message.t_ns <= age_max_s * NS_PER_S


def known_fence(inbox: Inbox) -> Fence | None:
    """The fence in force; None for none, and while it is unknown."""
    status, state = inbox.latest(STATUS), inbox.latest(FENCE)
    if status is None or state is None or state.fence_id != status.fence_id:
        return None
    return state.fence


def hovering_at(status: Status, pos_ned_m: Vec3) -> Status:
    """The status of a vehicle that hovers somewhere, for a plan from there."""
    odometry = status.odometry
    if odometry is not None:
        odometry = msgspec.structs.replace(odometry, pos_uav_ned_m=pos_ned_m, vel_uav_ned_mps=NO_SHIFT)
    code = StatusCode.HOVER
    return msgspec.structs.replace(
        status, code=code, name=code.name, armed=True, landed=False, ready=True, not_ready_reason="", odometry=odometry
    )


class VehicleView:
    """Makes the states of the vehicle for one goal.

    Args:
        epoch_id: of the vehicle that the goal is for.
        lease: of the goal's own selection of the estimator's inputs, if it has one.
        inputs: topics besides odometry and status that the goal subscribes to.
        steering: the commands of the goal's client, if the action has some.
        plan_from_ned_m: position at which the vehicle is supposed to hover, for a plan; None: where and as it is.
    """

    def __init__(
        self,
        epoch_id: int,
        lease: SelectionLease | None,
        inputs: Sequence[Topic[Any]],
        plan_from_ned_m: Vec3 | None = None,
        steering: Steering | None = None,
    ) -> None:
        self._epoch_id = epoch_id
        self._plan_from_ned_m = plan_from_ned_m
        self._lease = lease
        self._steering = steering
        self._with_rover = RELATIVE in inputs or ROVER_ESTIMATE in inputs
        self._offset_start_ned_m: Vec3 | None = None

    @property
    def steered_by(self) -> tuple[Topic[Any], ...]:
        """Topic of the commands of the goal's client, if the action has some."""
        return () if self._steering is None else (self._steering.topic,)

    def update(self, t_ns: int, inbox: Inbox) -> None:
        """Take the commands of the goal's client; to be called in every step."""
        if self._steering is not None:
            self._steering.update(t_ns, inbox)

    def begin(self, odometry: Odometry) -> None:
        """Start, if the goal has not started yet: positions are in the world frame as it is in this message."""
        if self._offset_start_ned_m is None:
            self._offset_start_ned_m = odometry.reset_offset_ned_m

    def odometry(self, inbox: Inbox) -> Odometry | None:
        """The newest odometry; until the first one of its own topic arrives, that in the status."""
        odometry, status = inbox.latest(ODOMETRY), inbox.latest(STATUS)
        if odometry is None and status is not None:
            odometry = status.odometry
        if odometry is None or self._plan_from_ned_m is None:
            return odometry
        return msgspec.structs.replace(odometry, pos_uav_ned_m=self._plan_from_ned_m, vel_uav_ned_mps=NO_SHIFT)

    def shift(self, odometry: Odometry) -> Vec3:
        """Shift of positions from the behaviour's world frame to the autopilot's present one."""
        offset_ned_m, start_ned_m = odometry.reset_offset_ned_m, self._offset_start_ned_m
        return NO_SHIFT if start_ned_m in (None, offset_ned_m) else subtract(offset_ned_m, start_ned_m)

    def state(self, t_ns: int, inbox: Inbox, odometry: Odometry, behind_ns: int = 0) -> VehicleState:
        """State of the vehicle as a behaviour gets it.

        Args:
            behind_ns: vehicle time minus the goal's own time, in which the times of estimates are given.
        """
        status, supposed = inbox.latest(STATUS), self._plan_from_ned_m is not None
        shift_ned_m, pos_ned_m = self.shift(odometry), odometry.pos_uav_ned_m
        return VehicleState(
            pos_ned_m if shift_ned_m is NO_SHIFT else subtract(pos_ned_m, shift_ned_m),
            odometry.vel_uav_ned_mps,
            odometry.q_ned_from_frd,
            supposed or (status is not None and status.armed),
            not supposed and status is not None and status.landed,
            min(max((t_ns - odometry.t_ns) / NS_PER_S, 0.0), ODOMETRY_AGE_MAX_S),
            None if supposed else self._height_m(t_ns, inbox, odometry.q_ned_from_frd),
            self._relative(t_ns, inbox, behind_ns) if self._with_rover else None,
            self._rover(t_ns, inbox, behind_ns) if self._with_rover else None,
            shift_ned_m,
            None if status is None else status.wind_ned_mps,
            None if status is None else status.std_gust_mps,
            known_fence(inbox),
            None if supposed or status is None else status.battery,
            None if self._steering is None else self._steering.command(behind_ns),
            "" if self._steering is None else self._steering.refusal,
        )

    def _height_m(self, t_ns: int, inbox: Inbox, q_ned_from_frd: Quat) -> float | None:
        altimeter = inbox.latest(ALTIMETER)
        if altimeter is None or altimeter.range_m is None:
            return None
        if not is_fresh(altimeter, t_ns, ALTIMETER_AGE_MAX_S):
            return None
        upright = quat_rotate(q_ned_from_frd, (0.0, 0.0, 1.0))[2]
        return altimeter.range_m * upright

    def _relative(self, t_ns: int, inbox: Inbox, behind_ns: int) -> Relative | None:
        relative = inbox.latest(RELATIVE)
        if relative is None or relative.epoch_id != self._epoch_id:
            return None
        if self._lease is not None:
            relative = self._lease.checked(relative)
        if not is_fresh(relative, t_ns, ESTIMATE_AGE_MAX_S):
            return None
        if self._plan_from_ned_m is not None:
            return self._supposed_relative(relative, inbox)
        if behind_ns == 0:
            return relative
        # A measurement from before a long pause would be older than the goal's own time is.
        fused_t_ns = max(relative.fused_t_ns - behind_ns, 0)
        return msgspec.structs.replace(relative, t_ns=max(relative.t_ns - behind_ns, 0), fused_t_ns=fused_t_ns)

    def _supposed_relative(self, relative: Relative, inbox: Inbox) -> Relative:
        """The estimate as it would be where the vehicle is supposed to hover."""
        status = inbox.latest(STATUS)
        odometry = inbox.latest(ODOMETRY) or (None if status is None else status.odometry)
        if odometry is None or self._plan_from_ned_m is None:
            return relative
        moved_m = subtract(self._plan_from_ned_m, odometry.pos_uav_ned_m)
        north_mps, east_mps, down_mps = relative.vel_rover_ned_mps
        return msgspec.structs.replace(
            relative,
            pos_uav_rel_rover_ned_m=add(relative.pos_uav_rel_rover_ned_m, moved_m),
            vel_uav_rel_rover_ned_mps=(-north_mps, -east_mps, -down_mps),
        )

    def _rover(self, t_ns: int, inbox: Inbox, behind_ns: int) -> RoverEstimate | None:
        """Estimate of the rover in the behaviour's world frame."""
        rover = inbox.latest(ROVER_ESTIMATE)
        if rover is None:
            return None
        if rover.epoch_id != self._epoch_id or not is_fresh(rover, t_ns, ESTIMATE_AGE_MAX_S):
            return None
        start_ned_m = self._offset_start_ned_m or NO_SHIFT
        shift = subtract(rover.reset_offset_ned_m, start_ned_m)
        pos_rover_ned_m = subtract(rover.pos_rover_ned_m, shift)
        return msgspec.structs.replace(
            rover,
            t_ns=max(rover.t_ns - behind_ns, 0),
            pos_rover_ned_m=pos_rover_ned_m,
            reset_offset_ned_m=start_ned_m,
        )
