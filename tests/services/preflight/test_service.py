"""The rounds of the preflight service, on the in-memory bus with a vehicle that stands still."""

from collections.abc import Iterable
from random import Random
from typing import Any

import msgspec
import pytest

from jezero.base.codec import decode
from jezero.base.vehicle_config import BatteryConfig
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.runtime.service import Inbox, Output, Publish, Reply, Spec
from jezero.schemas.estimate import ParametersReply
from jezero.schemas.health import ServiceHealth
from jezero.schemas.preflight import GetPreflight, PreflightReply, PreflightReport
from jezero.schemas.sensors import Altimeter, Barometer
from jezero.schemas.state import Battery, Clock, StatusCode
from jezero.schemas.topics import ALTIMETER, BARO, CHECK_PREFLIGHT, CLOCK, GET_PARAMETERS, MAG, STATUS, health_of
from jezero.services.preflight.checks import LANDING_CHAIN
from jezero.services.preflight.service import Preflight
from tests.services.preflight.healthy import PARAMETERS, mag, status


class StandingVehicle:
    """Publishes clock, status and magnetometer, and the altimeter when it measures something.

    Attributes:
        status: fields of the status that differ from a healthy one.
        silent: the magnetometer sends nothing.
        epoch_id: id of the epoch.
        range_m: what the altimeter measures, and it scatters by `std_range_m`; None for nothing, so that it is silent.
        altitude_m: what the barometer measures; None for nothing, so that it is silent.
    """

    spec = Spec(name="vehicle_bridge", outputs=(CLOCK, STATUS, MAG, ALTIMETER, BARO), rate_hz=10.0)

    def __init__(self) -> None:
        self.status: dict[str, Any] = {}
        self.silent = False
        self.epoch_id = 1
        self.range_m: float | None = None
        self.std_range_m = 0.0
        self.altitude_m: float | None = None
        self._rng = Random(1)
        self._readings = mag()
        self._count = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        self._count += 1
        yield Publish(CLOCK, Clock(t_ns=t_ns, epoch_id=self.epoch_id, wall_ns=inbox.wall_ns))
        yield Publish(STATUS, status(t_ns=t_ns, **self.status))
        if not self.silent:
            reading = self._readings[self._count % len(self._readings)]
            yield Publish(MAG, msgspec.structs.replace(reading, t_ns=t_ns))
        if self.range_m is not None:
            range_m = self.range_m + self._rng.gauss(0.0, self.std_range_m)
            yield Publish(ALTIMETER, Altimeter(t_ns=t_ns, range_m=range_m))
        if self.altitude_m is not None:
            altitude_m = self.altitude_m
            pressure = Barometer(t_ns=t_ns, pressure_pa=9e4, altitude_pressure_m=altitude_m, temperature_degc=15.0)
            yield Publish(BARO, pressure)


class Idle:
    """A service that only publishes its health."""

    def __init__(self, name: str) -> None:
        self.spec = Spec(name=name, rate_hz=1.0)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        return ()


class IdleEstimator:
    """Replies to requests for the estimator's parameters, and does nothing else."""

    spec = Spec(name="estimator", serves=(GET_PARAMETERS,), triggers=(GET_PARAMETERS.name,), rate_hz=1.0)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        for request in inbox.requests(GET_PARAMETERS):
            yield Reply(request.request_id, ParametersReply(accepted=True, reason="", version=0, parameters=PARAMETERS))


