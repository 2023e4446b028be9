"""A reported charge that stands still in flight is noticed, and one that falls slowly is not."""

from collections.abc import Callable

import pytest

from jezero.base.vehicle_config import BatteryConfig
from jezero.schemas.state import Battery
from jezero.schemas.units import NS_PER_S
from jezero.services.preflight.charge_watch import ChargeWatch
from tests.services.preflight.healthy import status

HOVER_PER_S = BatteryConfig().used(1.0)


def problem(charge: Callable[[int], float], seconds: int, *, flies: bool = True) -> str:
    """What the watch says after some seconds of reports in whole percents, ten a second."""
    watch = ChargeWatch(BatteryConfig())
    for tenth in range(10 * seconds):
        battery = Battery(voltage_v=16.0, remaining=round(charge(tenth // 10), 2), critical=0.07)
        watch.update(status(t_ns=tenth * NS_PER_S // 10, armed=flies, landed=not flies, battery=battery))
    return watch.problem


@pytest.mark.parametrize("share", [0.5, 0.7, 1.0, 2.0])
def test_a_charge_that_falls_as_in_a_flight_is_believed(share: float) -> None:
    assert problem(lambda second: 0.9 - share * HOVER_PER_S * second, 300) == ""


@pytest.mark.parametrize("share", [-1.0, -0.1, 0.0, 0.1])
def test_a_charge_that_stands_still_or_rises_is_named(share: float) -> None:
    assert "its gauge stands still" in problem(lambda second: 0.5 - share * HOVER_PER_S * second, 200)


def test_a_charge_that_stands_still_later_is_named() -> None:
    assert "stands still" in problem(lambda second: 0.9 - HOVER_PER_S * min(second, 200), 400)


def test_a_charge_that_rises_by_a_twentieth_after_the_takeoff_is_believed() -> None:
    assert problem(lambda second: (0.85 if second < 20 else 0.9) - HOVER_PER_S * second, 300) == ""


def test_the_charge_of_a_vehicle_that_stands_may_stand_still() -> None:
    assert problem(lambda second: 0.8, 600, flies=False) == ""


def test_a_short_flight_is_not_judged() -> None:
    assert problem(lambda second: 0.8, 100) == ""
