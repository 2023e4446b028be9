"""Protection against the ground: only the altimeter counts, and a single reading never ends a goal."""

import pytest

from jezero.schemas.commands import Phase
from jezero.schemas.goals import MoveFeedback
from jezero.services.actions.lifecycle.ground_proximity import GroundProximity
from jezero.services.actions.motion.behaviour import Move, VehicleState
from jezero.vehicle_config import VehicleConfig

VEHICLE = VehicleConfig()
STEP_NS = 50_000_000


def problem_at(
    clearance_m: float | None, down_mps: float, *, north_mps: float = 0.0, phase: Phase = Phase.GO_TO, steps: int = 5
) -> str:
    """Problem after some steps of 0.05 s in the same state, with an estimated altitude of 8 m."""
    height_m = None if clearance_m is None else clearance_m + VEHICLE.height_altimeter_m
    state = VehicleState((0.0, 0.0, -8.0), (north_mps, 0.0, down_mps), (1.0, 0.0, 0.0, 0.0), True, False, 0.0, height_m)
    feedback = MoveFeedback(pos_uav_ned_m=(0.0, 0.0, -8.0), distance_m=1.0)
    move = Move(phase, feedback, pos_ned_m=(0.0, 0.0, -7.0))
    guard = GroundProximity(VEHICLE)
    return [guard.problem(step * STEP_NS, state, move) for step in range(steps)][-1]


@pytest.mark.parametrize(
    ("clearance_m", "down_mps", "ends"),
    [
        (0.57, 1.0, True),  # 1 m/s needs 1² / (2 · 1.5) = 0.33 m, and 0.25 m must be left
        (0.60, 1.0, False),
        (0.20, 0.05, True),
        (0.20, -0.5, False),  # climbs
        (0.05, 0.0, True),  # stands
        (3.0, 2.0, False),
    ],
)
def test_a_goal_ends_while_there_is_still_room_to_brake(clearance_m: float, down_mps: float, ends: bool) -> None:
    assert bool(problem_at(clearance_m, down_mps)) is ends


def test_the_reason_has_the_measured_height() -> None:
    assert "measures only 0.2 m below the vehicle's feet" in problem_at(0.2, 0.5)


def test_a_low_vehicle_that_only_moves_sideways_flies_on() -> None:
    assert not problem_at(0.2, 0.0, north_mps=1.0)


@pytest.mark.parametrize("phase", [Phase.TAKEOFF, Phase.LANDING])
def test_takeoff_and_landing_may_be_at_the_ground(phase: Phase) -> None:
    assert not problem_at(0.05, 0.5, phase=phase)


def test_a_single_reading_ends_nothing() -> None:
    assert not problem_at(0.0, 1.0, steps=1)


def test_without_an_altimeter_nothing_is_concluded() -> None:
    assert not problem_at(None, 1.0)
