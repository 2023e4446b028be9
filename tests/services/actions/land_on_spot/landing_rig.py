"""A landing of a point mass on a rover, with an estimate that the test controls."""

from collections.abc import Callable
from math import cos, hypot, sin
from random import Random

from jezero.base.frames import Quat, Vec3, add, scale, subtract
from jezero.schemas.estimate import DeckMotion, Relative, RoverEstimate
from jezero.schemas.goals import LandOnSpotGoal
from jezero.schemas.topics import LAND_ON_SPOT
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Done, Move, Preparation, VehicleState
from tests.services.actions.fake_bridge import follow
from tests.services.actions.test_behaviours import plan_of

CONFIG = ActionsConfig()
DT_S = 0.02
S = 1_000_000_000
DECK_NED_M: Vec3 = (5.0, -3.0, -0.5)
STILL: Vec3 = (0.0, 0.0, 0.0)
BOTH = LandOnSpotGoal(goal_id="g")
TAG = LandOnSpotGoal(goal_id="g", use_uwb=False, landing_spot_ned_m=(3.0, -4.0, 0.0))


def deck_motion(**fields: float) -> DeckMotion:
    """Motion of a deck that was observed for half a minute and has not moved, but for the fields given."""
    still = dict.fromkeys(DeckMotion.__struct_fields__, 0.0)
    return DeckMotion(**{**still, "observed_s": 30.0, **fields})


