"""Arrival at a point: near and slow for a moment, or hovering about it as well as the wind allows."""

from collections.abc import Callable
from math import cos, pi, sin

import pytest

from jezero.base.frames import Vec3
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.arrival import HOVER_S, ArrivalDetector
from jezero.services.actions.motion.config import MoveConfig

CONFIG = MoveConfig()
RATE_HZ = 50
Path = Callable[[float], tuple[Vec3, Vec3]]
"""Vector from the vehicle to the point and velocity, by time in s."""


def arrival_s(path: Path, within_s: float = 20.0, *, turned: bool = True, wind_mps: float = 0.0) -> float | None:
    """Time at which the vehicle arrives, None when it doesn't."""
    detector = ArrivalDetector(CONFIG, CONFIG.reached_s)
    for step in range(int(within_s * RATE_HZ)):
        error_ned_m, vel_ned_mps = path(step / RATE_HZ)
        t_ns = step * NS_PER_S // RATE_HZ
        if detector.update(t_ns, error_ned_m, vel_ned_mps, turned=turned, wind_mps=wind_mps):
            return step / RATE_HZ
    return None


def sway(size_m: float, mean_m: float = 0.0, period_s: float = 3.0) -> Path:
    """Hover in gusts: swaying to and fro about a mean."""
    rate = 2.0 * pi / period_s
    return lambda t: ((mean_m + size_m * sin(rate * t), 0.0, 0.0), (-size_m * rate * cos(rate * t), 0.0, 0.0))


def test_a_vehicle_at_rest_near_the_point_arrives_after_the_settings_time() -> None:
    assert arrival_s(lambda t: ((0.1, 0.0, 0.1), (0.0, 0.1, 0.0))) == pytest.approx(CONFIG.reached_s, abs=0.05)


@pytest.mark.parametrize("size_m", [0.15, 0.3, 0.4])
def test_a_vehicle_that_gusts_sway_about_the_point_arrives_too(size_m: float) -> None:
    assert arrival_s(sway(size_m)) == pytest.approx(HOVER_S, abs=1.5)


def test_a_vehicle_that_sways_about_another_point_has_not_arrived() -> None:
    assert arrival_s(sway(0.2, mean_m=0.5)) is None


@pytest.mark.parametrize(("wind_mps", "arrives"), [(6.0, False), (12.0, True)])
def test_a_strong_wind_allows_more_sway_than_a_moderate_one(wind_mps: float, arrives: bool) -> None:
    """A sway of 1.2 m with up to 1.26 m/s, about a place 0.4 m beside the point."""
    assert (arrival_s(sway(1.2, mean_m=0.4, period_s=6.0), wind_mps=wind_mps) is not None) is arrives


def test_a_vehicle_that_gusts_carry_far_away_has_not_arrived() -> None:
    assert arrival_s(sway(1.5, period_s=12.0)) is None


def test_a_vehicle_that_still_comes_nearer_has_not_arrived() -> None:
    def path(t: float) -> tuple[Vec3, Vec3]:
        return (max(0.0, 1.2 - 0.1 * t), 0.0, 0.0), (0.1 if t < 12.0 else 0.0, 0.0, 0.0)

    arrived_s = arrival_s(path)
    assert arrived_s is not None
    assert 1.2 - 0.1 * arrived_s < CONFIG.reached_m


def test_a_vehicle_with_another_heading_than_it_must_have_has_not_arrived() -> None:
    assert arrival_s(sway(0.2), turned=False) is None
    assert arrival_s(lambda t: ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), turned=False) is None
