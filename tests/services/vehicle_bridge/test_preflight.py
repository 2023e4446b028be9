"""Takeoffs after preflight checks: refused, overridden, or too old to count."""

import pytest

from jezero.base.codec import decode, encode
from jezero.schemas.commands import Acquire, AcquireReply, Phase
from jezero.schemas.preflight import Check, PreflightReport
from jezero.schemas.topics import ACQUIRE, PREFLIGHT
from tests.services.vehicle_bridge.rig import Rig

BATTERY = Check(name="battery", verdict="failed", text="5 %, 14.0 V: charge it")
FENCE = Check(name="fence", verdict="failed", text="the vehicle is 3.0 m outside")
STORAGE = Check(name="storage", verdict="failed", text="3 MB free")
AUTOPILOT = Check(name="autopilot", verdict="failed", text="no position")
WARNING = Check(name="rover", verdict="warning", text="no odometry")


def rig_with(*checks: Check, epoch_id: int = 7) -> Rig:
    """A bridge that is ready, with a report of preflight checks."""
    rig = Rig().ready()
    rig.box.put(PREFLIGHT, PreflightReport(t_ns=rig.t_ns, epoch_id=epoch_id, checks=checks))
    rig.step()
    return rig


def take_off(rig: Rig, *override: str) -> AcquireReply:
    request = Acquire(goal_id="g", action="takeoff", override=override)  # type: ignore[arg-type]
    reply: AcquireReply = rig.request(ACQUIRE, request)
    return reply


def test_a_takeoff_after_failed_checks_is_refused_with_their_words_and_the_way_on() -> None:
    reply = take_off(rig_with(BATTERY, STORAGE, WARNING))
    assert not reply.granted
    assert "preflight checks have failed: battery: 5 %, 14.0 V: charge it; storage: 3 MB free" in reply.reason
    assert "jezero takeoff --override NAME" in reply.reason
    assert "rover" not in reply.reason


def test_a_check_that_no_takeoff_may_override_gets_no_such_advice() -> None:
    reply = take_off(rig_with(BATTERY, FENCE))
    assert not reply.granted
    assert "fence: the vehicle is 3.0 m outside" in reply.reason
    assert "--override" not in reply.reason


def test_each_failed_check_needs_an_override_of_its_own() -> None:
    rig = rig_with(BATTERY, STORAGE)
    reply = take_off(rig, "battery")
    assert not reply.granted
    assert "failed: storage: 3 MB free." in reply.reason
    assert take_off(rig, "storage", "battery").granted


def test_an_override_is_in_the_reply_and_in_the_status() -> None:
    rig = rig_with(BATTERY)
    reply = take_off(rig, "battery", "compass")
    words = "takes off in spite of failed preflight checks: battery: 5 %, 14.0 V: charge it"
    assert reply.warning == words
    rig.run(0.1, lambda: rig.setpoint(reply.control_id, Phase.TAKEOFF))
    assert words in rig.status.text


def test_a_warning_of_long_texts_still_fits_into_the_reply() -> None:
    long = tuple(Check(name=name, verdict="failed", text="x" * 1500) for name in ("battery", "storage"))
    reply = take_off(rig_with(*long), "battery", "storage")
    assert reply.granted
    assert decode(AcquireReply, encode(reply)) == reply
    assert reply.warning.startswith("takes off in spite of failed preflight checks: battery: xxx")


@pytest.mark.parametrize(
    ("checks", "epoch_id"),
    [((), 7), ((WARNING,), 7), ((BATTERY,), 6), ((BATTERY, AUTOPILOT), 7)],
    ids=["all passed", "a warning", "before a restart of the vehicle", "of a vehicle that was not ready"],
)
def test_a_takeoff_is_granted_without_failed_checks_of_the_ready_vehicle(
    checks: tuple[Check, ...], epoch_id: int
) -> None:
    reply = take_off(rig_with(*checks, epoch_id=epoch_id))
    assert reply.granted
    assert reply.warning == ""


def test_a_report_of_half_a_minute_ago_counts_no_more() -> None:
    rig = rig_with(BATTERY)
    rig.run(29.0)
    assert not take_off(rig).granted
    rig.run(2.0)
    assert take_off(rig).granted


def test_a_goal_in_the_air_is_not_refused_for_preflight_checks() -> None:
    rig = Rig().fly()
    rig.box.put(PREFLIGHT, PreflightReport(t_ns=rig.t_ns, epoch_id=7, checks=(BATTERY,)))
    rig.step()
    assert rig.acquire("go_to").granted
