"""A wind of 8 m/s pushes against a fence; `python -m benchmarks.quality.fence` flies 50 seeds."""

import pytest

from benchmarks.quality.fence import BEYOND_MAX_M, FIRST_SEED, push


@pytest.mark.parametrize("seed", [FIRST_SEED, FIRST_SEED + 1])
def test_neither_wind_nor_setpoints_carry_the_vehicle_farther_beyond_the_fence_than_the_margin(seed: int) -> None:
    pushed = push(seed)
    assert pushed.hover_m <= BEYOND_MAX_M
    assert -0.6 < pushed.outwards_m <= BEYOND_MAX_M
    assert pushed.speed_mps > 3.0
