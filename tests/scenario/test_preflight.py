"""Takeoffs after failed preflight checks."""

from msgspec.structs import replace

from jezero.base.codec import decode, encode
from jezero.schemas import topics
from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.preflight import GetPreflight
from jezero.schemas.sensors import Altimeter
from tests.scenario.rig import Flight


def test_a_takeoff_is_refused_after_a_failed_check_and_flies_with_its_override() -> None:
    flight = Flight(1)
    flight.wait_ready()
    first = flight.request(topics.CHECK_PREFLIGHT, GetPreflight()).report
    assert first.failed() == ()
    flight.bus.remove("estimator")
    late = flight.request(topics.CHECK_PREFLIGHT, GetPreflight()).report
    assert late.failed() == (), "its health may be late"
    report = flight.request(topics.CHECK_PREFLIGHT, GetPreflight()).report
    assert [check.name for check in report.failed()] == ["services"]
    flight.bus.run_for(0.1)
    assert "estimator is silent" in flight.refusal(topics.TAKEOFF, TakeoffGoal())
    assert "services: " in flight.refusal(topics.TAKEOFF, TakeoffGoal(override=("gnss",)))
    request = flight.send(topics.TAKEOFF, TakeoffGoal(override=("services",)))
    assert "in spite of failed preflight checks: services" in request.replies[0].warning
    assert flight.finish(request).outcome == "succeeded"
    assert any("in spite of failed preflight checks: services" in status.text for status in flight.statuses)


def test_an_altimeter_that_sticks_is_named_in_the_takeoff() -> None:
    flight = Flight(1)
    flight.wait_ready()

    def stick(sender: str, receiver: str, name: str, t_ns: int, data: bytes) -> list[tuple[int, bytes]]:
        if name == topics.ALTIMETER.name:
            data = encode(replace(decode(Altimeter, data), range_m=0.2))
        return [(t_ns, data)]

    flight.bus.tamper = stick
    assert flight.finish(flight.send(topics.TAKEOFF, TakeoffGoal(altitude_m=3.0))).outcome == "succeeded"
    flight.bus.run_for(5.0)
    (check,) = flight.request(topics.CHECK_PREFLIGHT, GetPreflight()).report.failed()
    assert check.name == "sensors" and "the altimeter is wrong" in check.text
