"""Photograph a target from all sides, in the world's frame or in the rover's. Source: spec §5; thesis §3.5."""

from msgspec.structs import replace

from jezero.frames import Vec3, add, subtract
from jezero.schemas.actions import GetImagesGoal, ImagesResult
from jezero.schemas.estimate import Relative
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.get_images.config import GetImagesConfig
from jezero.services.actions.get_images.orbit_flight import OrbitFlight
from jezero.services.actions.lifecycle.behaviour import Done, Move, VehicleState
from jezero.services.actions.lifecycle.capture import Capture
from jezero.services.actions.motion.rover_frame import lost_reason, seen_from_rover


class GetImages:
    """Flies around `center_ned_m`. In the rover's frame the whole flight moves with the rover.

    Args:
        speed_mps: along the circle.
    """

    def __init__(
        self,
        goal: GetImagesGoal,
        speed_mps: float,
        capture: Capture,
        settings: GetImagesConfig,
        config: ActionsConfig,
        t_ns: int,
        state: VehicleState,
    ) -> None:
        self._goal = goal
        self._speed_mps = speed_mps
        self._capture = capture
        self._settings = settings
        self._config = config
        self._yaw_start_rad = state.yaw_rad
        self._flight: OrbitFlight | None = None
        """None until the goal's frame is known."""

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        if self._goal.frame == "world":
            return self._fly(t_ns, state)
        relative = state.relative
        if relative is None or not relative.valid:
            return Done("aborted", lost_reason(relative))
        move = self._fly(t_ns, seen_from_rover(state, relative))
        if isinstance(move, Move):
            return _with_rover(move, relative)
        if move.hover_pos_ned_m is None:
            return move
        pos_rover_ned_m = subtract(state.pos_uav_ned_m, relative.pos_uav_rel_rover_ned_m)
        return replace(move, hover_pos_ned_m=add(move.hover_pos_ned_m, pos_rover_ned_m))

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> ImagesResult:
        return ImagesResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m, images=self._capture.images())

    def _fly(self, t_ns: int, state: VehicleState) -> Move | Done:
        """Step the flight; state and result are in the goal's frame."""
        if self._flight is None:
            self._flight = OrbitFlight(
                t_ns,
                state,
                goal=self._goal,
                speed_mps=self._speed_mps,
                yaw_start_rad=self._yaw_start_rad,
                capture=self._capture,
                settings=self._settings,
                config=self._config,
            )
        return self._flight.step(t_ns, state)


def _with_rover(move: Move, relative: Relative) -> Move:
    """A move relative to the rover, with the rover's own motion added."""
    assert move.vel_ned_mps is not None and move.acc_ned_mps2 is not None
    north_mps, east_mps, _ = relative.vel_rover_ned_mps
    rate_rps = relative.yaw_rate_rover_rps
    return replace(
        move,
        vel_ned_mps=add(move.vel_ned_mps, relative.vel_rover_ned_mps),
        acc_ned_mps2=add(move.acc_ned_mps2, (-rate_rps * east_mps, rate_rps * north_mps, 0.0)),
    )