class Bench:
    """A bus with the vehicle, the services of a landing and the preflight service, and every report so far."""

    def __init__(self) -> None:
        self.vehicle = StandingVehicle()
        self.reports: list[PreflightReport] = []
        self.bus = MemoryBus(0)
        self.bus.observe(self._observe)
        self.bus.add(self.vehicle)
        for name in LANDING_CHAIN:
            self.bus.add(IdleEstimator() if name == "estimator" else Idle(name))
        self.bus.add(Preflight(actions=("land_on_spot",)))

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == "preflight":
            self.reports.append(decode(PreflightReport, data))

    def wait_report(self, timeout_s: float) -> PreflightReport:
        count = len(self.reports)
        assert self.bus.run_for(timeout_s, stop=lambda: len(self.reports) > count), f"no report within {timeout_s} s"
        return self.reports[-1]

    def request(self) -> PreflightReport:
        sent = self.bus.send_request(CHECK_PREFLIGHT, GetPreflight())
        assert self.bus.run_for(10.0, stop=lambda: bool(sent.replies))
        reply = sent.replies[0]
        assert isinstance(reply, PreflightReply) and reply.report is not None
        return reply.report

    def request_while_silent(self, silent_s: float) -> SentRequest:
        """Wait for a report, then request another one, for whose first seconds the magnetometer sends nothing."""
        self.wait_report(3.0)
        self.vehicle.silent = True
        sent = self.bus.send_request(CHECK_PREFLIGHT, GetPreflight())
        self.bus.run_for(silent_s)
        return sent


def failed(report: PreflightReport) -> list[str]:
    return [check.name for check in report.failed()]


def test_a_vehicle_that_stands_is_checked_when_it_becomes_ready_and_every_ten_seconds() -> None:
    bench = Bench()
    bench.vehicle.status = {"ready": False, "not_ready_reason": "no position"}
    bench.bus.run_for(20.0)
    assert bench.reports == []
    bench.vehicle.status = {}
    first = bench.wait_report(2.0)
    second = bench.wait_report(12.0)
    assert failed(first) == failed(second) == []
    assert (second.t_ns - first.t_ns) / 1e9 == pytest.approx(11.3, abs=0.3)


def test_a_flying_vehicle_is_checked_on_request_only_and_again_after_the_landing() -> None:
    bench = Bench()
    bench.vehicle.status = {"code": int(StatusCode.HOVER), "landed": False}
    bench.bus.run_for(20.0)
    assert bench.reports == []
    assert failed(bench.request()) == []
    bench.vehicle.status = {}
    bench.wait_report(2.0)


def flying(charge: float) -> dict[str, Any]:
    return {
        "code": int(StatusCode.HOVER),
        "armed": True,
        "landed": False,
        "battery": Battery(voltage_v=16.0, remaining=round(charge, 2), critical=0.07),
    }


def test_a_charge_that_stands_still_in_flight_is_a_failed_check_until_it_changes() -> None:
    bench = Bench()
    bench.vehicle.status = flying(0.8)
    report = bench.wait_report(0.06 / BatteryConfig().least_used(1.0) + 10.0)
    assert failed(report) == ["battery"]
    assert "the charge went from 80% to 80% in 14" in report.failed()[0].text
    assert "its gauge stands still" in report.failed()[0].text
    standing = {"battery": Battery(voltage_v=16.0, remaining=0.8, critical=0.07)}
    bench.vehicle.status = standing
    assert failed(bench.wait_report(8.0)) == ["battery"]
    bench.vehicle.status = {"battery": Battery(voltage_v=16.4, remaining=0.95, critical=0.07)}
    assert failed(bench.wait_report(8.0)) == []


@pytest.mark.parametrize(
    ("range_m", "altitude_m", "named"),
    [
        (0.2, None, "by the altimeter 0.2 m"),
        (3.0, 488.0, "by the barometer 0.0 m, by the altimeter 3.0 m: the barometer is wrong"),
    ],
)
def test_a_sensor_that_measures_no_climb_at_the_takeoff_is_a_failed_check_in_flight(
    range_m: float, altitude_m: float | None, named: str
) -> None:
    bench = Bench()
    bench.vehicle.range_m, bench.vehicle.altitude_m = 0.2, altitude_m
    bench.wait_report(8.0)
    odometry = status().odometry
    assert odometry is not None
    bench.vehicle.status = {"code": int(StatusCode.TAKEOFF), "armed": True}
    bench.bus.run_for(1.0)
    climbed = msgspec.structs.replace(odometry, pos_uav_ned_m=(0.0, 0.0, -3.0))
    bench.vehicle.range_m = range_m
    bench.vehicle.status |= {"landed": False, "odometry": climbed}
    report = bench.wait_report(8.0)
    assert failed(report) == ["sensors"]
    assert named in report.failed()[0].text


