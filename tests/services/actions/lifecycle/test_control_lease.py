"""Which status takes control away from a goal: none from before the grant, and each of another bridge after it."""

from collections.abc import Sequence
from typing import Any

import pytest
from msgspec.structs import replace

from jezero.schemas.commands import AcquireReply
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.topics import STATUS
from jezero.services.actions.lifecycle.leases import ControlLease
from tests.services.actions.test_behaviours import a_status

S, MS = 1_000_000_000, 1_000_000
GRANTED_NS = 50 * S
BEFORE, PRESENT = 6, 7
"""Boot ids of two runs of the bridge."""


class Box:
    """The statuses that have arrived."""

    def __init__(self, *statuses: Status) -> None:
        self.statuses = statuses

    def latest(self, topic: Any) -> Any:
        return self.statuses[-1] if topic is STATUS else None

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
