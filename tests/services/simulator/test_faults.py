"""Each injected fault changes what its sensor says, and ends."""

from collections.abc import Iterator
from statistics import fmean, pstdev
from typing import Any

import pytest

from jezero.base.frames import ned_from_geodetic
from jezero.base.mavlink import dialect
from jezero.base.vehicle_config import PlanetConfig
from jezero.schemas import topics
from jezero.schemas.rows import Topic
from jezero.schemas.sensors import Altimeter
from jezero.schemas.simulator import FAULTS, FaultKind, FaultUnit, PlaceBody, SetFault
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.faults import InjectedFaults
from tests.services.simulator.test_control import CALM, ControlBench
from tests.services.simulator.test_service import published, sent

TOPICS: dict[FaultUnit, Topic[Any]] = {
    "mag": topics.MAG,
    "baro": topics.BARO,
    "gps": topics.GNSS,
    "distance_sensor": topics.ALTIMETER,
    "uwb": topics.UWB,
    "rover_odometry": topics.ROVER_ODOMETRY,
    "camera": topics.SCENE,
}
SECOND = 250
"""Steps of a second."""
INSTANCES: dict[FaultUnit, int] = {"motor": 4, "uwb": 4}
ORIGIN_DEG = SimulatorConfig().origin.origin_deg


@pytest.fixture
def bench() -> ControlBench:
    bench = ControlBench(SimulatorConfig(wind=CALM))
    bench.run(SECOND)
    return bench


def value_of(unit: FaultUnit, message: Any) -> tuple[float, ...]:
    """What a reading measures."""
    match unit:
        case "gps":
            return tuple(ned_from_geodetic(message.position_deg, ORIGIN_DEG))
        case "mag":
            return tuple(message.field_frd_gauss)
        case "baro":
            return (message.pressure_pa,)
        case "distance_sensor":
            return (message.range_m,)
        case "uwb":
            return tuple(each.range_m for each in message.ranges)
        case _:
            return (message.yaw_rover_rad,)


def count(unit: FaultUnit, outputs: list[Any]) -> int:
    """Number of readings, of a sensor of the autopilot's own at the rate at which the autopilot gets them."""
    if unit in ("mag", "baro"):
        bit = 0x40 if unit == "mag" else 0x200
        return sum(bool(m.fields_updated & bit) for m in sent(outputs, dialect.MAVLINK_MSG_ID_HIL_SENSOR))
    return len(published(outputs, TOPICS[unit]))


def mean_of(unit: FaultUnit, messages: list[Any]) -> tuple[float, ...]:
    values = [value_of(unit, message) for message in messages]
    return tuple(fmean(part) for part in zip(*values, strict=True))


UNITS: list[FaultUnit] = [unit for unit in TOPICS if unit != "camera"]
WRONG: dict[FaultUnit, tuple[float, float]] = {
    "gps": (20.0, 0.5),
    "mag": (0.165, 0.02),
    "baro": (113.4, 5.0),
    "uwb": (2.0, 0.1),
    "rover_odometry": (0.5, 0.05),
}
"""Length of the error of each wrong sensor, and its tolerance; of UWB that of four ranges together."""


