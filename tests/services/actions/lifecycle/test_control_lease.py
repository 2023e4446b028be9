"""Which status takes control away from a goal: none from before the grant, and each of another bridge after it."""

from collections.abc import Sequence
from typing import Any

import pytest
from msgspec.structs import replace

from jezero.schemas.commands import AcquireReply
from jezero.schemas.state import Clock, Status, StatusCode
from jezero.schemas.topics import STATUS
from jezero.services.actions.lifecycle.leases import ControlLease
from tests.services.actions.test_behaviours import a_status

S, MS = 1_000_000_000, 1_000_000
GRANTED_NS = 50 * S
BEFORE, PRESENT = 6, 7
"""Boot ids of two runs of the bridge."""


class Box:
    """The statuses that have arrived, and the newest clock."""

    def __init__(self, *statuses: Status, epoch_id: int | None = None) -> None:
        self.statuses = statuses
        self.clock = None if epoch_id is None else Clock(t_ns=GRANTED_NS, wall_ns=0, epoch_id=epoch_id)

    def latest(self, topic: Any) -> Any:
        if topic is STATUS:
            return self.statuses[-1] if self.statuses else None
        return self.clock

    def new(self, topic: Any) -> Sequence[Status]:
        return self.statuses


def status(ms_after: int, boot_id: int, grant: int | None = None, grants: int = 3) -> Status:
    """The status of a run of the bridge at a time after the grant."""
    return replace(
        a_status(StatusCode.GO_TO), t_ns=GRANTED_NS + ms_after * MS, bridge_boot_id=boot_id, grant=grant, grants=grants
    )


def loss(lease: ControlLease, *statuses: Status) -> str:
    return lease.loss_reason(statuses[-1].t_ns, Box(*statuses))  # type: ignore[arg-type]


def granted() -> ControlLease:
    lease = ControlLease(epoch_id=1)
    grant = AcquireReply(granted=True, control_id="c", bridge_boot_id=PRESENT, grants=3)
    lease.begin(grant, GRANTED_NS)
    return lease


@pytest.mark.parametrize(("ms_after", "lost"), [(-200, False), (100, False), (101, True)])
def test_a_status_of_the_bridges_run_before_counts_for_nothing_until_a_tenth_of_a_second_after_the_grant(
    ms_after: int, lost: bool
) -> None:
    assert (loss(granted(), status(ms_after, BEFORE)) == "the vehicle bridge restarted") is lost


def test_another_run_of_the_bridge_ends_a_goal_that_a_status_has_confirmed_at_once() -> None:
    lease = granted()
    assert loss(lease, status(20, PRESENT, grant=3)) == ""
    assert loss(lease, status(40, BEFORE)) == "the vehicle bridge restarted"


def test_a_status_from_before_the_grant_takes_nothing_away_and_one_of_a_later_grant_does() -> None:
    lease = granted()
    assert loss(lease, status(-10, PRESENT, grant=2, grants=2)) == ""
    assert loss(lease, status(20, PRESENT, grant=3)) == ""
    assert loss(lease, status(40, PRESENT, grant=4, grants=4)) != ""


@pytest.mark.parametrize(("late_ms", "lost"), [(1000, False), (1001, True)])
def test_a_bridge_that_is_silent_for_a_second_ends_the_goal_also_when_it_is_being_released(
    late_ms: int, lost: bool
) -> None:
    lease, box = granted(), Box(status(20, PRESENT, grant=3))
    for reason in (lease.loss_reason, lease.bridge_loss_reason):
        late_ns = GRANTED_NS + (20 + late_ms) * MS
        assert reason(GRANTED_NS + 30 * MS, box) == ""  # type: ignore[arg-type]
        assert reason(late_ns, box) == ("the vehicle bridge has been silent for 1 s" if lost else "")  # type: ignore[arg-type]
        assert reason(late_ns, Box()) == "the vehicle bridge has been silent for 1 s"  # type: ignore[arg-type]


