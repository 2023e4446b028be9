"""The flight controller's time by TIMESYNC, against a controller whose clock is known here and nowhere else."""

from pathlib import Path
from random import Random

import pytest

from jezero.services.vehicle_bridge.time_sync import (
    PERIOD_NS,
    ControllerClock,
    KeptEpoch,
    TimeSync,
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
    """After a second without setpoints the controller's failsafe would act."""
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
