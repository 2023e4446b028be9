"""Another MAVLink system arms, changes mode or streams: the bridge falls silent until a hover is requested."""

from collections.abc import Callable
from math import nan
from types import SimpleNamespace
from typing import Any

import pytest

from jezero.base.frames import Vec3
from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.schemas.commands import Hover, Phase
from jezero.schemas.topics import HOVER
from jezero.services.vehicle_bridge.takeover import (
    ForeignSetpointDetector,
    SetpointEcho,
    TakeoverDetector,
    UnarmableModeDetector,
)
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot
from tests.services.vehicle_bridge.rig import CRITICAL, MODES, SECRET, SET_MODE, Rig

S = 1_000_000_000
MS = 1_000_000
POSITION = 0b110111111000
VELOCITY = 0b110111000111
HERE = Target((1.0, 2.0, -3.0), None, None, 0.0)
NORTH = Target(None, (1.0, 0.0, 0.0), None, 0.0)
NONE = (nan, nan, nan)


def stream(mask: int = VELOCITY, **fields: float) -> SimpleNamespace:
    """A setpoint of somebody else."""
    zero = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw"), 0.0)
    return SimpleNamespace(type_mask=mask, **{**zero, **fields})


def flying() -> Rig:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    return rig


def armed_in_posctl(rig: Rig) -> None:
    rig.autopilot.mode, rig.autopilot.armed = MODES["POSCTL"], True


def switched_to_hold(rig: Rig) -> None:
    rig.autopilot.mode = MODES["LOITER"]


def streamed_to(rig: Rig) -> None:
    rig.autopilot.foreign_setpoint = stream(vx=2.0)


# -- taking over -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "event", "text"),
    [
        (lambda: Rig().ready(), armed_in_posctl, "armed, and not by the bridge"),
        (lambda: Rig().fly(), switched_to_hold, "was switched to AUTO.LOITER"),
        (flying, switched_to_hold, "was switched to AUTO.LOITER"),
        (lambda: Rig().fly(), streamed_to, "follows setpoints of somebody else"),
        (flying, streamed_to, "follows setpoints of somebody else"),
    ],
)
def test_after_a_takeover_the_other_is_in_charge_and_nothing_is_sent_to_the_autopilot(
    start: Callable[[], Rig], event: Callable[[Rig], None], text: str
) -> None:
    rig = start()
    event(rig)
    rig.run_until(lambda: rig.status.code == 13, limit_s=1.0)
    assert rig.status.in_charge == "external"
    assert rig.status.text.startswith("taken over: ")
    assert text in rig.status.text
    assert not rig.acquire().granted
    heartbeat = len(MavlinkCodec(1, 191).pack(dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)))
    rig.autopilot.bytes_received = 0
    rig.run(10.0)
    assert rig.status.code == 13
    assert rig.autopilot.bytes_received == 10 * heartbeat


def test_a_goal_ends_with_the_reason_and_its_later_setpoints_are_dropped() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.autopilot.mode = MODES["POSCTL"]
    rig.run(0.1, lambda: rig.setpoint(control_id, Phase.GO_TO))
    reply = rig.release(control_id)
    assert not reply.released
    assert reply.reason == "taken over: the autopilot was switched to POSCTL"


def test_an_autopilot_with_one_heartbeat_a_second_is_requested_more_while_the_bridge_flies_and_only_then() -> None:
    rig = Rig()
    rig.autopilot.heartbeat_s = 1.0
    rig.ready().run(3.0)
    assert rig.autopilot.heartbeat_requests == 0
    rig.fly()
    before = rig.autopilot.heartbeat_requests
    rig.run(3.0)
    assert 15 <= rig.autopilot.heartbeat_requests - before <= 20
    rig.autopilot.mode = MODES["POSCTL"]
    rig.run(0.25)
    assert (rig.status.code, rig.status.in_charge) == (13, "external")
    before = rig.autopilot.heartbeat_requests
    rig.run(3.0)
    assert rig.autopilot.heartbeat_requests == before
    assert rig.request(HOVER, Hover()).hover_mode


def test_an_autopilot_with_many_heartbeats_is_requested_no_more() -> None:
    rig = flying()
    rig.autopilot.heartbeat_s = 0.1
    rig.run(2.0)
    assert rig.autopilot.heartbeat_requests == 0