@pytest.mark.parametrize(("std_m", "verdict"), [(0.03, "passed"), (0.3, "failed")])
def test_readings_that_scatter_more_than_the_estimators_parameters_say_are_a_failed_check(
    std_m: float, verdict: str
) -> None:
    bench = Bench()
    bench.vehicle.range_m, bench.vehicle.std_range_m = 0.4, std_m
    bench.wait_report(8.0)
    noise = next(check for check in bench.request().checks if check.name == "noise")
    assert (noise.verdict, "altimeter 0." in noise.text) == (verdict, True)


def test_a_sensor_that_is_silent_for_two_seconds_passes_and_for_longer_fails_until_it_sends_again() -> None:
    bench = Bench()
    sent = bench.request_while_silent(2.0)
    bench.vehicle.silent = False
    assert failed(bench.wait_report(1.0)) == []
    bench.bus.run_for(0.1)
    assert sent.replies, "the report is the one that was requested"
    bench.vehicle.silent = True
    report = bench.request()
    assert failed(report) == ["sensors"]
    assert "the magnetometer has fallen silent" in report.failed()[0].text
    bench.vehicle.silent = False
    assert failed(bench.wait_report(4.0)) == [], "a failed check is repeated soon"


def test_a_service_is_lost_when_it_is_silent_in_two_rounds() -> None:
    bench = Bench()
    bench.wait_report(3.0)
    bench.bus.remove("camera")
    sent = bench.bus.send_request(CHECK_PREFLIGHT, GetPreflight())
    bench.bus.run_for(2.0)
    assert not sent.replies
    bench.bus.add(Idle("camera"))
    assert "well" in services(bench.wait_report(2.0))
    bench.bus.remove("camera")
    report = bench.request()
    assert services(report) == "camera is silent: the vehicle could not land on the rover; see jezero ps"
    assert failed(report) == [], "it may be late"
    assert failed(bench.wait_report(8.0)) == ["services"]


def services(report: PreflightReport) -> str:
    """The text of the check of the services."""
    return next(check.text for check in report.checks if check.name == "services")


def test_a_round_is_long_enough_to_hear_every_service_whenever_it_begins() -> None:
    bench = Bench()
    bench.bus.remove("estimator")
    bench.bus.add(Idle("estimator"))
    bench.bus.run_for(0.5)
    bench.bus.add(Idle("recorder"))
    for tenth in range(10):
        bench.bus.run_for(0.1 * tenth)
        bench.vehicle.epoch_id += 1  # so that nothing was heard before
        report = bench.wait_report(4.0)
        (storage,) = [check for check in report.checks if check.name == "storage"]
        assert "no recorder runs" not in storage.text


def test_a_sensor_that_sends_as_often_as_it_should_is_not_called_slow() -> None:
    bench = Bench()
    bench.bus.run_for(20.0)
    report = bench.request()
    assert "instead of" not in next(check.text for check in report.checks if check.name == "sensors")


def test_the_health_names_the_failed_checks() -> None:
    bench = Bench()
    texts: list[str] = []
    bench.bus.observe(
        lambda t_ns, topic, data: (
            texts.append(decode(ServiceHealth, data).text) if topic == health_of("preflight").name else None
        )
    )
    bench.wait_report(3.0)
    bench.bus.run_for(1.5)
    assert texts[-1] == "no check has failed"
    bench.vehicle.silent = True
    assert failed(bench.request()) == ["sensors"]
    bench.bus.run_for(1.5)
    assert texts[-1] == "failed checks: sensors"


def test_a_request_gets_a_round_of_its_own() -> None:
    bench = Bench()
    bench.wait_report(3.0)
    bench.bus.run_for(10.5)  # into the next round
    count = len(bench.reports)
    bench.vehicle.silent = True
    assert failed(bench.request()) == ["sensors"]
    assert len(bench.reports) == count + 2


def test_a_new_epoch_begins_the_round_anew_and_forgets_what_was_heard() -> None:
    bench = Bench()
    sent = bench.request_while_silent(1.0)
    bench.vehicle.epoch_id = 2
    report = bench.wait_report(2.0)
    assert (report.epoch_id, failed(report)) == (2, [])
    bench.bus.run_for(0.1)
    assert sent.replies
