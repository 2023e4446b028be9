"""The flight controller's time by TIMESYNC, against a controller whose clock is known here and nowhere else."""

from pathlib import Path
from random import Random

import pytest

from jezero.services.vehicle_bridge.time_sync import (
    PERIOD_NS,
    ControllerClock,
    KeptEpoch,
    Offset,
    TimeSync,
    kept_epoch_path,
    load_epoch,
    save_epoch,
)

S = 1_000_000_000
MS = 1_000_000


class Controller:
    """A controller with a clock of its own at the end of a line.

    Attributes:
        host_ns: this computer's monotonic time.
        rate: seconds of the controller in one of this computer.
        line_ns: shortest time on the line, one way.
        late_ns: mean of what may come on top of it, one way.
    """

    def __init__(self, sync: TimeSync, booted_ns: int = 40 * S, rate: float = 1.0, seed: int = 1) -> None:
        self.sync = sync
        self.host_ns = 1000 * S
        self.rate, self.line_ns, self.late_ns = rate, MS // 10, MS // 10
        self._since_ns, self._then_ns = self.host_ns, booted_ns
        self._random = Random(seed)

    @property
    def now_ns(self) -> int:
        return self._then_ns + int(self.rate * (self.host_ns - self._since_ns))

    def set(self, controller_ns: int) -> None:
        self._since_ns, self._then_ns = self.host_ns, controller_ns

    def run(self, seconds: float) -> None:
        for _ in range(int(seconds * S / PERIOD_NS)):
            begin_ns = self.host_ns
            if self.sync.due(begin_ns):
                self.host_ns += self._on_the_way_ns()
                there_ns = self.now_ns
                self.host_ns += self._on_the_way_ns()
                self.sync.on_reply(there_ns, begin_ns, self.host_ns)
            self.host_ns = max(self.host_ns, begin_ns + PERIOD_NS)

    def _on_the_way_ns(self) -> int:
        return self.line_ns + int(self._random.expovariate(1.0 / self.late_ns))

    @property
    def error_ns(self) -> int:
        """Error of the estimated time of now."""
        assert self.sync.offset is not None
        return self.sync.offset.controller_ns(self.host_ns) - self.now_ns


@pytest.mark.parametrize("rate", [1.0, 1.0 + 50e-6, 1.0 - 50e-6, 0.961])
def test_the_controllers_time_is_known_whatever_its_clocks_rate_is(rate: float) -> None:
    controller = Controller(TimeSync(), rate=rate)
    controller.run(12.0)
    assert abs(controller.error_ns) < MS // 2
    offset = controller.sync.offset
    assert offset is not None
    assert offset.rate == pytest.approx(rate, abs=30e-6)
    assert offset.spread_ns < MS // 5, "health would say that the clock of a good line is hardly known"
    controller.host_ns += 2 * S  # without a reply
    assert abs(controller.error_ns) < MS


def test_a_request_is_due_once_a_period() -> None:
    sync = TimeSync()
    begin_ns, step_ns = 1000 * S, PERIOD_NS // 5
    due = [sync.due(begin_ns + step * step_ns) for step in range(11)]
    assert [step for step, is_due in enumerate(due) if is_due] == [0, 5, 10]


@pytest.mark.parametrize("known_after", [1, 5])
def test_the_time_is_unknown_until_enough_replies_have_come(known_after: int) -> None:
    controller = Controller(TimeSync(known_after))
    for number in range(1, known_after + 1):
        assert controller.sync.offset is None
        controller.run(0.1)
        assert (controller.sync.offset is not None) is (number == known_after)


def test_a_bridge_that_is_started_anew_knows_the_time_by_one_reply() -> None:
    """A bridge that needed five replies again would be silent for too long: the controller's failsafe would act."""
    for kept, replies in ((None, 5), (KeptEpoch(7, 40 * S, 1000 * S), 1)):
        clock = ControllerClock(1000, kept, lambda epoch: None)
        controller = Controller(clock.sync)
        controller.run(0.1 * replies - 0.1)
        assert clock.due(controller.host_ns) is None
        controller.run(0.1)
        assert clock.due(controller.host_ns) is not None


