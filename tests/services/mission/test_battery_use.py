"""The use of the battery is measured from the steps of its reported charge."""

import pytest

from jezero.schemas.units import NS_PER_S
from jezero.services.mission.battery_use import BatteryUse


def fly(use: BatteryUse, percent_per_s: float, seconds: int, begin: float = 1.0) -> None:
    for second in range(seconds):
        use.update(second * NS_PER_S, round(begin - 0.01 * percent_per_s * second, 2))


def test_the_declared_use_holds_until_the_charge_has_fallen_by_some_percent() -> None:
    use = BatteryUse(declared_per_s=0.001)
    fly(use, 0.2, 15)
    assert use.per_s == 0.001


def test_a_flight_that_uses_more_than_declared_is_measured() -> None:
    use = BatteryUse(declared_per_s=0.001)
    fly(use, 0.2, 60)
    assert use.per_s == pytest.approx(0.002, rel=0.05)


def test_another_battery_starts_the_measurement_anew() -> None:
    use = BatteryUse(declared_per_s=0.001)
    fly(use, 0.2, 60, begin=0.5)
    use.update(61 * NS_PER_S, 1.0)
    assert use.per_s == 0.001


def test_a_flight_that_is_over_is_forgotten() -> None:
    use = BatteryUse(declared_per_s=0.001)
    fly(use, 0.2, 60)
    use.reset()
    assert use.per_s == 0.001
