"""Resets of the filter by itself, kept in order with the measurements."""

from typing import ClassVar

import msgspec

from jezero.base.arrays import Array
from jezero.services.estimator.kalman import Kalman, UpdateResult
from jezero.services.estimator.measurements import Kind


class HeadingReset(msgspec.Struct, frozen=True, gc=False):
    """Turn of the rover's heading against its compass; for the fields see `Kalman.reset_rover_heading`."""

    kind: ClassVar[Kind] = "locate"
    t_ns: int
    turn_rad: float
    std_rad: float

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> UpdateResult:
        kalman.reset_rover_heading(self.turn_rad, self.std_rad)
        return UpdateResult(1, 1)


class PositionReset(msgspec.Struct, frozen=True, gc=False):
    """Measured relative position that replaces the former estimate; fields as in `Kalman.reset_rover_position`."""

    kind: ClassVar[Kind] = "locate"
    t_ns: int
    pos_rel_m: Array
    cov_m2: Array
    error_jacobian: Array

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> UpdateResult:
        kalman.reset_rover_position(self.pos_rel_m, self.cov_m2, self.error_jacobian)
        return UpdateResult(3, 3)