def test_a_bridge_whose_status_never_comes_is_silent_too() -> None:
    silent = "the vehicle bridge has been silent for 1 s"
    assert granted().loss_reason(GRANTED_NS, Box()) == silent  # type: ignore[arg-type]
    assert granted().bridge_loss_reason(GRANTED_NS, Box()) == silent  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("of_status", "of_clock", "lost"), [(1, 1, False), (0, 1, False), (2, 1, True), (1, 2, True), (1, None, False)]
)
def test_another_epoch_of_status_or_clock_is_another_vehicle(of_status: int, of_clock: int | None, lost: bool) -> None:
    """Epoch 0 is that of a bridge that has just started, and doesn't know it yet."""
    box = Box(replace(status(20, PRESENT, grant=3), epoch_id=of_status), epoch_id=of_clock)
    for reason in (granted().loss_reason, granted().bridge_loss_reason):
        assert reason(GRANTED_NS + 30 * MS, box) == ("the vehicle restarted" if lost else "")  # type: ignore[arg-type]


def test_a_clock_of_another_epoch_ends_the_goal_before_the_next_status_comes() -> None:
    lease, confirming = granted(), status(20, PRESENT, grant=3)
    before, after = Box(confirming, epoch_id=1), Box(confirming, epoch_id=2)
    assert lease.loss_reason(GRANTED_NS + 30 * MS, before) == ""  # type: ignore[arg-type]
    assert lease.loss_reason(GRANTED_NS + 35 * MS, before) == ""  # type: ignore[arg-type]
    assert lease.loss_reason(GRANTED_NS + 40 * MS, after) == "the vehicle restarted"  # type: ignore[arg-type]


@pytest.mark.parametrize("code", [StatusCode.ABORT, StatusCode.EXTERNAL])
@pytest.mark.parametrize("text", ["", "a pilot has taken over: POSCTL"])
def test_a_status_without_the_goal_in_charge_ends_it_with_the_bridges_words(code: StatusCode, text: str) -> None:
    lease = granted()
    assert loss(lease, status(20, PRESENT, grant=3)) == ""
    taken = replace(status(40, PRESENT, grant=3), code=int(code), text=text)
    words = loss(lease, taken)
    assert words == text or words.startswith("control was taken away, the vehicle ")
    assert loss(granted(), replace(status(40, PRESENT), code=int(StatusCode.HOVER), text=text))


def test_only_another_run_of_the_bridge_than_the_one_that_has_confirmed_the_goal_cannot_confirm_its_end() -> None:
    lease = granted()
    other, ours = Box(status(200, BEFORE)), Box(status(20, PRESENT, grant=3))
    assert lease.bridge_loss_reason(GRANTED_NS + 30 * MS, other) == ""  # type: ignore[arg-type]
    assert lease.loss_reason(GRANTED_NS + 30 * MS, ours) == ""  # type: ignore[arg-type]
    assert lease.bridge_loss_reason(GRANTED_NS + 30 * MS, ours) == ""  # type: ignore[arg-type]
    assert lease.bridge_loss_reason(GRANTED_NS + 30 * MS, other) == "the vehicle bridge restarted"  # type: ignore[arg-type]


def test_a_loss_of_control_ends_the_goal_also_when_a_newer_status_has_arrived_with_it() -> None:
    """A computer that stood still for a moment gets both in one step, and the goal must not fly on after a pilot."""
    taken = replace(status(40, PRESENT, grant=3), code=int(StatusCode.EXTERNAL), text="a pilot has taken over")
    assert loss(granted(), taken, status(60, PRESENT, grant=3)) == "a pilot has taken over"


def test_a_loss_of_control_that_came_with_the_grant_ends_the_goal_in_its_first_step() -> None:
    """The step of the grant has read that status already."""

    class Read(Box):
        def new(self, topic: Any) -> Sequence[Status]:
            return ()

    taken = replace(status(40, PRESENT, grant=3), code=int(StatusCode.EXTERNAL), text="a pilot has taken over")
    assert granted().loss_reason(GRANTED_NS + 50 * MS, Read(taken)) == "a pilot has taken over"  # type: ignore[arg-type]
