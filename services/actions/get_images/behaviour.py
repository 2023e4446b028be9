"""Photograph a target from all sides, in the world's frame or in the rover's. Source: spec §5; thesis §3.5."""

from jezero.frames import Vec3, add
from jezero.schemas.goals import GetImagesGoal, ImagesResult
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.get_images.config import GetImagesConfig
from jezero.services.actions.get_images.orbit import Turn
from jezero.services.actions.get_images.orbit_flight import OrbitFlight
from jezero.services.actions.motion.behaviour import Done, Move, Remaining, VehicleState
from jezero.services.actions.motion.capture import Capture
from jezero.services.actions.motion.rover_frame import rover_position, step_in_rover_frame


class GetImages:
    """Flies around `center_ned_m`. In the rover's frame the whole flight moves with the rover.

    Args:
        speed_mps: along the circle.
        turn: progress of the turn, which is under way for a goal that was modified.
    """

    def __init__(
        self,
        goal: GetImagesGoal,
        speed_mps: float,
        turn: Turn,
        capture: Capture,
        settings: GetImagesConfig,
        config: ActionsConfig,
        t_ns: int,
        state: VehicleState,
    ) -> None:
        self._goal = goal
        self._speed_mps = speed_mps
        self._turn = turn
        self.capture = capture
        self._settings = settings
        self._config = config
        self._yaw_start_rad = state.yaw_rad
        self._flight: OrbitFlight | None = None
        """None until the goal's frame is known."""

    @property
    def turn(self) -> Turn:
        """Progress of the turn."""
        return self._turn if self._flight is None else self._flight.turn

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        if self._goal.frame == "rover":
            return step_in_rover_frame(self._fly, t_ns, state)
        return self._fly(t_ns, state)

    def remaining(self, state: VehicleState) -> Remaining | None:
        return None if self._flight is None else self._flight.remaining()

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        """The way to the circle, and around the circle."""
        if self._flight is None:
            return ()
        way_ned_m = self._flight.path()
        if self._goal.frame == "rover":
            if state.relative is None:
                return ()
            origin_ned_m = rover_position(state, state.relative)
            way_ned_m = tuple(add(point_m, origin_ned_m) for point_m in way_ned_m)
        return (state.pos_uav_ned_m, *way_ned_m)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> ImagesResult:
        return ImagesResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m, images=self.capture.images())

    def _fly(self, t_ns: int, state: VehicleState) -> Move | Done:
        """Step the flight; state and result are in the goal's frame."""
        if self._flight is None:
            self.capture.planned = self._goal.num_images
            self._flight = OrbitFlight(
                t_ns,
                state,
                goal=self._goal,
                speed_mps=self._speed_mps,
                yaw_start_rad=self._yaw_start_rad,
                turn=self._turn,
                capture=self.capture,
                settings=self._settings,
                config=self._config,
            )
        return self._flight.step(t_ns, state)
