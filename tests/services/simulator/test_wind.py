"""Mean wind and gusts have the strength and the memory that the Dryden form gives them."""

import numpy as np
import pytest

from jezero.services.simulator.config import WindConfig
from jezero.services.simulator.noise import Wander, generator, normals_of
from jezero.services.simulator.wind import WindModel, dryden_scales

HEIGHT_M = 10.0


def gusts(config: WindConfig, dt_s: float, steps: int, seed: int = 1) -> np.ndarray:
    wind = WindModel(config, dt_s, normals_of(generator(seed, "wind")))
    return np.array([wind.step(HEIGHT_M) for _ in range(steps)])


def test_scale_lengths_at_a_hundred_feet() -> None:
    """MIL-F-8785C at h = 100 ft: L_u = 100 / 0.2593^1.2 = 505 ft, L_w = 100 ft, ratio 0.2593^0.4 = 0.583."""
    horizontal_m, vertical_m, share = dryden_scales(30.48)
    assert horizontal_m == pytest.approx(153.9, rel=0.005)
    assert vertical_m == pytest.approx(30.48, rel=1e-3)
    assert share == pytest.approx(0.583, rel=0.005)


def test_a_west_wind_blows_to_the_east() -> None:
    wind = WindModel(
        WindConfig(mean_mps=3.0, from_deg=270.0, std_gust_mps=0.0), 0.004, normals_of(generator(1, "wind"))
    )
    assert wind.step(5.0) == pytest.approx((0.0, 3.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("dt_s", [0.2, 2.0])
def test_gusts_have_the_variance_asked_for_at_any_step(dt_s: float) -> None:
    horizontal_m, _, share = dryden_scales(HEIGHT_M)
    v = gusts(WindConfig(mean_mps=6.0, from_deg=180.0, std_gust_mps=0.6), dt_s, 30_000)
    tau_s = horizontal_m / 6.0
    tolerance = 4.0 * np.sqrt(2.0 * tau_s / (30_000 * dt_s))
    assert v[:, 0].mean() == pytest.approx(6.0, abs=0.25)
    assert v[:, 0].var() == pytest.approx(0.36, rel=tolerance)
    assert v[:, 1].var() == pytest.approx(0.36, rel=tolerance)
    assert v[:, 2].var() == pytest.approx(0.36 * share**2, rel=tolerance)


def test_gusts_at_the_physics_step_have_the_variance_over_many_seeds() -> None:
    last = np.array([gusts(WindConfig(std_gust_mps=0.6), 0.004, 25, seed)[-1] for seed in range(400)])
    _, _, share = dryden_scales(HEIGHT_M)
    std = last.std(axis=0)
    assert std[:2] == pytest.approx([0.6, 0.6], rel=0.15)
    assert std[2] == pytest.approx(0.6 * share, rel=0.15)


def test_gusts_forget_as_the_dryden_form_says() -> None:
    """Correlation at lag tau: e^-1 along, e^-1 / 2 across."""
    horizontal_m, _, _ = dryden_scales(HEIGHT_M)
    dt_s = horizontal_m / 6.0 / 10.0
    v = gusts(WindConfig(mean_mps=6.0, from_deg=180.0, std_gust_mps=1.0), dt_s, 60_000)
    along, across = v[:, 0] - v[:, 0].mean(), v[:, 1] - v[:, 1].mean()
    assert (along[:-10] * along[10:]).mean() / along.var() == pytest.approx(np.exp(-1.0), abs=0.06)
    assert (across[:-10] * across[10:]).mean() / across.var() == pytest.approx(0.5 * np.exp(-1.0), abs=0.06)


def test_a_wandering_error_is_random_at_the_start_and_keeps_its_spread() -> None:
    starts, ends = [], []
    for seed in range(500):
        wander = Wander(2.0, 10.0, 0.5, normals_of(generator(seed, "wander")))
        starts.append(wander.value)
        for _ in range(20):
            wander.step()
        ends.append(wander.value)
    assert np.std(starts) == pytest.approx(2.0, rel=0.13)
    assert np.std(ends) == pytest.approx(2.0, rel=0.13)
    assert np.corrcoef(starts, ends)[0, 1] == pytest.approx(np.exp(-1.0), abs=0.15)


def test_streams_of_different_names_are_independent() -> None:
    a, b, again = (normals_of(generator(5, name)) for name in ("imu", "gnss", "imu"))
    first = [a() for _ in range(3000)]
    assert first == [again() for _ in range(3000)]
    assert abs(np.corrcoef(first, [b() for _ in range(3000)])[0, 1]) < 0.08


def test_the_mean_wind_changes_in_flight() -> None:
    wind = WindModel(
        WindConfig(mean_mps=3.0, from_deg=270.0, std_gust_mps=0.0), 0.004, normals_of(generator(1, "wind"))
    )
    wind.change(8.0, 0.0)
    assert wind.step(5.0) == pytest.approx((-8.0, 0.0, 0.0))