def arming() -> tuple[Rig, str]:
    """A rig whose bridge has commanded arming and waits for it, and the control id."""
    rig = Rig().ready()
    rig.autopilot.reported_armed = False
    rig.autopilot.refuse_arming = "not yet"
    control_id = rig.acquire().control_id
    rig.run(0.5, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    assert rig.autopilot.mode == MODES["OFFBOARD"]
    return rig, control_id


def test_arming_by_somebody_else_while_the_bridge_is_about_to_arm_is_a_takeover() -> None:
    rig, _ = arming()
    rig.autopilot.reported_armed, rig.autopilot.armed, rig.autopilot.mode = None, True, MODES["POSCTL"]
    rig.step()
    assert (rig.status.code, rig.status.in_charge) == (13, "external")


def test_a_change_of_mode_while_the_bridge_is_about_to_arm_is_a_takeover() -> None:
    rig, control_id = arming()
    rig.autopilot.mode = MODES["POSCTL"]
    rig.autopilot.commands.clear()
    rig.run(0.5, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    assert rig.codes == [0, 1, 13, 0]
    assert "taken over: the autopilot was switched to POSCTL" in rig.status.text
    assert [c for c in rig.autopilot.commands if c[0] == SET_MODE] == []


def test_a_vehicle_that_arms_by_the_bridges_command_while_the_goal_is_late_is_taken_over_by_nobody() -> None:
    rig = Rig().ready()
    rig.autopilot.reported_armed = False
    control_id = rig.acquire().control_id
    rig.run_until(lambda: rig.autopilot.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.run(0.4)
    assert rig.status.text.startswith("hovering until the goal takeoff goes on")
    rig.autopilot.reported_armed = None
    rig.run(0.1)
    rig.run(0.5, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    assert rig.codes == [0, 1]
    assert (rig.status.in_charge, rig.status.text) == ("goal", "the goal takeoff goes on")


def test_a_refusal_to_arm_that_was_over_before_the_takeoff_explains_nothing_that_happens_later() -> None:
    rig = Rig().ready()
    rig.autopilot.refuse_arming = "Arming denied: high gyro bias"
    control_id = rig.acquire().control_id
    rig.run(0.5, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    assert not rig.autopilot.armed
    rig.autopilot.refuse_arming, rig.autopilot.lost_acks = "", 1
    rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.lift_off()
    rig.run(0.1, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    assert rig.release(control_id, hover_pos_ned_m=(0.0, 0.0, -2.0)).released
    rig.run(10.0)
    rig.autopilot.armed = False
    rig.run(0.1)
    assert rig.status.text == "the autopilot disarmed while the vehicle hovers"


def test_a_ground_station_that_only_listens_takes_nothing_over() -> None:
    rig = flying()
    station, other = MavlinkCodec(255, 190), MavlinkCodec(1, 100)
    heartbeats = station.pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    heartbeats += other.pack(dialect.MAVLink_heartbeat_message(30, 8, 0, 0, 5, 3))
    vehicle = MavlinkCodec(2, 1).pack(dialect.MAVLink_heartbeat_message(2, 12, 1, MODES["LAND"], 5, 3))
    echo = MavlinkCodec(255, 1).pack(
        dialect.MAVLink_position_target_local_ned_message(0, 1, POSITION, 9, 9, 9, 0, 0, 0, 0, 0, 0, 0, 0)
    )

    def forwarded() -> None:
        rig._to_bridge += heartbeats + vehicle + echo

    rig.autopilot.foreign_setpoint = None
    rig.run(0.2, forwarded)
    assert rig.status.code == 4

    def forwarded_and_flown() -> None:
        forwarded()
        rig.setpoint(f"{SECRET}-{rig.status.grant}", Phase.GO_TO)

    rig.run(1.5, forwarded_and_flown)
    assert rig.status.code == 4


# -- handing over ------------------------------------------------------------------------------------------


def test_a_pilot_may_lose_to_a_failsafe_and_win_back_from_it() -> None:
    rig = flying()
    for mode, state, who in (
        ("POSCTL", 4, "external"),
        ("LAND", CRITICAL, "failsafe"),
        ("LAND", 4, "external"),
        ("LOITER", 4, "external"),
    ):
        rig.autopilot.mode, rig.autopilot.system_status = MODES[mode], state
        rig.step()
        assert (rig.status.code, rig.status.in_charge) == (13, who)


@pytest.mark.parametrize(
    ("mode", "state", "who"),
    [("OFFBOARD", 4, "failsafe"), ("LAND", CRITICAL, "failsafe"), ("POSCTL", 4, "external"), ("LOITER", 4, "external")],
)
def test_a_bridge_that_starts_in_flight_reports_who_is_in_charge(mode: str, state: int, who: str) -> None:
    rig = Rig()
    rig.autopilot.armed, rig.autopilot.mode, rig.autopilot.system_status = True, MODES[mode], state
    rig.lift_off()
    rig.run(0.5)
    assert (rig.status.code, rig.status.in_charge) == (13, who)


def test_only_hover_takes_control_back_and_only_in_the_air() -> None:
    rig = Rig().fly()
    rig.autopilot.mode = MODES["POSCTL"]
    rig.run(1.0)
    assert "take control back with hover" in rig.acquire("go_to").reason
    rig.autopilot.landed = True
    rig.step()
    assert "in the air only" in rig.request(HOVER, Hover()).reason
    rig.autopilot.landed = False
    rig.step()
    assert rig.request(HOVER, Hover()).hover_mode
    assert rig.codes[-2:] == [13, 3]
    rig.run(2.0)
    assert rig.status.in_charge == "hover"


def test_a_stream_that_goes_on_after_a_hover_is_another_takeover() -> None:
    rig = Rig().fly()
    rig.autopilot.foreign_setpoint = stream(vx=1.0)
    rig.run(1.0)
    assert rig.request(HOVER, Hover()).hover_mode
    rig.run_until(lambda: rig.status.code == 13, limit_s=1.0)
    rig.autopilot.foreign_setpoint = None
    assert rig.request(HOVER, Hover()).hover_mode
    rig.run(3.0)
    assert rig.status.code == 3


def test_landed_and_disarmed_by_others_the_vehicle_is_idle_and_takes_goals_again() -> None:
    rig = Rig().fly()
    rig.autopilot.mode = MODES["LAND"]
    rig.run(1.0)
    rig.autopilot.landed, rig.autopilot.armed, rig.autopilot.mode = True, False, MODES["LOITER"]
    rig.run(0.2)
    assert rig.codes[-2:] == [13, 0]
    assert rig.acquire(goal_id="next").granted


# -- unarmable modes on the ground ----------------------------------------------------------------------


def landed_by_others(mode: str, *, armable: bool) -> Rig:
    rig = Rig().fly()
    rig.autopilot.mode = MODES["POSCTL"]
    rig.run(0.5)
    rig.autopilot.commands.clear()
    rig.autopilot.landed, rig.autopilot.armed = True, False
    rig.autopilot.mode, rig.autopilot.armable = MODES[mode], armable
    rig.run(4.0)
    return rig


def test_an_offboard_mode_that_others_abandoned_is_left() -> None:
    assert landed_by_others("OFFBOARD", armable=False).autopilot.mode == MODES["LOITER"]


@pytest.mark.parametrize(("mode", "armable"), [("OFFBOARD", True), ("POSCTL", False), ("LOITER", True)])
def test_a_mode_that_others_may_be_about_to_arm_in_is_theirs(mode: str, armable: bool) -> None:
    rig = landed_by_others(mode, armable=armable)
    assert rig.autopilot.commands == []
    assert rig.status.code == 0


def holds_at(*modes: tuple[float, str, bool], own_flight: bool, at_s: float) -> bool:
    """Whether hold mode is commanded at a time after a flight, which has taken a minute.

    Args:
        modes: each with the time in s from which on the disarmed autopilot is in it, and whether it can be armed there.
        own_flight: the bridge flew.
        at_s: the time.
    """
    detector = UnarmableModeDetector()
    detector.reset(VehicleSnapshot(t_ns=0, timer_ns=60 * S), own_flight=own_flight)
    commanded = False
    for step in range(round(at_s * 10) + 1):
        mode, armable = [(mode, armable) for since_s, mode, armable in modes if 10 * since_s <= step][-1]
        commanded = detector.update(
            VehicleSnapshot(t_ns=0, timer_ns=60 * S + step * 100 * MS, armed=False, mode=mode, armable=armable)
        )
    return commanded


@pytest.mark.parametrize(
    ("modes", "at_s", "holds"),
    [
        ([(0.0, "OFFBOARD", True)], 4.9, True),
        ([(0.0, "OFFBOARD", True)], 5.1, False),
        ([(0.0, "", True), (1.0, "OFFBOARD", True)], 1.0, True),
        ([(0.0, "OFFBOARD", True), (1.0, "POSCTL", True)], 1.0, False),
        ([(0.0, "POSCTL", True), (1.0, "OFFBOARD", True)], 1.0, False),
    ],
    ids=["soon", "late", "unknown at first", "a pilot's mode", "a pilot's since"],
)
def test_after_its_own_flight_the_bridge_leaves_an_unarmable_mode_for_five_seconds_until_a_pilot_changes_it(
    modes: list[tuple[float, str, bool]], at_s: float, holds: bool
) -> None:
    assert holds_at(*modes, own_flight=True, at_s=at_s) is holds


@pytest.mark.parametrize(
    ("modes", "at_s", "holds"),
    [
        ([(0.0, "OFFBOARD", False)], 1.9, False),
        ([(0.0, "OFFBOARD", False)], 2.1, True),
        ([(0.0, "OFFBOARD", True)], 4.0, False),
        ([(0.0, "POSCTL", False)], 4.0, False),
        ([(0.0, "OFFBOARD", True), (7.0, "OFFBOARD", False)], 9.5, True),
        ([(0.0, "OFFBOARD", True), (9.0, "OFFBOARD", False)], 11.5, False),
    ],
)
def test_after_a_foreign_flight_it_waits_two_seconds_in_which_nobody_can_arm_and_no_longer_than_ten(
    modes: list[tuple[float, str, bool]], at_s: float, holds: bool
) -> None:
    assert holds_at(*modes, own_flight=False, at_s=at_s) is holds


@pytest.mark.parametrize("armed", [True, None])
def test_a_vehicle_that_may_be_armed_is_not_commanded_into_hold_mode(armed: bool | None) -> None:
    detector = UnarmableModeDetector()
    detector.reset(VehicleSnapshot(t_ns=0, timer_ns=0), own_flight=True)
    assert not detector.update(VehicleSnapshot(t_ns=0, timer_ns=S, armed=armed, mode="OFFBOARD"))


# -- foreign setpoint detector -----------------------------------------------------------------------------


def detection_ms(sent_and_echo: Callable[[int], tuple[Target, tuple[Vec3, Vec3]]], age_ns: int = 0) -> int:
    """Time in ms until a foreign stream is detected; -1 when it isn't within 5 s.

    Args:
        sent_and_echo: from the time in ms, the target that is sent every 20 ms, and position and velocity of the
            echo every 30 ms.
        age_ns: age of each echo when it arrives.
    """
    detector = ForeignSetpointDetector()
    for ms in range(0, 5_000, 10):
        target, (pos_ned_m, vel_ned_mps) = sent_and_echo(ms)
        if ms % 20 == 0:
            detector.add_sent(target, ms * MS)
        if ms % 30 == 0:
            detector.update(SetpointEcho(ms * MS - age_ns, pos_ned_m, vel_ned_mps), ms * MS, ms * MS)
        if detector.is_detected(ms * MS):
            return ms
    return -1


def test_an_echo_of_a_sent_setpoint_is_not_foreign() -> None:
    assert detection_ms(lambda ms: (HERE, ((1.0, 2.0, -3.0), (0.4, -2.0, 0.1)))) == -1
    assert detection_ms(lambda ms: (NORTH, (NONE, (1.0, 0.0, 0.0)))) == -1


def test_a_late_echo_of_a_moving_target_is_not_foreign() -> None:
    def at(ms: int) -> Vec3:
        return (ms * 0.01, 0.0, -3.0)

    assert detection_ms(lambda ms: (Target(at(ms), None, None, 0.0), (at(max(0, ms - 900) // 20 * 20), NONE))) == -1


def test_an_echo_of_a_setpoint_that_was_replaced_more_than_a_second_ago_is_foreign() -> None:
    def at(ms: int) -> Vec3:
        return (ms * 0.01, 0.0, -3.0)

    assert detection_ms(lambda ms: (Target(at(ms), None, None, 0.0), (at(max(0, ms - 1200)), NONE))) > 1_000


@pytest.mark.parametrize(("off_m", "is_ours"), [(0.07, True), (0.15, False)])
def test_an_echoed_position_is_within_a_tenth_of_a_metre_of_a_sent_one(off_m: float, is_ours: bool) -> None:
    assert (detection_ms(lambda ms: (HERE, ((1.0, 2.0 + off_m, -3.0), NONE))) == -1) == is_ours


@pytest.mark.parametrize(
    ("times_ms", "detected"),
    [
        ((0, 200, 400, 600), True),
        ((0, 300, 600), False),
        ((0, 100, 200, 300), False),
        ((0, 20, 40, 600), True),
        ((0, 600, 1200, 1800), True),
        ((0, 700, 1400, 2100), False),
    ],
    ids=["four", "three", "a short burst", "a burst and one more", "four in two seconds", "three in two seconds"],
)
def test_four_foreign_echoes_within_two_seconds_but_not_all_within_half_a_second_are_a_stream(
    times_ms: tuple[int, ...], detected: bool
) -> None:
    detector = ForeignSetpointDetector()
    for ms in range(0, times_ms[-1] + 1, 20):
        detector.add_sent(HERE, S + ms * MS)
        if ms in times_ms:
            detector.update(SetpointEcho(S + ms * MS, (9.0, 2.0, -3.0), NONE), S + ms * MS, S + ms * MS)
    assert detector.is_detected(S + times_ms[-1] * MS) is detected
    detector.reset()
    assert not detector.is_detected(S + times_ms[-1] * MS)


@pytest.mark.parametrize(
    ("echo_mps", "is_ours"),
    [
        ((0.6, 0.0, 0.0), True),
        ((0.0, 0.0, 0.0), True),
        ((1.15, 0.1, -0.1), True),
        ((1.3, 0.0, 0.0), False),
        ((-0.3, 0.0, 0.0), False),
        ((1.0, 0.0, 0.3), False),
    ],
)
def test_an_echoed_velocity_may_be_limited_but_not_greater(echo_mps: Vec3, is_ours: bool) -> None:
    assert (detection_ms(lambda ms: (NORTH, (NONE, echo_mps))) == -1) == is_ours


@pytest.mark.parametrize("echo_mps", [NONE, (0.0, 0.0, 0.5)])
def test_on_the_ground_where_no_setpoint_is_followed_none_is_foreign(echo_mps: Vec3) -> None:
    pressing = Target(None, (0.0, 0.0, 0.5), None, 0.0)
    assert detection_ms(lambda ms: (pressing, (NONE, echo_mps))) == -1


@pytest.mark.parametrize(
    ("target", "echo"),
    [
        (HERE, ((1.0, 2.5, -3.0), NONE)),
        (HERE, (NONE, (0.5, 0.0, 0.0))),
        (HERE, ((nan, nan, -3.0), (0.5, 0.0, nan))),
        (NORTH, ((1.0, 2.0, -3.0), (1.0, 0.0, 0.0))),
        (NORTH, ((nan, nan, -3.0), (1.0, 0.0, 0.0))),
    ],
)
def test_an_echo_of_a_setpoint_that_was_never_sent_is_foreign(target: Target, echo: tuple[Vec3, Vec3]) -> None:
    assert 500 <= detection_ms(lambda ms: (target, echo)) <= 600


def test_a_stream_of_twenty_hertz_between_ours_is_detected_too() -> None:
    ours, theirs = ((1.0, 2.0, -3.0), NONE), (NONE, (1.0, 0.0, 0.0))
    assert 500 <= detection_ms(lambda ms: (HERE, theirs if ms % 50 == 10 or ms % 50 == 30 else ours)) < 2_000
    assert 500 <= detection_ms(lambda ms: (HERE, theirs if ms % 50 == 10 else ours)) < 3_000


def test_an_old_echo_is_ignored() -> None:
    assert detection_ms(lambda ms: (HERE, ((1.0, 2.5, -3.0), NONE)), age_ns=299 * MS) > 0
    assert detection_ms(lambda ms: (HERE, ((1.0, 2.5, -3.0), NONE)), age_ns=301 * MS) == -1


@pytest.mark.parametrize("ms_long", [100, 400])
def test_a_short_burst_of_foreign_echoes_is_not_detected(ms_long: int) -> None:
    """The autopilot has moved its position in one step, and the bridge has not received it yet."""
    moved = ((3.0, 2.0, -3.0), NONE)
    assert detection_ms(lambda ms: (HERE, moved if 1_000 <= ms < 1_000 + ms_long else ((1.0, 2.0, -3.0), NONE))) == -1


# -- takeover detector ---------------------------------------------------------------------------------------


def snapshot(mode: str = "OFFBOARD", t_ms: int = 0, **fields: Any) -> VehicleSnapshot:
    """An armed vehicle, unless other fields are given."""
    return VehicleSnapshot(**{"t_ns": 0, "timer_ns": t_ms * MS, "mode": mode, "armed": True, **fields})


def test_an_offboard_mode_that_is_left_for_a_moment_before_arming_is_no_takeover() -> None:
    """The mode of the autopilot's heartbeat may be older than the command."""
    detector = TakeoverDetector()

    def at_ms(t_ms: int, mode: str) -> object:
        return detector.before_lift_off(snapshot(mode, t_ms, armed=False), arm_commanded=True)

    assert at_ms(5000, "OFFBOARD") is None
    assert at_ms(5280, "AUTO.LOITER") is None
    assert at_ms(5320, "AUTO.LOITER") == ("external", "taken over: the autopilot was switched to AUTO.LOITER")


def test_another_mode_is_a_takeover_only_after_arming_in_offboard_mode_was_commanded() -> None:
    detector, was_offboard = TakeoverDetector(), []
    for t_ms, mode, arm_commanded in (
        (0, "POSCTL", False),
        (1000, "OFFBOARD", False),
        (3000, "POSCTL", False),
        (4000, "OFFBOARD", True),
    ):
        assert detector.before_lift_off(snapshot(mode, t_ms, armed=False), arm_commanded=arm_commanded) is None
        was_offboard.append(detector.was_offboard)
    detector.reset(snapshot(t_ms=4100))
    assert [*was_offboard, detector.was_offboard] == [False, False, False, True, False]
    assert detector.before_lift_off(snapshot("POSCTL", 6000, armed=False), arm_commanded=True) is None


@pytest.mark.parametrize(
    ("mode", "arm_commanded", "ours"),
    [("OFFBOARD", True, True), ("OFFBOARD", False, False), ("POSCTL", True, False), ("POSCTL", False, False)],
)
def test_arming_is_the_bridges_only_in_offboard_mode_after_its_command(
    mode: str, arm_commanded: bool, ours: bool
) -> None:
    takeover = TakeoverDetector().before_lift_off(snapshot(mode), arm_commanded=arm_commanded)
    assert takeover == (None if ours else ("external", "taken over: armed, and not by the bridge"))


@pytest.mark.parametrize(
    ("mode", "fields", "takeover"),
    [
        ("OFFBOARD", {}, None),
        ("OFFBOARD", {"failsafe": True}, None),
        ("POSCTL", {}, ("external", "taken over: the autopilot was switched to POSCTL")),
        ("POSCTL", {"armed": False}, None),
        ("OFFBOARD", {"foreign_setpoints": True}, ("external", "taken over: the autopilot follows setpoints of ")),
        ("OFFBOARD", {"foreign_setpoints": True, "armed": False}, None),
        ("AUTO.RTL", {"failsafe": True}, ("failsafe", "failsafe: the autopilot was switched to AUTO.RTL")),
        (
            "AUTO.RTL",
            {"failsafe": True, "command_failure": "Battery low"},
            ("failsafe", "failsafe: the autopilot was switched to AUTO.RTL (Battery low)"),
        ),
    ],
)
def test_in_flight_another_mode_or_stream_is_a_takeover_with_the_autopilots_reason_for_a_failsafe(
    mode: str, fields: dict[str, Any], takeover: tuple[str, str] | None
) -> None:
    found = TakeoverDetector().in_flight(snapshot(mode, **fields))
    if takeover is None:
        assert found is None
    else:
        assert found is not None and found[0] == takeover[0] and found[1].startswith(takeover[1])


@pytest.mark.parametrize(
    ("before", "after", "holder"),
    [
        (("POSCTL", False), ("POSCTL", False), None),
        (("", False), ("POSCTL", False), None),
        (("POSCTL", False), ("AUTO.LOITER", False), "external"),
        (("POSCTL", False), ("AUTO.LAND", True), "failsafe"),
        (("AUTO.LAND", True), ("AUTO.LAND", False), "external"),
        (("AUTO.LAND", False), ("AUTO.LAND", True), "failsafe"),
    ],
)
def test_while_others_fly_a_change_of_mode_or_of_its_cause_is_a_handover(
    before: tuple[str, bool], after: tuple[str, bool], holder: str | None
) -> None:
    for armed in (True, False):
        detector = TakeoverDetector()
        detector.reset(snapshot(before[0], failsafe=before[1]))
        handover = detector.handover(snapshot(after[0], failsafe=after[1], armed=armed))
        assert (None if handover is None else handover[0]) == (holder if armed else None)
        assert detector.handover(snapshot(after[0], failsafe=after[1])) is None, "it is reported once"
