"""Pauses of a landing on the rover, against a point mass and an estimate that the test controls."""

from itertools import pairwise
from math import hypot

import pytest
from msgspec.structs import replace

from jezero.base.frames import Vec3, altitude_m, distance, norm, subtract
from jezero.services.actions.land_on_spot.paused_hover import PausedHover
from jezero.services.actions.land_on_spot.rover_landing import RoverLanding
from jezero.services.actions.lifecycle.pause_control import PauseControl
from jezero.services.actions.motion.behaviour import Behaviour, Done, Move, VehicleState, pause_refusal_of
from tests.services.actions.land_on_spot.landing_rig import BOTH, DT_S, Landing

APPROACH_M = 3.0


class PausedLanding(Landing):
    """A landing whose behaviour is stepped by a pause control, with estimates in the goal's own time."""

    def __init__(self, speed_mps: float = 0.0) -> None:
        super().__init__(BOTH, speed_mps=speed_mps)
        self.inner: Behaviour = self.behaviour
        self.behaviour = self  # type: ignore[assignment]
        self.pause = PauseControl(self.t_ns, 1.0)

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        behind_ns, relative = self.pause.behind_ns, state.relative
        if relative is not None:
            relative = replace(relative, t_ns=relative.t_ns - behind_ns, fused_t_ns=relative.fused_t_ns - behind_ns)
        return self.pause.step(t_ns, self.inner, replace(state, relative=relative))

    def run_to(self, phase: str, height_max_m: float = 9.0) -> None:
        for _ in range(3000):
            assert self.run(DT_S) is None
            if self.moves[-1][2].feedback.phase == phase and self.height_m < height_max_m:
                return
        raise AssertionError(self.phases)

    @property
    def height_m(self) -> float:
        return altitude_m(self.offset_m[2])

    def greatest_step_mps(self, since: int) -> float:
        """Greatest step of the velocity setpoint in the moves from a number on, in one period."""
        velocities = [move.vel_ned_mps for _, _, move in self.moves[since:]]
        steps = [norm(subtract(b, a)) for a, b in pairwise(velocities) if a is not None and b is not None]
        return max(steps)


@pytest.mark.parametrize("speed_mps", [0.0, 0.5])
@pytest.mark.parametrize("height_m", [2.5, 0.5])
def test_a_paused_descent_climbs_hovers_along_with_the_rover_and_lands_when_it_is_resumed(
    speed_mps: float, height_m: float
) -> None:
    landing = PausedLanding(speed_mps)
    landing.run_to("descent", height_m)
    paused_at = len(landing.moves)
    landing.pause.wanted = True
    assert landing.run(8.0) is None
    assert landing.height_m == pytest.approx(APPROACH_M, abs=0.1)
    before_m = landing.offset_m
    assert landing.run(60.0 if speed_mps else 300.0) is None  # longer than a landing may take
    assert distance(landing.offset_m, before_m) < 0.05
    landing.pause.wanted = False
    assert landing.run(2.0) is None
    assert landing.greatest_step_mps(paused_at) < 2.0 * DT_S + 0.05
    assert landing.run(30.0) == Done("succeeded", then="disarm")
    assert hypot(*landing.offset_m[:2]) < 0.1


def test_a_descent_that_is_paused_again_and_again_while_it_climbs_makes_no_jump() -> None:
    landing = PausedLanding(0.5)
    landing.run_to("descent", 1.5)
    paused_at = len(landing.moves)
    for number in range(30):
        landing.pause.wanted = number % 2 == 0
        assert landing.run(1.5 if number % 2 == 0 else 0.1 + 0.02 * number) is None
    assert landing.greatest_step_mps(paused_at) < 2.0 * DT_S + 0.05
    landing.pause.wanted = False
    assert landing.run(60.0) == Done("succeeded", then="disarm")


def test_a_pause_without_the_rover_in_sight_hovers_over_the_ground_and_goes_on_with_the_search() -> None:
    landing = PausedLanding()
    landing.run_to("approach")
    landing.sees = lambda t_s, offset_m: False
    landing.run_to("search")
    assert landing.run(3.0) is None
    landing.pause.wanted = True
    assert landing.run(5.0) is None
    held_m = landing.pos_m
    assert landing.run(300.0) is None
    assert distance(landing.pos_m, held_m) < 0.1
    landing.pause.wanted = False
    landing.sees = lambda t_s, offset_m: True
    assert landing.run(40.0) == Done("succeeded", then="disarm")


def test_a_contact_is_not_paused() -> None:
    landing = PausedLanding()
    landing.grounded = False
    landing.run_to("contact")
    assert isinstance(landing.inner, RoverLanding)
    assert "the landing ends in a moment, or goes around" in pause_refusal_of(landing.inner, landing.state())
    landing.pause.wanted = True
    assert landing.run(0.2) is None
    assert landing.pause.rate == 1.0
    assert landing.moves[-1][2].vel_ned_mps == pytest.approx((0.0, 0.0, 0.5))


@pytest.mark.parametrize("vel_rover_ned_mps", [None, (1.0, 0.0, 0.0)])
def test_a_vehicle_that_the_wind_pushes_off_its_hover_point_comes_back(vel_rover_ned_mps: Vec3 | None) -> None:
    hover = PausedHover(1.5)
    hover.velocity(0.02, (0.0, 0.0, -3.0), 3.0, vel_rover_ned_mps)
    for _ in range(100):
        north_mps, _, _ = hover.velocity(0.02, (0.5, 0.0, -3.0), 3.0, vel_rover_ned_mps)
    assert north_mps < (0.0 if vel_rover_ned_mps is None else 1.0) - 0.2


def test_a_climb_to_the_height_of_the_hover_begins_gently_and_is_not_faster_than_a_metre_per_second() -> None:
    hover, climb_mps = PausedHover(10.0), [0.0]
    for _ in range(100):
        velocity = hover.velocity(0.02, (0.0, 0.0, -1.0), 1.0)
        assert velocity[:2] == (0.0, 0.0)
        climb_mps.append(-velocity[2])
    assert 0.9 < climb_mps[-1] <= 1.0 + 1e-9
    assert max(b - a for a, b in pairwise(climb_mps)) <= 1.0 * 0.02 + 1e-9
