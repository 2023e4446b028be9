"""The autopilot's parameters, set when it first connects."""

import struct

import msgspec
import pytest

from jezero.base.config import load_config
from jezero.base.mavlink import dialect
from jezero.runtime.service import Health
from jezero.schemas.state import Battery
from jezero.services.vehicle_bridge.config import ParameterValue, VehicleBridgeConfig
from jezero.services.vehicle_bridge.parameters import INT32, REAL32, TRIES, ParameterSetter, decoded, encoded
from tests.services.vehicle_bridge.rig import MODES, Rig

S = 1_000_000_000
WANTED = {"COM_RC_IN_MODE": 4, "NAV_DLL_ACT": -1, "COM_OF_LOSS_T": 1.5}


def rig_with(known: dict[str, int | float], wanted: dict[str, int | float] | None = None) -> Rig:
    rig = Rig(VehicleBridgeConfig(parameters=WANTED if wanted is None else wanted))
    rig.autopilot.parameters = dict(known)
    return rig


def last_health(rig: Rig) -> str:
    return [o.text for o in rig.outputs if isinstance(o, Health)][-1]


def test_integers_travel_as_their_bytes_and_floats_as_floats() -> None:
    carried, kind = encoded(4)
    assert (struct.pack("<f", carried), kind) == (b"\x04\0\0\0", INT32)
    assert encoded(1.5) == (1.5, REAL32)
    for value in (0, 1, -1, 21196, -4_194_304, 2_139_095_040):
        assert decoded(struct.unpack("<f", struct.pack("<f", encoded(value)[0]))[0], INT32) == value
    assert (INT32, REAL32) == (dialect.MAV_PARAM_TYPE_INT32, dialect.MAV_PARAM_TYPE_REAL32)


@pytest.mark.parametrize("value", [-4_194_305, 2_139_095_041])
def test_an_integer_whose_bytes_are_no_number_of_a_float_is_refused(value: int) -> None:
    """An integer travels as the bytes of a float. These bytes are a NaN, which may arrive as another NaN."""
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(value, ParameterValue)
    msgspec.convert(value - 1 if value > 0 else value + 1, ParameterValue)


def test_all_are_set_and_confirmed_before_the_vehicle_is_ready() -> None:
    rig = rig_with({"COM_RC_IN_MODE": 1, "NAV_DLL_ACT": 0, "COM_OF_LOSS_T": 1.0, "OTHER": 7})
    rig.run_until(lambda: bool(rig.statuses))
    assert "parameters are being set: COM_RC_IN_MODE" in rig.status.not_ready_reason
    rig.ready()
    assert rig.autopilot.parameters == {**WANTED, "OTHER": 7}
    assert rig.autopilot.set_parameters == list(WANTED)
    rig.run(3.0)
    assert rig.autopilot.set_parameters == list(WANTED), "set once, not again and again"


