"""The climb of a takeoff, which `go_to` flies too."""

from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Remaining, VehicleState
from jezero.services.actions.motion.straight_path import StraightPath

LEAD_M = 0.6
"""Height to which the reference rises before the vehicle leaves the ground."""
ARMING_S, ARMING_TIMEOUT_S = 1.0, 10.0
"""Usual and greatest time until the motors turn."""


class Climb:
    """A climb straight up from the ground, which waits at its start until the vehicle is armed.

    Args:
        altitude_m: above the ground, positive up.
        z_ground_ned_m: of the take-off point; None: the vehicle stands there.

    Attributes:
        path: of the climb.
        z_ground_ned_m: of the take-off point.
    """

    def __init__(
        self,
        t_ns: int,
        altitude_m: float,
        state: VehicleState,
        config: ActionsConfig,
        z_ground_ned_m: float | None = None,
    ) -> None:
        x, y, z = self._start_ned_m = state.pos_uav_ned_m
        self.z_ground_ned_m = z if z_ground_ned_m is None else z_ground_ned_m
        self.path = StraightPath(
            t_ns,
            (x, y, z),
            (x, y, self.z_ground_ned_m - altitude_m),
            speed_mps=config.move.speed_up_mps,
            lead_max_m=LEAD_M,
            config=config.move,
            yaw_start_rad=state.yaw_rad,
        )
        self._arm_by_ns = t_ns + int(ARMING_TIMEOUT_S * NS_PER_S)

    def remaining(self) -> Remaining:
        """Rest of the climb, with the time for arming before it begins."""
        waits = self.path.pos_ned_m == self._start_ned_m
        return self.path.remaining() + Remaining(ARMING_S if waits else 0.0, 0.0)

    def step(self, t_ns: int, state: VehicleState) -> str:
        """Move the reference on; returns the reason why the climb must be aborted, or ""."""
        if not state.armed:
            self.path.wait(t_ns, state)
            return "the vehicle was not armed in time" if t_ns > self._arm_by_ns else ""
        self.path.step(t_ns, state)
        return self.path.stuck(t_ns)