@pytest.mark.parametrize("unit", [*UNITS, "camera"])
def test_off_silences_a_sensor_until_ok(bench: ControlBench, unit: FaultUnit) -> None:
    assert published(bench.run(SECOND), TOPICS[unit])
    bench.does(SetFault(unit=unit, kind="off"))
    bench.run(SECOND // 4)  # what was measured before arrives
    assert not published(bench.run(SECOND), TOPICS[unit])
    bench.does(SetFault(unit=unit, kind="ok"))
    assert published(bench.run(SECOND), TOPICS[unit])
    assert bench.does(None).faults == ()


def at_height(bench: ControlBench) -> None:
    """Fly, so that the altimeter measures something."""
    bench.command = 0.6
    bench.run(SECOND)
    bench.does(PlaceBody(north_m=0.0, east_m=0.0, height_m=5.0))


@pytest.mark.parametrize("unit", UNITS)
def test_stuck_repeats_one_reading_with_new_times(bench: ControlBench, unit: FaultUnit) -> None:
    at_height(bench)
    bench.does(SetFault(unit=unit, kind="stuck"))
    bench.run(SECOND // 4)
    readings = published(bench.run(SECOND), TOPICS[unit])
    assert len({value_of(unit, reading) for reading in readings}) == 1
    assert len({reading.t_ns for reading in readings}) == len(readings) > 5
    bench.does(SetFault(unit=unit, kind="ok"))
    bench.run(SECOND // 4)
    assert len({value_of(unit, reading) for reading in published(bench.run(SECOND), TOPICS[unit])}) > 1


@pytest.mark.parametrize("unit", [unit for unit in UNITS if unit != "distance_sensor"])
def test_wrong_adds_an_error_until_ok(bench: ControlBench, unit: FaultUnit) -> None:
    before = mean_of(unit, published(bench.run(SECOND), TOPICS[unit]))
    bench.does(SetFault(unit=unit, kind="wrong"))
    bench.run(SECOND // 4)
    error, tolerance = WRONG[unit]
    wrong = mean_of(unit, published(bench.run(SECOND), TOPICS[unit]))
    assert distance_of(before, wrong) == pytest.approx(error, abs=tolerance)
    bench.does(SetFault(unit=unit, kind="ok"))
    bench.run(SECOND // 4)
    after = mean_of(unit, published(bench.run(SECOND), TOPICS[unit]))
    assert distance_of(before, after) < max(0.2 * error, tolerance)


def test_a_wrong_altimeter_measures_a_metre_more_and_keeps_what_met_nothing() -> None:
    faults = InjectedFaults(1, PlanetConfig(), INSTANCES)
    faults.set(SetFault(unit="distance_sensor", kind="wrong"), 0)
    assert faults.reading("distance_sensor", Altimeter(t_ns=1, range_m=4.0)).range_m == 5.0
    assert faults.reading("distance_sensor", Altimeter(t_ns=1, range_m=None)).range_m is None


@pytest.mark.parametrize("unit", UNITS)
def test_garbage_scatters_far_beyond_the_noise(bench: ControlBench, unit: FaultUnit) -> None:
    at_height(bench)
    bench.does(SetFault(unit=unit, kind="garbage"))
    bench.run(SECOND // 4)
    values = [value_of(unit, reading)[0] for reading in published(bench.run(SECOND), TOPICS[unit])]
    least = {"gps": 200.0, "mag": 0.3, "baro": 2000.0, "distance_sensor": 3.0, "uwb": 3.0, "rover_odometry": 0.5}
    assert pstdev(values) > least[unit]


def counts_with(bench: ControlBench, kind: FaultKind, seconds: int) -> Iterator[tuple[int, int]]:
    """Number of readings of each sensor before all of them have a fault, and with it."""
    before = bench.run(seconds * SECOND)
    for unit in TOPICS:
        bench.does(SetFault(unit=unit, kind=kind))
    bench.run(SECOND // 4)
    after = bench.run(seconds * SECOND)
    return ((count(unit, before), count(unit, after)) for unit in TOPICS)


def test_slow_gives_every_fifth_reading(bench: ControlBench) -> None:
    for number, slow in counts_with(bench, "slow", 4):
        assert number / 6 - 1 <= slow <= number / 4 + 1


def test_intermittent_loses_most_readings(bench: ControlBench) -> None:
    for number, left in counts_with(bench, "intermittent", 8):
        assert 0.1 * number < left < 0.5 * number


@pytest.mark.parametrize("unit", UNITS)
def test_delayed_readings_arrive_half_a_second_later(bench: ControlBench, unit: FaultUnit) -> None:
    def age_ns() -> float:
        ages = []
        for _ in range(SECOND):
            ages += [bench.t_ns - reading.t_ns for reading in published(bench.run(1), TOPICS[unit])]
        return fmean(ages)

    before = age_ns()
    bench.does(SetFault(unit=unit, kind="delayed"))
    bench.run(SECOND)
    assert age_ns() - before == pytest.approx(0.5e9, abs=0.02e9)


@pytest.mark.parametrize(
    ("unit", "fields"), [("accel", ("xacc", "yacc", "zacc")), ("gyro", ("xgyro", "ygyro", "zgyro"))]
)
def test_accelerometer_and_gyroscope_fail_for_the_autopilot_too(
    bench: ControlBench, unit: FaultUnit, fields: tuple[str, ...]
) -> None:
    def values(outputs: list[Any]) -> list[tuple[float, ...]]:
        found = sent(outputs, dialect.MAVLINK_MSG_ID_HIL_SENSOR)
        return [tuple(getattr(message, name) for name in fields) for message in found]

    good = values(bench.run(SECOND))
    bench.does(SetFault(unit=unit, kind="wrong"))
    wrong = values(bench.run(SECOND))
    error = 1.0 if unit == "accel" else 0.1
    assert fmean(v[0] for v in wrong) - fmean(v[0] for v in good) == pytest.approx(error, abs=0.02)
    bench.does(SetFault(unit=unit, kind="stuck"))
    assert len(set(values(bench.run(SECOND)))) == 1
    bench.does(SetFault(unit=unit, kind="garbage"))
    assert pstdev(v[1] for v in values(bench.run(SECOND))) > 5.0


def test_the_autopilot_gets_the_wrong_fix_too(bench: ControlBench) -> None:
    before = sent(bench.run(SECOND), dialect.MAVLINK_MSG_ID_HIL_GPS)[-1]
    bench.does(SetFault(unit="gps", kind="wrong"))
    after = sent(bench.run(SECOND), dialect.MAVLINK_MSG_ID_HIL_GPS)[-1]
    assert (after.lat - before.lat) * 0.0111 == pytest.approx(20.0, abs=1.0)


def test_one_motor_stands_still(bench: ControlBench) -> None:
    bench.command = 0.55
    bench.run(SECOND // 2)
    assert bench.does(None).height_uav_m > 0.05
    state = bench.does(SetFault(unit="motor", kind="off", instance=1))
    assert [(f.unit, f.instance) for f in state.faults] == [("motor", 1)]
    bench.run(60)
    tilted = published(bench.run(6), topics.TRUTH)[-1].q_ned_from_frd
    assert abs(tilted[0]) < 0.999


def test_one_anchor_fails_alone(bench: ControlBench) -> None:
    before = {r.anchor: r.range_m for r in published(bench.run(SECOND), topics.UWB)[-1].ranges}
    bench.does(SetFault(unit="uwb", kind="wrong", instance=2))
    bench.does(SetFault(unit="uwb", kind="off", instance=3))
    after = {r.anchor: r.range_m for r in published(bench.run(SECOND), topics.UWB)[-1].ranges}
    assert set(after) == set(before) - {2}
    assert after[1] - before[1] == pytest.approx(1.0, abs=0.1)
    assert after[0] - before[0] == pytest.approx(0.0, abs=0.1)
    assert bench.does(SetFault(unit="uwb", kind="ok")).faults == ()


def test_a_fault_ends_after_its_duration(bench: ControlBench) -> None:
    state = bench.does(SetFault(unit="gps", kind="off", duration_s=0.5))
    (fault,) = state.faults
    assert fault.until_t_ns == pytest.approx(state.t_ns + 500_000_000)
    bench.run(SECOND)
    assert bench.does(None).faults == ()


def test_a_unit_has_one_fault_at_a_time(bench: ControlBench) -> None:
    bench.does(SetFault(unit="gps", kind="off"))
    state = bench.does(SetFault(unit="gps", kind="wrong"))
    assert [fault.kind for fault in state.faults] == ["wrong"]


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (SetFault(unit="motor", kind="stuck"), "motor has: off, ok"),
        (SetFault(unit="gyro", kind="off"), "gyro has: stuck, garbage, wrong, ok"),
        (SetFault(unit="gps", kind="off", instance=2), "one gps only"),
        (SetFault(unit="motor", kind="off", instance=5), "4 motors"),
        (SetFault(unit="uwb", kind="delayed", instance=1), "one anchor can't be delayed"),
    ],
)
def test_a_fault_that_does_not_exist_is_refused(bench: ControlBench, request_: SetFault, said: str) -> None:
    assert said in bench.refuses(request_)


def test_every_fault_that_is_named_is_accepted(bench: ControlBench) -> None:
    for unit, kinds in FAULTS.items():
        for kind in kinds:
            assert bench.does(SetFault(unit=unit, kind=kind)).faults
        assert not bench.does(SetFault(unit=unit, kind="ok")).faults


def distance_of(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    return float(sum((a - b) ** 2 for a, b in zip(one, other, strict=True)) ** 0.5)
