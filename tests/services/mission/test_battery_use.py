"""The use of the battery is measured from the slope of its reported charge."""

from collections.abc import Callable
from random import Random

import pytest

from jezero.schemas.units import NS_PER_S
from jezero.services.mission.battery_use import BatteryUse

DECLARED_PER_S = 0.001


def fly(charge: Callable[[int], float], seconds: int) -> BatteryUse:
    """The use after a flight in which the charge is reported in whole percents, ten times a second."""
    use = BatteryUse(DECLARED_PER_S)
    for tenth in range(10 * seconds):
        use.update(tenth * NS_PER_S // 10, round(charge(tenth // 10), 2))
    return use


def test_the_declared_use_holds_until_the_flight_is_long_enough_to_measure_it() -> None:
    assert fly(lambda second: 1.0 - 0.002 * second, 25).per_s == DECLARED_PER_S


def test_a_flight_that_uses_more_than_declared_is_measured() -> None:
    assert fly(lambda second: 1.0 - 0.002 * second, 60).per_s == pytest.approx(0.002, rel=0.05)


def test_a_voltage_that_sags_at_the_takeoff_is_no_use() -> None:
    sag = fly(lambda second: (1.0 if second < 3 else 0.92) - 0.001 * second, 40)
    assert sag.per_s < 0.0025
    assert fly(lambda second: (1.0 if second < 3 else 0.92) - 0.001 * second, 120).per_s == pytest.approx(
        0.001, rel=0.1
    )


def test_a_charge_that_is_estimated_from_a_noisy_voltage_is_measured() -> None:
    rng = Random(1)
    assert fly(lambda second: 1.0 - 0.001 * second + rng.gauss(0.0, 0.015), 90).per_s == pytest.approx(0.001, abs=4e-4)


def test_a_battery_that_empties_more_slowly_again_is_measured_anew() -> None:
    fast = fly(lambda second: 1.0 - 0.008 * min(second, 50) - 0.0008 * max(second - 50, 0), 150)
    assert fast.per_s == pytest.approx(0.0008, rel=0.1)


@pytest.mark.parametrize(
    "charge",
    [
        lambda second: 0.8,
        lambda second: 0.5 + 0.001 * second,
        lambda second: max(0.5, 0.8 - 0.016 * second),
        lambda second: 0.3 if second < 200 else 1.0,
        lambda second: 0.8 - 0.0001 * second,
    ],
    ids=["stands still", "rises", "stands still later", "jumps", "hardly falls"],
)
def test_no_gauge_makes_the_use_less_than_half_of_the_declared_one(charge: Callable[[int], float]) -> None:
    for seconds in (60, 150, 300):
        use = fly(charge, seconds)
        assert use.per_s >= 0.5 * DECLARED_PER_S
        assert use.charge is not None
        assert use.charge <= charge(0) - 0.5 * DECLARED_PER_S * (seconds - 1) + 1e-9


def test_the_charge_of_a_gauge_that_stands_still_is_reckoned_with_the_declared_use() -> None:
    assert fly(lambda second: 0.8, 300).charge == pytest.approx(0.8 - DECLARED_PER_S * 300, abs=0.02)
    working_until = fly(lambda second: 0.8 - DECLARED_PER_S * min(second, 200), 500)
    assert working_until.charge == pytest.approx(0.8 - DECLARED_PER_S * 500, abs=0.04)


def test_the_charge_of_a_gauge_that_works_is_believed() -> None:
    assert fly(lambda second: 1.0 - 0.001 * second, 120).charge == pytest.approx(0.88, abs=0.006)


def test_a_flight_that_is_over_is_forgotten() -> None:
    use = fly(lambda second: 1.0 - 0.002 * second, 60)
    use.reset()
    assert use.per_s == DECLARED_PER_S