class Landing:
    """Flies one goal.

    Args:
        speed_mps: of the rover.
        yaw_rate_rps: of the rover.
        sees: from time in s and the vehicle's offset from the platform, whether anything of the rover is measured.

    Attributes:
        forget_s: time after the last measurement until the estimate becomes invalid.
        grounded: whether the autopilot detects the ground.
        offset_of_estimate_m: error of the estimate's position.
        vel_error_mps: error of the estimate's velocity at a time in s.
        vel_rover_error_mps: error of the rover's velocity over ground.
        range_m: of the altimeter.
        contradicted: reason for an estimate that its inputs contradict, or "".
        landed: the autopilot detects the ground, whatever the vehicle does.
        deck: motion of a platform that heaves, as the estimator has it; the platform itself stands still.
        moves: every move with the time in s and the vehicle's offset from the platform.
    """

    def __init__(
        self,
        goal: LandOnSpotGoal,
        start_ned_m: Vec3 = (-1.0, -3.0, -6.0),
        *,
        speed_mps: float = 0.0,
        yaw_rate_rps: float = 0.0,
        sees: Callable[[float, Vec3], bool] = lambda t_s, offset_m: True,
        std_m: float = 0.0,
    ) -> None:
        self.goal = goal
        self.t_ns = 100 * S
        self.pos_m, self.vel_mps = start_ned_m, STILL
        self.deck_m, self.yaw_rad = DECK_NED_M, 0.4
        self.speed_mps, self.yaw_rate_rps = speed_mps, yaw_rate_rps
        self.sees, self.std_m = sees, std_m
        self.forget_s = 3.0
        self.std_at: Callable[[Vec3], float] = lambda offset_m: 0.0
        self.grounded = True
        self.offset_of_estimate_m = STILL
        self.vel_error_mps: Callable[[float], Vec3] = lambda t_s: STILL
        self.vel_rover_error_mps = STILL
        self.std_height_m = 0.01
        self.std_rover_m = 9.0
        self.range_m: float | None = None
        self.silent = False
        self.contradicted = ""
        self.landed = False
        self.deck: DeckMotion | None = None
        self.q_ned_from_frd: Quat = (1.0, 0.0, 0.0, 0.0)
        self.moves: list[tuple[float, Vec3, Move]] = []
        self._rng = Random(1)
        self._fused_ns = 0
        self._still_s = 0.0
        plan = plan_of(LAND_ON_SPOT, goal)
        assert not isinstance(plan.start, Preparation)
        self.behaviour = plan.start(self.t_ns, self.state())

    @property
    def t_s(self) -> float:
        return (self.t_ns - 100 * S) / S

    @property
    def offset_m(self) -> Vec3:
        return subtract(self.pos_m, self.deck_m)

    @property
    def phases(self) -> list[str]:
        return list(dict.fromkeys(move.feedback.phase for _, _, move in self.moves))

    @property
    def vel_deck_mps(self) -> Vec3:
        return (self.speed_mps * cos(self.yaw_rad), self.speed_mps * sin(self.yaw_rad), 0.0)

    def state(self) -> VehicleState:
        return VehicleState(
            self.pos_m,
            self.vel_mps,
            self.q_ned_from_frd,
            armed=True,
            landed=self.landed or (self.grounded and self._still_s > 0.8),
            height_m=self.range_m,
            relative=None if self.silent else self.relative(),
            rover=self.rover(),
        )

    def relative(self) -> Relative:
        if self.sees(self.t_s, self.offset_m):
            self._fused_ns = self.t_ns - S // 10
        std_m = self.std_at(self.offset_m)
        noise: Vec3 = (self._rng.gauss(0.0, self.std_m), self._rng.gauss(0.0, self.std_m), 0.0)
        return Relative(
            t_ns=self.t_ns - S // 50,
            epoch_id=1,
            valid=self._fused_ns > 0
            and self.t_ns - self._fused_ns < self.forget_s * S
            and std_m < 0.5
            and not self.contradicted,
            reason=self.contradicted or "not seen",
            contradicted=bool(self.contradicted),
            pos_uav_rel_rover_ned_m=add(add(self.offset_m, noise), self.offset_of_estimate_m),
            vel_uav_rel_rover_ned_mps=add(subtract(self.vel_mps, self.vel_deck_mps), self.vel_error_mps(self.t_s)),
            cov=(std_m**2 / 2, *(0.0,) * 5, std_m**2 / 2, *(0.0,) * 4, self.std_height_m**2, *(0.0,) * 9),
            vel_rover_ned_mps=add(self.vel_deck_mps, self.vel_rover_error_mps),
            yaw_rover_rad=self.yaw_rad,
            yaw_rate_rover_rps=self.yaw_rate_rps,
            deck=self.deck,
            use_uwb=self.goal.use_uwb,
            use_tag=self.goal.use_tag,
            fused_t_ns=self._fused_ns,
            goal_id="g",
        )

    def rover(self) -> RoverEstimate:
        return RoverEstimate(
            t_ns=self.t_ns,
            epoch_id=1,
            valid=False,
            pos_rover_ned_m=self.deck_m,
            vel_rover_ned_mps=STILL,
            yaw_rover_rad=self.yaw_rad,
            std_pos_m=self.std_rover_m,
        )

    def run(self, within_s: float) -> Done | None:
        for _ in range(int(within_s / DT_S)):
            self.t_ns += int(DT_S * S)
            self.yaw_rad += self.yaw_rate_rps * DT_S
            self.deck_m = add(self.deck_m, scale(self.vel_deck_mps, DT_S))
            move = self.behaviour.step(self.t_ns, self.state())
            if isinstance(move, Done):
                return move
            self.moves.append((self.t_s, self.offset_m, move))
            self._obey(move)
        return None

    def _obey(self, move: Move) -> None:
        """Move the point mass; the platform holds it up and carries it along."""
        on_deck = self.offset_m[2] >= -1e-9 and hypot(*self.offset_m[:2]) < 0.7
        if on_deck and move.vel_ned_mps is not None and move.vel_ned_mps[2] > 0.0:
            self.vel_mps = self.vel_deck_mps
            self.pos_m = add(self.pos_m, scale(self.vel_mps, DT_S))
            self._still_s += DT_S
            return
        self._still_s = 0.0
        self.pos_m, self.vel_mps = follow(self.pos_m, self.vel_mps, move.pos_ned_m, move.vel_ned_mps, DT_S)
        if self.offset_m[2] > 0.0 and hypot(*self.offset_m[:2]) < 0.7:
            self.pos_m = (self.pos_m[0], self.pos_m[1], self.deck_m[2])
