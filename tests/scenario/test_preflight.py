"""Takeoffs after failed preflight checks."""

from jezero.schemas import topics
from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.preflight import GetPreflight
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