def test_the_last_ten_seconds_alone_give_the_drift() -> None:
    controller = Controller(TimeSync(), rate=1.0)
    controller.run(30.0)
    controller.set(controller.now_ns)
    controller.rate = 1.0 + 500e-6
    controller.run(12.0)
    assert controller.sync.jumps == 0
    assert controller.sync.offset is not None
    assert controller.sync.offset.rate == pytest.approx(1.0 + 500e-6, abs=30e-6)


def test_a_slow_line_that_delays_most_replies_costs_little() -> None:
    controller = Controller(TimeSync(), rate=1.0 + 50e-6)
    controller.late_ns = 30 * MS
    controller.run(20.0)
    assert abs(controller.error_ns) < 10 * MS
    assert controller.sync.jumps == 0


def test_a_jump_of_the_clock_is_followed_within_half_a_second_and_one_late_reply_is_not() -> None:
    controller = Controller(TimeSync())
    controller.run(10.0)
    controller.line_ns = 200 * MS  # one reply
    controller.run(0.1)
    controller.line_ns = MS // 10
    controller.run(1.0)
    assert controller.sync.jumps == 0
    controller.set(controller.now_ns + 2 * S)
    controller.run(0.5)
    assert controller.sync.jumps == 1
    assert controller.sync.boots == 0
    assert abs(controller.error_ns) < MS


def test_replies_that_are_late_on_the_way_there_and_on_the_way_back_in_turn_are_no_jump() -> None:
    controller = Controller(TimeSync())
    controller.run(10.0)
    before = controller.sync.offset
    for number in range(6):
        controller.host_ns += PERIOD_NS
        assert controller.sync.due(controller.host_ns)
        error_ns = 300 * MS if number % 2 == 0 else -300 * MS
        controller.sync.on_reply(controller.now_ns + error_ns, controller.host_ns, controller.host_ns + MS)
    assert (controller.sync.jumps, controller.sync.boots) == (0, 0)
    assert controller.sync.offset is before


def test_a_boot_is_a_boot_and_no_jump() -> None:
    controller = Controller(TimeSync())
    controller.run(10.0)
    controller.set(3 * S)
    controller.run(0.2)
    assert (controller.sync.boots, controller.sync.jumps) == (1, 0)
    assert abs(controller.error_ns) < MS


def test_replies_to_other_programs_and_impossible_ones_are_ignored() -> None:
    controller = Controller(TimeSync())
    controller.run(2.0)
    before = controller.sync.offset
    controller.sync.on_reply(7, 12345, controller.host_ns)
    assert controller.sync.due(controller.host_ns)
    controller.sync.on_reply(-5, controller.host_ns, controller.host_ns + MS)
    assert controller.sync.offset is before
    assert controller.sync.boots == 0


