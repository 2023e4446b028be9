"""The battery: charge, current and voltage of a vehicle that hovers."""

import pytest

from jezero.base.vehicle_config import BatteryConfig
from jezero.services.autopilot.battery import BatteryModel

HOVER = 0.5


def test_hovering_for_a_minute_takes_a_minutes_charge_and_voltage_falls_with_it() -> None:
    battery = BatteryModel(BatteryConfig(), 1.0, HOVER)
    full_v = battery.voltage_v
    for _ in range(600):
        battery.step(0.1, (0.5, 0.5, 0.5, 0.5))
    assert battery.current_a == pytest.approx(15.5)
    assert battery.used_mah == pytest.approx(15.5 / 60.0 * 1000.0)
    assert battery.remaining == pytest.approx(1.0 - battery.used_mah / 5000.0)
    assert full_v == pytest.approx(16.2)
    assert 15.5 < battery.voltage_v < full_v


def test_an_empty_battery_is_not_less_than_empty() -> None:
    battery = BatteryModel(BatteryConfig(), 0.0, HOVER)
    battery.step(10.0, (1.0, 1.0, 1.0, 1.0))
    assert battery.remaining == 0.0
