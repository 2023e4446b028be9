"""Random goals, requests and mishaps: the status only ever moves along the table, and no invalid setpoint is sent."""

from collections.abc import Callable
from itertools import pairwise
from math import isfinite
from random import Random
from typing import Literal

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from jezero.base.mavlink import dialect
from jezero.schemas import topics
from jezero.schemas.commands import Abort, Acquire, Hover, Kill, Outcome, Phase, Release
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import ABORT, ACQUIRE, HOVER, KILL, RELEASE
from jezero.services.vehicle_bridge.admission import is_allowed
from tests.services.vehicle_bridge.rig import CRITICAL, MODES, Rig


class Chaos:
    """Random requests of a client, and random faults.

    Args:
        choose: returns a random index below its argument.
    """

    def __init__(self, choose: Callable[[int], int]) -> None:
        self.rig = Rig()
        self.choose = choose
        self.control_id = "b0-0"
        self.phase = Phase.TAKEOFF
        self.sending = False
        self.acquiring: tuple[int, str] | None = None

    def act(self) -> None:
        actions = (
            self.acquire, self.acquire, self.stream, self.stream, self.stream, self.climb_or_land, self.climb_or_land,
            self.release, self.release, self.hover, self.abort, self.hush, self.next_phase, self.wait, self.disturb,
            self.meddle,
        )  # fmt: skip
        actions[self.choose(len(actions))]()
        for _ in range((1, 2, 6, 25)[self.choose(4)]):
            if self.sending:
                self.rig.setpoint(self.control_id, self.phase)
            self.step()

    def step(self) -> None:
        self.rig.step()
        authority = self.rig.bridge._authority
        if authority.code in (StatusCode.IDLE, StatusCode.EXTERNAL) and not authority.taking_back:
            assert authority.target is None
        if self.acquiring is not None and self.acquiring[0] in self.rig.replies:
            request_id, action = self.acquiring
            reply = self.rig.replies[request_id]
            if reply.granted:
                idle = self.rig.status.code == 0
                self.control_id = reply.control_id
                self.phase = Phase.TAKEOFF if idle else topics.ACTIONS[action].phase
                self.sending = True
            self.acquiring = None

    def acquire(self) -> None:
        names = tuple(topics.ACTIONS)
        name = names[self.choose(len(names))]
        request = Acquire(goal_id=f"g{self.rig.t_ns}", action=name, do_takeoff=True)
        self.acquiring = (self.rig.post(ACQUIRE, request), name)

    def next_phase(self) -> None:
        self.phase = Phase.GO_TO

    def stream(self) -> None:
        self.sending = True

    def hush(self) -> None:
        self.sending = False

    def wait(self) -> None:
        pass

    def climb_or_land(self) -> None:
        autopilot = self.rig.autopilot
        if autopilot.armed and autopilot.landed:
            self.rig.lift_off((0.4, 2.0, 5.0)[self.choose(3)])
        elif self.choose(2) or not autopilot.armed:
            autopilot.landed, autopilot.pos[2] = True, 0.0

    def release(self) -> None:
        outcomes: tuple[Outcome, ...] = ("succeeded", "succeeded", "canceled", "aborted")
        outcome = outcomes[self.choose(4)]
        then: Literal["disarm", "hover"] = "disarm" if self.phase is Phase.LANDING else "hover"
        self.rig.post(RELEASE, Release(control_id=self.control_id, outcome=outcome, then=then))

    def hover(self) -> None:
        self.rig.post(HOVER, Hover(hover_pos=(1.0, 2.0, -3.0) if self.choose(2) else None))

    def abort(self) -> None:
        self.rig.post(ABORT, Abort())

    def disturb(self) -> None:
        rig, autopilot = self.rig, self.rig.autopilot
        kind = self.choose(12)
        if kind == 0:
            rig.post(KILL, Kill(confirm=True, vehicle="uav1"))
        elif kind == 1:
            autopilot.mode = tuple(MODES.values())[self.choose(4)]
        elif kind == 2:
            autopilot.armed = not autopilot.armed
        elif kind == 3:
            autopilot.silent = not autopilot.silent
        elif kind == 4:
            autopilot.lost_commands = 3
        elif kind == 5:
            autopilot.lost_acks = 3
        elif kind == 6:
            autopilot.reset_counter = (autopilot.reset_counter + 1) % 256
            autopilot.pos[0] += 1.0
        elif kind == 7:
            rig.epoch_id += 1
            autopilot.armed, autopilot.landed = False, True
        elif kind == 8:
            rig.box.connected = not rig.box.connected
        elif kind == 9:
            autopilot.q = [0.5, 0.866, 0.0, 0.0] if autopilot.q[0] == 1.0 else [1.0, 0.0, 0.0, 0.0]
        elif kind == 10:
            autopilot.vel[2] = float("nan") if isfinite(autopilot.vel[2]) else 0.0
        else:
            autopilot.refuse_arming = "" if autopilot.refuse_arming else "Arming denied"

    def meddle(self) -> None:
        """Let somebody else stream, or let a failsafe report that it acts."""
        autopilot = self.rig.autopilot
        if self.choose(2):
            autopilot.system_status = 4 if autopilot.system_status == CRITICAL else CRITICAL
        else:
            fast = dialect.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 7, 0, 0, 0, 9, 9, 9, 0, 0, 0, 0, 0)
            autopilot.foreign_setpoint = fast if autopilot.foreign_setpoint is None else None

    def edges(self) -> list[tuple[int, int]]:
        return list(pairwise(self.rig.codes))

    def check(self) -> None:
        self.rig.run_until(lambda: bool(self.rig.statuses))  # a silent autopilot delays the first status by 1.5 s
        assert self.rig.statuses[0].code in (0, 13)
        for before, after in self.edges():
            assert is_allowed(StatusCode(before), StatusCode(after)), (before, after)
        for s in self.rig.autopilot.setpoints:
            assert all(isfinite(x) for x in (s.x, s.y, s.z, s.vx, s.vy, s.vz, s.afx, s.afy, s.afz, s.yaw))
            assert s.type_mask & 7 == 0 or s.type_mask & 56 == 0


