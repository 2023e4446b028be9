"""Every action, paused and resumed at random instants: the same result as without a pause, and no jump."""

from functools import partial
from math import dist
from statistics import quantiles

import pytest

from jezero.trials.pauses import PausedFlight, PausedGoal, fly_with_pauses
from jezero.trials.workers import workers

PICTURES_APART_MAX_M = 0.5
"""Between two pictures of one planned point: the vehicle is as far from its path in gusts."""
STEP_MARGIN_MPS = 0.15
"""Steps of the velocity setpoint follow the noise of the vehicle's position, which differs from flight to flight."""
TOUCHDOWN_STEP_MPS = 0.5
"""A landing begins to press down at its first contact, also when a pause has begun to brake it."""
SEEDS = range(10)
LANDING_P95_MAX_M = 0.1


def both_flights(seed: int, model: str) -> tuple[PausedFlight, PausedFlight]:
    """The flight of a seed without pauses, and the one with ten pauses of each goal."""
    plain = fly_with_pauses(seed, model)
    return plain, fly_with_pauses(seed, model, [goal.duration_s for goal in plain.goals])


def assert_same_result(plain: PausedGoal, paused: PausedGoal) -> None:
    assert plain.outcome == paused.outcome == "succeeded"
    assert paused.pauses >= 4, paused.refused
    assert list(paused.pictures_ned_m) == list(plain.pictures_ned_m)
    for index, pos_ned_m in plain.pictures_ned_m.items():
        assert dist(pos_ned_m, paused.pictures_ned_m[index]) < PICTURES_APART_MAX_M
    touchdown_mps = TOUCHDOWN_STEP_MPS if plain.action == "land_on_spot" else 0.0
    assert paused.step_mps < max(plain.step_mps, touchdown_mps) + STEP_MARGIN_MPS


@pytest.mark.long
def test_each_action_paused_at_random_instants_has_the_same_result() -> None:
    plain, paused = both_flights(1, "point-mass")
    assert [goal.action for goal in paused.goals] == [goal.action for goal in plain.goals]
    for one, other in zip(plain.goals, paused.goals, strict=True):
        assert_same_result(one, other)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_ten_seeds_with_physics_have_the_same_results_and_land_as_exactly() -> None:
    with workers(2) as pool:
        flights = pool.map(partial(both_flights, model="physics"), SEEDS, chunksize=1)
    errors_m = [[flight.touchdown_error_m for flight in column] for column in zip(*flights, strict=True)]
    for plain, paused in flights:
        print(f"seed {plain.seed}: touchdown {plain.touchdown_error_m:.3f} m, paused {paused.touchdown_error_m:.3f} m")
        for one, other in zip(plain.goals, paused.goals, strict=True):
            print("  " + in_words(one, other))
    p95_m = [quantiles(values, n=20)[-1] for values in errors_m]
    print(f"p95 of the touchdown error: {p95_m[0]:.3f} m without, {p95_m[1]:.3f} m with pauses")
    for plain, paused in flights:
        for one, other in zip(plain.goals, paused.goals, strict=True):
            assert_same_result(one, other)
    assert p95_m[1] < LANDING_P95_MAX_M


def in_words(plain: PausedGoal, paused: PausedGoal) -> str:
    common = plain.pictures_ned_m.keys() & paused.pictures_ned_m.keys()
    apart_m = max((dist(plain.pictures_ned_m[i], paused.pictures_ned_m[i]) for i in common), default=0.0)
    return (
        f"{paused.action}: {paused.outcome} after {paused.duration_s:.0f} s instead of {plain.duration_s:.0f} s, "
        f"{paused.pauses} pauses, {len(paused.refused)} refused, {len(paused.pictures_ned_m)} pictures "
        f"{apart_m:.2f} m apart, steps {plain.step_mps:.2f} and {paused.step_mps:.2f} m/s"
    )