def test_a_lost_one_is_set_again() -> None:
    setter = ParameterSetter({"A": 1})
    assert setter.due(0) == [("A", *encoded(1))]
    assert setter.due(S // 10) == []
    assert setter.due(S // 2) == [("A", *encoded(1))]
    setter.confirm("A", *encoded(1))
    assert setter.due(S) == []
    assert setter.pending == ()


def test_each_of_several_has_its_own_tries_and_they_are_sent_again_together_three_times_a_second() -> None:
    setter, ms = ParameterSetter({"A": 1, "B": 2.5, "C": -3}), 1_000_000
    sent_ms = {t: [name for name, _, _ in sent] for t in range(0, 6000, 100) if (sent := setter.due(t * ms))}
    assert list(sent_ms) == [300 * number for number in range(TRIES)]
    assert all(names == ["A", "B", "C"] for names in sent_ms.values())
    assert setter.pending == ()
    assert setter.failure_text == "; ".join(f"parameter {name} is unknown to the autopilot" for name in "ABC")
    setter.restart()
    assert setter.failure_text == ""
    assert [name for name, _, _ in setter.due(0)] == ["A", "B", "C"], "another autopilot"


def test_what_another_autopilot_had_is_not_said_of_the_present_one() -> None:
    setter = ParameterSetter({"A": 99})
    setter.confirm("A", *encoded(3))
    setter.restart()
    for i in range(TRIES + 1):
        setter.due(i * S)
    assert setter.failure_text == "parameter A is unknown to the autopilot"


def test_a_value_that_is_refused_is_named_as_the_autopilot_has_it() -> None:
    setter = ParameterSetter({"A": 99, "B": 2.0})
    setter.confirm("A", *encoded(-3))
    setter.confirm("B", 0.5, REAL32)
    for i in range(TRIES + 1):
        setter.due(i * S)
    assert setter.failure_text == "parameter A stays -3; parameter B stays 0.5"


def test_the_batterys_critical_level_is_requested_until_it_comes_and_follows_changes() -> None:
    rig = rig_with({"BAT_CRIT_THR": 0.07}, {})
    rig.autopilot.battery_percent = 87
    rig.autopilot.lost_reads = 2
    rig.ready()
    assert rig.status.battery == Battery(voltage_v=15.3, remaining=0.87)
    rig.run(6.0)
    assert rig.autopilot.read_parameters == ["BAT_CRIT_THR"] * 3
    assert rig.status.battery == Battery(voltage_v=15.3, remaining=0.87, critical=0.07)
    rig.autopilot.parameters["BAT_CRIT_THR"] = 0.2
    rig.autopilot.unasked = rig.autopilot.parameter("BAT_CRIT_THR")
    rig.run(1.0)
    assert rig.status.battery == Battery(voltage_v=15.3, remaining=0.87, critical=0.2)


@pytest.mark.parametrize(
    ("known", "failure"),
    [
        ({}, "parameter A is unknown to the autopilot"),
        ({"A": 2.0}, "parameter A is unknown to the autopilot"),
    ],
)
def test_one_that_the_autopilot_does_not_know_is_reported_and_does_no_harm(
    known: dict[str, int | float], failure: str
) -> None:
    rig = rig_with({**known, "B": 0.0}, {"A": 1, "B": 2.0})
    rig.ready()
    assert failure in last_health(rig)
    assert len(rig.autopilot.set_parameters) == TRIES + 1
    assert rig.autopilot.parameters["B"] == 2.0
    assert rig.acquire().granted


def test_a_value_that_is_refused_is_reported() -> None:
    setter = ParameterSetter({"A": 99})
    for i in range(TRIES):
        assert setter.due(i * S)
        setter.confirm("A", *encoded(3))
    assert setter.due(TRIES * S) == []
    assert setter.failure_text == "parameter A stays 3"
    setter.confirm("A", *encoded(99))
    assert setter.failure_text == ""


def test_an_earlier_value_does_not_count_as_confirmed() -> None:
    setter = ParameterSetter({"A": 1})
    setter.due(0)
    setter.confirm("A", *encoded(0))
    setter.confirm("A", 1.0, REAL32)
    setter.confirm("B", *encoded(1))
    assert setter.pending == ("A",)


def test_an_autopilot_that_restarted_is_given_them_again() -> None:
    rig = rig_with(dict(WANTED)).ready()
    rig.autopilot.silent = True
    rig.run(0.4)
    rig.autopilot.silent = False
    rig.epoch_id += 1
    rig.autopilot.parameters = {"COM_RC_IN_MODE": 1, "NAV_DLL_ACT": 0, "COM_OF_LOSS_T": 1.0}
    rig.run(0.2)
    rig.ready()
    assert rig.autopilot.parameters == WANTED


def test_in_flight_nothing_is_set() -> None:
    rig = rig_with(dict(WANTED))
    rig.autopilot.armed, rig.autopilot.mode = True, MODES["OFFBOARD"]
    rig.lift_off()
    rig.run(3.0)
    assert rig.autopilot.set_parameters == []
    rig.autopilot.armed, rig.autopilot.landed = False, True
    rig.run(0.5)
    assert rig.autopilot.set_parameters == list(WANTED)


@pytest.mark.parametrize(
    "toml", ["a = 1", "TOO_LONG_FOR_A_NAME = 1", "A = true", "A = nan", "A = 3000000000", 'A = "1"', "A = 1e31"]
)
def test_a_parameter_that_could_not_be_sent_is_refused_when_the_settings_are_read(toml: str) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.toml.decode(f"[parameters]\n{toml}", type=VehicleBridgeConfig)


def test_in_the_settings_1_is_an_integer_and_1_point_0_a_float() -> None:
    config = msgspec.toml.decode("[parameters]\nA = 1\nB = 1.0", type=VehicleBridgeConfig)
    assert [type(value) for value in config.parameters.values()] == [int, float]
    assert load_config(VehicleBridgeConfig, "vehicle_bridge").rate_hz == 50.0
