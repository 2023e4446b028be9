"""What a goal sees of the vehicle: a `VehicleState` in the world frame as it was when it started."""

import msgspec

from jezero.frames import Vec3, quat_rotate, subtract, yaw_from_quat
from jezero.runtime.service import Inbox
from jezero.schemas.estimate import Relative, RoverEstimate
from jezero.schemas.state import Odometry
from jezero.schemas.struct import Message
from jezero.schemas.topics import ALTIMETER, ODOMETRY, RELATIVE, ROVER_ESTIMATE, STATUS
from jezero.services.actions.behaviour import VehicleState
from jezero.services.actions.config import LifecycleConfig
from jezero.services.actions.lease import SelectionLease

NS_PER_S = 1_000_000_000
EARLY_NS = 300_000_000
"""A message may seem to be so much ahead of its time: a process that stood still tells time late for a moment."""


def is_fresh(message: Message | None, t_ns: int, age_max_s: float) -> bool:
    """Whether a message is there and its age is between -0.3 s and `age_max_s`."""
    return message is not None and -EARLY_NS <= t_ns - message.t_ns <= age_max_s * NS_PER_S


class VehicleView:
    """The eyes of one goal.

    Args:
        epoch_id: of the vehicle that the goal is for.
        lease: of the goal's own selection of the estimator's inputs, if it has one.
    """

    def __init__(self, config: LifecycleConfig, epoch_id: int, lease: SelectionLease | None) -> None:
        self._config = config
        self._epoch_id = epoch_id
        self._lease = lease
        self._offset_start_ned_m: Vec3 = (0.0, 0.0, 0.0)

    def begin(self, odometry: Odometry) -> None:
        """From now on positions are in the world frame as it is in this message."""
        self._offset_start_ned_m = odometry.reset_offset_ned_m

    def odometry(self, inbox: Inbox) -> Odometry | None:
        """The newest there is; until the first one of its own topic arrives, the status brings it."""
        odometry, status = inbox.latest(ODOMETRY), inbox.latest(STATUS)
        if odometry is None and status is not None:
            return status.odometry
        return odometry

    def shift(self, odometry: Odometry) -> Vec3:
        """From the world frame as the behaviour knows it to the autopilot's present one."""
        return subtract(odometry.reset_offset_ned_m, self._offset_start_ned_m)

    def state(self, t_ns: int, inbox: Inbox, odometry: Odometry) -> VehicleState:
        """All that a behaviour may look at."""
        status, relative, rover = inbox.latest(STATUS), inbox.latest(RELATIVE), inbox.latest(ROVER_ESTIMATE)
        shift_ned_m = self.shift(odometry)
        q_ned_from_frd = odometry.q_ned_from_frd
        lean_north, lean_east, upright = quat_rotate(q_ned_from_frd, (0.0, 0.0, 1.0))
        altimeter = inbox.latest(ALTIMETER)
        height_m = None
        if altimeter is not None and altimeter.range_m is not None:
            fresh = is_fresh(altimeter, t_ns, self._config.altimeter_age_max_s)
            height_m = altimeter.range_m * upright if fresh else None
        return VehicleState(
            pos_uav_ned_m=subtract(odometry.pos_uav_ned_m, shift_ned_m),
            vel_uav_ned_mps=odometry.vel_uav_ned_mps,
            yaw_rad=yaw_from_quat(q_ned_from_frd),
            q_ned_from_frd=q_ned_from_frd,
            armed=status is not None and status.armed,
            landed=status is not None and status.landed,
            age_s=min(max((t_ns - odometry.t_ns) / NS_PER_S, 0.0), self._config.odometry_age_max_s),
            down_ned=(lean_north, lean_east),
            height_m=height_m,
            relative=None if relative is None else self._relative(t_ns, relative),
            rover=None if rover is None else self._rover(t_ns, rover),
            shift_ned_m=shift_ned_m,
        )

    def _relative(self, t_ns: int, relative: Relative) -> Relative | None:
        if relative.epoch_id != self._epoch_id:
            return None
        if self._lease is not None:
            relative = self._lease.own(relative)
        return relative if is_fresh(relative, t_ns, self._config.estimate_age_max_s) else None

    def _rover(self, t_ns: int, rover: RoverEstimate) -> RoverEstimate | None:
        """In the world frame as the behaviour knows it."""
        if rover.epoch_id != self._epoch_id or not is_fresh(rover, t_ns, self._config.estimate_age_max_s):
            return None
        shift = subtract(rover.reset_offset_ned_m, self._offset_start_ned_m)
        pos_rover_ned_m = subtract(rover.pos_rover_ned_m, shift)
        return msgspec.structs.replace(
            rover, pos_rover_ned_m=pos_rover_ned_m, reset_offset_ned_m=self._offset_start_ned_m
        )
