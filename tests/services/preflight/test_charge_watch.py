"""A reported charge that stands still in flight is noticed, and one that falls slowly is not."""

from collections.abc import Callable

import pytest

from jezero.base.vehicle_config import BatteryConfig
from jezero.schemas.state import Battery, Status
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


@pytest.mark.parametrize(("after", "named"), [(0.81, True), (0.79, True), (0.82, False), (0.78, False)])
def test_another_charge_after_the_landing_ends_the_problem(after: float, named: bool) -> None:
    watch = ChargeWatch(BatteryConfig())
    for second in range(200):
        watch.update(flying(second, 0.8))
    assert watch.problem
    watch.update(status(t_ns=200 * NS_PER_S, battery=Battery(voltage_v=16.0, remaining=after)))
    assert bool(watch.problem) is named


def test_a_flight_begins_with_each_takeoff_and_readings_without_a_charge_count_for_nothing() -> None:
    watch = ChargeWatch(BatteryConfig())
    for second in range(300):
        stands = second % 100 == 99
        watch.update(status(t_ns=second * NS_PER_S, battery=None))
        watch.update(flying(second, 0.8, armed=True, landed=stands))
        watch.update(flying(second, 0.8, armed=not stands, landed=False))
    assert watch.problem == ""


def flying(second: int, charge: float, *, armed: bool = True, landed: bool = False) -> Status:
    battery = Battery(voltage_v=16.0, remaining=charge, critical=0.07)
    return status(t_ns=second * NS_PER_S, armed=armed, landed=landed, battery=battery)


def test_a_short_flight_is_not_judged() -> None:
    assert problem(lambda second: 0.8, 100) == ""
