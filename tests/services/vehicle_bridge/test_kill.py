"""Kill stops the motors, after as many confirmations as a fall is worth."""

from functools import partial

import pytest

from jezero.base.mavlink import dialect
from jezero.schemas.commands import Hover, Kill, Phase, Release
from jezero.schemas.topics import HOVER, KILL, RELEASE
from tests.services.vehicle_bridge.rig import ARM, Rig


def test_kill_needs_to_be_confirmed() -> None:
    rig = Rig().fly()
    reply = rig.request(KILL, Kill())
    assert not reply.killed
    assert reply.reason == "kill cuts the motors, in the air too: set confirm to true"
    assert rig.autopilot.armed


def test_kill_forces_a_disarm_in_the_air_at_once_and_until_it_is_done() -> None:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    rig.autopilot.lost_commands = 2
    request = rig.post(KILL, Kill(confirm=True, vehicle="uav1"))
    rig.step()
    assert rig.status.code == 13
    assert rig.autopilot.lost_commands == 1, "the first order goes out in the same step"
    rig.run_until(lambda: request in rig.replies, limit_s=2.0)
    assert rig.replies[request].killed
    assert not rig.autopilot.armed
    assert rig.autopilot.commands[-1] == (ARM, (0.0, 21196.0, 0.0))
    rig.autopilot.landed = True
    rig.run(0.1)
    assert rig.codes[-2:] == [13, 0]


@pytest.mark.parametrize(
    ("vehicle", "reason"), [("", "uav1 is in the air"), ("uav2", "is uav1, not uav2"), ("UAV1", "is uav1, not UAV1")]
)
def test_kill_in_the_air_needs_the_vehicle_s_name_too(vehicle: str, reason: str) -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    keep_flying = partial(rig.setpoint, control_id, Phase.GO_TO)
    reply = rig.request(KILL, Kill(confirm=True, vehicle=vehicle), keep_flying)
    assert not reply.killed
    assert reason in reply.reason
    rig.run(0.5, keep_flying)
    assert rig.autopilot.armed
    assert rig.status.in_charge == "goal"
    assert not rig.request(KILL, Kill(vehicle="uav1"), keep_flying).killed
    assert rig.autopilot.armed


def test_kill_on_the_ground_needs_no_name_but_not_another_vehicle_s() -> None:
    rig = Rig().ready()
    rig.autopilot.armed = True
    rig.run(0.1)
    assert not rig.request(KILL, Kill(confirm=True, vehicle="uav2")).killed
    assert rig.autopilot.armed
    assert rig.request(KILL, Kill(confirm=True)).killed
    assert not rig.autopilot.armed


def test_kill_needs_the_name_when_nobody_knows_whether_the_vehicle_still_stands() -> None:
    rig = Rig().ready()
    rig.autopilot.armed = True
    rig.run(0.1)
    rig.autopilot.silent = True
    rig.run(1.5)
    assert "in the air" in rig.request(KILL, Kill(confirm=True)).reason
    request = rig.post(KILL, Kill(confirm=True, vehicle="uav1"))
    rig.step()
    rig.autopilot.silent = False
    rig.run_until(lambda: request in rig.replies)
    assert not rig.autopilot.armed


def test_kill_on_the_ground_has_nothing_to_do() -> None:
    rig = Rig().ready()
    assert rig.request(KILL, Kill(confirm=True)).killed
    assert rig.codes == [0]


@pytest.mark.parametrize("warning", ["", "Disarming denied! Not landed"])
def test_a_kill_that_the_autopilot_does_not_hear_is_reported_after_three_seconds_and_kept_up(warning: str) -> None:
    rig = Rig().fly()
    rig.autopilot.lost_commands = 10_000
    request, posted_ns = rig.post(KILL, Kill(confirm=True, vehicle="uav1")), rig.t_ns
    rig.run(2.0)
    if warning:
        rig.autopilot.unasked = rig.autopilot.codec.pack(dialect.MAVLink_statustext_message(3, warning.encode()))
    rig.run_until(lambda: request in rig.replies)
    assert not rig.replies[request].killed
    expected = "the autopilot has not confirmed it, the bridge keeps trying" + (f": {warning}" if warning else "")
    assert rig.replies[request].reason == expected
    assert 3.0 <= (rig.reply_t_ns[request] - posted_ns) * 1e-9 <= 3.2
    rig.autopilot.lost_commands = 0
    rig.run(1.0)
    assert not rig.autopilot.armed


def test_a_kill_is_not_undone_by_a_hover_before_the_motors_are_off() -> None:
    rig = Rig().fly()
    rig.autopilot.lost_commands = 10_000
    rig.post(KILL, Kill(confirm=True, vehicle="uav1"))
    rig.step()
    reply = rig.request(HOVER, Hover())
    assert not reply.hover_mode
    assert "in the air only, and the vehicle is under other command: motors cut on request" in reply.reason
    rig.autopilot.lost_commands = 0
    rig.run(1.0)
    assert not rig.autopilot.armed


def test_a_kill_of_a_vehicle_that_is_being_armed_is_done_only_when_its_motors_stand_still() -> None:
    """The autopilot's HEARTBEAT, which comes once a second, may still say that the motors are off."""
    rig = Rig().ready()
    rig.autopilot.reported_armed, rig.autopilot.lost_acks = False, 1
    control_id = rig.acquire("takeoff").control_id
    rig.run_until(lambda: rig.autopilot.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.autopilot.lost_commands = 2
    assert rig.request(KILL, Kill(confirm=True)).killed
    assert not rig.autopilot.armed


def test_after_a_kill_the_next_flight_ends_with_an_ordinary_disarm() -> None:
    rig = Rig().fly()
    assert rig.request(KILL, Kill(confirm=True, vehicle="uav1")).killed
    rig.autopilot.landed, rig.autopilot.pos[2] = True, 0.0
    rig.run(1.0)
    rig.fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    rig.autopilot.landed, rig.autopilot.pos[2] = True, 0.0
    rig.autopilot.commands.clear()
    request = rig.post(RELEASE, Release(control_id=control_id, outcome="succeeded", then="disarm"))
    rig.run_until(lambda: not rig.autopilot.armed)
    rig.run_until(lambda: request in rig.replies)
    assert [parameters[1] for command, parameters in rig.autopilot.commands if command == ARM] == [0.0]