def reply(sync: TimeSync, controller_ns: int, wall_ns: int, round_trip_ns: int = 2 * MS) -> None:
    """A request at a time, and its reply, for which the controller's time is that of the middle of the round trip."""
    assert sync.due(wall_ns)
    sync.on_reply(controller_ns + round_trip_ns // 2, wall_ns, wall_ns + round_trip_ns)


def known(round_trip_ns: int = 2 * MS) -> TimeSync:
    """A controller whose time is 40 s at 1000 s of this computer, by twenty replies in the two seconds before."""
    sync = TimeSync()
    for number in range(-20, 0):
        reply(sync, 40 * S + number * PERIOD_NS, 1000 * S + number * PERIOD_NS, round_trip_ns)
    assert sync.offset is not None
    return sync


@pytest.mark.parametrize(("round_trip_ms", "taken"), [(300, True), (900, False)])
def test_a_reply_that_is_late_by_most_of_a_second_says_nothing(round_trip_ms: int, taken: bool) -> None:
    sync = known()
    before = sync.offset
    reply(sync, 40 * S, 1000 * S, round_trip_ms * MS)
    assert (sync.offset is not before) is taken


def test_each_request_has_one_reply() -> None:
    sync = TimeSync(known_after=2)
    assert sync.due(1000 * S)
    for _ in range(3):
        sync.on_reply(40 * S, 1000 * S, 1000 * S + MS)
    assert sync.offset is None, "the network has doubled a datagram"


@pytest.mark.parametrize(
    ("difference_ms", "round_trip_ms", "jumps"),
    [(10, 2, 0), (-10, 2, 0), (40, 2, 1), (-40, 2, 1), (40, 100, 0), (-40, 100, 0), (100, 100, 1), (-100, 100, 1)],
)
def test_a_difference_that_the_round_trip_does_not_explain_is_a_jump_after_three_replies(
    difference_ms: int, round_trip_ms: int, jumps: int
) -> None:
    sync = known()
    for number in range(3):
        assert sync.jumps == 0
        t_ns = number * PERIOD_NS
        reply(sync, 40 * S + difference_ms * MS + t_ns, 1000 * S + t_ns, round_trip_ms * MS)
    assert (sync.jumps, sync.boots) == (jumps, 0)


@pytest.mark.parametrize(("difference_ms", "jumps"), [(60, 0), (-60, 0), (200, 1), (-200, 1)])
def test_on_a_slow_line_the_time_known_so_far_may_be_wrong_too(difference_ms: int, jumps: int) -> None:
    """A round trip takes 100 ms. Nobody knows which part of it is the way there, so the time is as uncertain."""
    sync = known(round_trip_ns=100 * MS)
    for number in range(3):
        t_ns = number * PERIOD_NS
        reply(sync, 40 * S + difference_ms * MS + t_ns, 1000 * S + t_ns, 100 * MS)
    assert sync.jumps == jumps


def test_on_a_slow_line_the_replies_with_the_shortest_round_trip_count() -> None:
    """Four of five come back 60 ms later than the fifth, which moves the middle of their round trips by 30 ms."""
    sync = TimeSync()
    for number in range(50):
        begin_ns, late_ns = 1000 * S + number * PERIOD_NS, 0 if number % 5 == 0 else 60 * MS
        assert sync.due(begin_ns)
        sync.on_reply(begin_ns - 960 * S + 20 * MS, begin_ns, begin_ns + 40 * MS + late_ns)
    assert sync.offset is not None
    assert sync.offset.controller_ns(1005 * S) == pytest.approx(45 * S, abs=MS)


def test_a_late_one_of_the_first_two_replies_makes_no_drift() -> None:
    """It comes back 38 ms late, so that the middle of its round trip seems to be 19 ms off, 0.1 s after the first."""
    sync = TimeSync(known_after=1)
    reply(sync, 40 * S, 1000 * S)
    begin_ns = 1000 * S + PERIOD_NS
    assert sync.due(begin_ns)
    sync.on_reply(begin_ns - 960 * S + MS, begin_ns, begin_ns + 40 * MS)
    assert sync.offset is not None
    assert sync.offset.controller_ns(1002 * S) == pytest.approx(42 * S, abs=3 * MS)


@pytest.mark.parametrize(("back_s", "boots"), [(0.5, 0), (2.0, 1)])
def test_a_step_back_by_more_than_a_second_is_a_boot(back_s: float, boots: int) -> None:
    sync = known()
    reply(sync, 40 * S - int(back_s * S), 1000 * S)
    assert sync.boots == boots


def test_after_a_boot_the_time_is_known_by_one_reply_and_after_a_jump_by_those_that_showed_it() -> None:
    sync = known()
    reply(sync, 3 * S, 1000 * S)
    assert sync.offset is not None
    assert sync.offset.controller_ns(1001 * S) == pytest.approx(4 * S, abs=MS)
    sync = known()
    for number in range(3):
        reply(sync, 50 * S + number * PERIOD_NS, 1000 * S + number * PERIOD_NS)
    assert sync.offset is not None
    assert sync.offset.controller_ns(1001 * S) == pytest.approx(51 * S, abs=MS)


def test_the_quality_of_the_time_is_told_with_spread_drift_and_round_trip() -> None:
    good = Offset(offset_ns=0, wall_ns=0, rate=1.0 - 37e-6, spread_ns=0.0, round_trip_ns=2_300_000)
    assert good.text == "its clock is known within 0.01 ms, drift -37 ppm, round trip 2.3 ms"
    poor = Offset(offset_ns=0, wall_ns=0, rate=1.0 + 4e-3, spread_ns=1_500_000.0, round_trip_ns=48_000_000)
    assert poor.text == "its clock is known within 1.50 ms, drift +4000 ppm, round trip 48.0 ms"


def test_the_clock_is_published_ten_times_a_second_and_its_epoch_kept_every_ten() -> None:
    kept: list[KeptEpoch] = []
    clock = ControllerClock(1000, None, kept.append)
    controller = Controller(clock.sync)
    controller.run(1.0)
    published_s = []
    begin_ns = controller.host_ns
    while (passed_ns := controller.host_ns - begin_ns) < 25 * S:
        if clock.due(controller.host_ns) is not None:
            published_s.append(passed_ns / S)
        controller.host_ns += PERIOD_NS // 4
    assert len(published_s) == 250
    assert [epoch.wall_ns - begin_ns for epoch in kept] == [0, 10 * S, 20 * S]
    assert {epoch.epoch_id for epoch in kept} == {1000}
    assert kept[-1].controller_ns - kept[0].controller_ns == pytest.approx(20 * S, abs=10 * MS)
    controller.set(2 * S)
    controller.run(0.2)
    assert clock.due(controller.host_ns) is not None
    assert [epoch.epoch_id for epoch in kept[3:]] == [1001], "a new epoch is kept at once"


def test_an_epoch_is_kept_at_once_also_seconds_after_the_boot_of_this_computer() -> None:
    kept: list[KeptEpoch] = []
    clock = ControllerClock(1000, None, kept.append)
    controller = Controller(clock.sync)
    controller.host_ns = S
    controller.set(40 * S)
    controller.run(1.0)
    assert clock.due(controller.host_ns) is not None
    assert [epoch.epoch_id for epoch in kept] == [1000]


def test_vehicle_time_is_never_negative() -> None:
    """The first line through late replies may begin before the controller's boot."""
    clock = ControllerClock(1000, KeptEpoch(7, 40 * S, 900 * S), lambda epoch: None)
    assert clock.sync.due(1000 * S)
    clock.sync.on_reply(MS, 1000 * S, 1000 * S + 100 * MS)
    message = clock.due(1000 * S)
    assert message is not None and message.t_ns == 0


@pytest.mark.parametrize(("folder", "name"), [("/tmp/run", "/tmp/run/epoch.json"), ("", None)])
def test_the_epoch_is_kept_in_the_run_folder(folder: str, name: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_RUN_DIR", folder)
    assert kept_epoch_path() == (None if name is None else Path(name))


def clock_of(controller: Controller, clock: ControllerClock) -> int:
    message = clock.due(controller.host_ns)
    assert message is not None
    assert message.t_ns == pytest.approx(controller.now_ns, abs=MS)
    return message.epoch_id


def test_the_epoch_changes_with_each_boot_and_outlives_the_bridge() -> None:
    kept: list[KeptEpoch] = []
    clock = ControllerClock(1000, None, kept.append)
    controller = Controller(clock.sync)
    assert clock.due(controller.host_ns) is None  # before the time is known
    controller.run(2.0)
    assert clock_of(controller, clock) == 1000
    controller.set(5 * S)
    controller.run(0.2)
    assert clock_of(controller, clock) == 1001

    again = ControllerClock(2000, kept[-1], kept.append)
    controller.sync = again.sync
    controller.run(3.0)
    assert clock_of(controller, again) == 1001

    controller.set(2 * S)  # booted while no bridge ran
    third = ControllerClock(3000, kept[-1], kept.append)
    controller.sync = third.sync
    controller.run(1.0)
    assert clock_of(controller, third) == 1002


@pytest.mark.parametrize(
    ("passed_s", "of_controller_s", "same"),
    [
        (5, 5.0, True),
        (5, 4.2, True),
        (5, 5.8, True),
        (5, 2.0, False),
        (100, 96.0, True),  # a slow simulation loses up to 4 % of this computer's time
        (100, 104.0, True),
        (100, 92.0, False),
        (100, 108.0, False),
        (-5, -5.0, False),  # this computer was started anew
    ],
)
def test_a_controller_has_run_on_when_its_time_has_passed_as_this_computers(
    passed_s: int, of_controller_s: float, same: bool
) -> None:
    kept = KeptEpoch(7, 40 * S, 900 * S)
    assert kept.is_same_boot(40 * S + int(of_controller_s * S), (900 + passed_s) * S) is same


def test_an_epoch_is_kept_in_a_file_and_a_broken_one_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "epoch.json"
    assert load_epoch(path) is None
    epoch = KeptEpoch(7, 5 * S, 900 * S)
    save_epoch(path, epoch)
    assert load_epoch(path) == epoch
    path.write_text("{")
    assert load_epoch(path) is None
    save_epoch(tmp_path / "missing" / "epoch.json", epoch)
    assert capsys.readouterr().err.count("epoch") >= 2