@settings(max_examples=30)
@example([14, 3, *[0] * 38])
@given(st.lists(st.integers(min_value=0, max_value=10_000), min_size=40, max_size=160))
def test_no_sequence_of_requests_and_mishaps_leaves_the_table(numbers: list[int]) -> None:
    supply = iter(numbers)
    chaos = Chaos(lambda n: next(supply, 0) % n)
    for _ in range(30):
        chaos.act()
    chaos.check()


def test_neither_do_the_actions_still_to_come() -> None:
    for seed in range(25):
        chaos = Chaos(Random(seed).randrange)
        for _ in range(60):
            chaos.act()
        chaos.check()


# -- every row, on purpose ---------------------------------------------------------------------------------

FLIGHTS = {4: ("go_to", Phase.GO_TO), 8: ("land_on_spot", Phase.LANDING), 6: ("get_images", Phase.GET_IMAGES),
           10: ("area_coverage", Phase.COVERAGE)}  # fmt: skip


def reached(code: int) -> Rig:
    """A rig whose status has just become this one."""
    rig = Rig()
    control_id = ""
    if code in (1, 2):
        control_id = rig.ready().acquire().control_id
        rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
        rig.lift_off()
        rig.run(0.1, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    elif code == 0:
        rig.ready()
    else:
        rig.fly()
    flight = FLIGHTS.get(code if code % 2 == 0 else code - 1, FLIGHTS[4] if code == 12 else None)
    if flight is not None and code > 3:
        control_id = rig.go(*flight)
    if code in (2, 5, 7, 9, 11):
        then: Literal["disarm", "hover"] = "disarm" if code == 9 else "hover"
        rig.post(RELEASE, Release(control_id=control_id, outcome="succeeded", then=then))
        rig.step()
    elif code == 12:
        rig.post(ABORT, Abort())
        rig.step()
    elif code == 13:
        rig.autopilot.mode = MODES["LAND"]
        rig.step()
    assert rig.status.code == code
    return rig


@pytest.mark.parametrize("code", range(13))
def test_any_status_gives_way_to_13(code: int) -> None:
    rig = reached(code)
    if code == 0:
        rig.autopilot.armed = True
    else:
        rig.autopilot.mode = MODES["POSCTL"]
    rig.step()
    assert rig.codes[-2:] == [code, 13]


@pytest.mark.parametrize("code", [1, 4, 6, 8, 10])
def test_any_flight_of_a_goal_can_be_aborted_into_a_hover(code: int) -> None:
    rig = reached(code)
    rig.request(ABORT, Abort())
    rig.run(0.3)
    assert rig.codes[-3:] == [code, 12, 3]


@pytest.mark.parametrize("code", [2, 5, 7, 11])
def test_what_is_completed_ends_in_a_hover(code: int) -> None:
    rig = reached(code)
    rig.run(0.3)
    assert rig.codes[-3:] == [code - 1, code, 3]


def test_an_abort_on_the_ground_and_a_failsafe_on_the_ground_end_in_0() -> None:
    for code in (12, 13):
        rig = reached(code)
        rig.autopilot.landed, rig.autopilot.armed = True, False
        rig.run(0.3)
        assert rig.codes[-2:] == [code, 0]
