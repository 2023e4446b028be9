"""The control that the bridge gave to a goal: whether the goal still has it, and why not."""

from jezero.runtime.service import Inbox
from jezero.schemas.commands import AcquireReply
from jezero.schemas.state import Clock, Status, StatusCode
from jezero.schemas.topics import CLOCK, STATUS
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.lifecycle.config import LifecycleConfig

BRIDGE_BEFORE_NS = 100_000_000
"""A status of another run of the bridge, until so long after the grant, is from the run before."""


class Control:
    """One goal's.

    Args:
        epoch_id: of the vehicle that the goal is for.

    Attributes:
        id: what setpoints and the release name; "" before control is given.
    """

    def __init__(self, config: LifecycleConfig, epoch_id: int) -> None:
        self._config = config
        self._epoch_id = epoch_id
        self.id = ""
        self._grant = AcquireReply(granted=False)
        self._age_max_ns = config.status_age_max_s * NS_PER_S
        self._granted_ns = 0
        self._seen = False
        """A status has said that the goal is in charge."""
        self._good: tuple[Status | None, Clock | None] = (None, None)
        """The newest by which it was in charge when they were looked at."""

    def begin(self, grant: AcquireReply, t_ns: int) -> None:
        """The bridge has given it."""
        self.id = grant.control_id
        self._grant = grant
        self._granted_ns = t_ns

    def is_ours(self, status: Status) -> bool:
        """Whether the goal is in charge by this status."""
        return status.bridge_boot_id == self._grant.bridge_boot_id and status.control_id == self._grant.control_id

    def loss(self, t_ns: int, inbox: Inbox) -> str:
        """Why this goal isn't in charge any more, or "". Then there is nothing left to release."""
        latest, clock = inbox.latest(STATUS), inbox.latest(CLOCK)
        good, good_clock = self._good
        if latest is good and clock is good_clock and latest is not None and t_ns - latest.t_ns <= self._age_max_ns:
            return ""
        if (broken := self._broken(t_ns, inbox)) or latest is None:
            return broken
        for status in inbox.new(STATUS) or (latest,):
            if lost := self._loss_by(status):
                return lost
        self._good = (latest, clock)
        return ""

    def partner_loss(self, t_ns: int, inbox: Inbox) -> str:
        """Why the bridge or the vehicle is not the one that gave control, or is silent; or ""."""
        status = inbox.latest(STATUS)
        if broken := self._broken(t_ns, inbox):
            return broken
        another = status is not None and self._seen and status.bridge_boot_id != self._grant.bridge_boot_id
        return "the vehicle bridge restarted" if another else ""

    def _loss_by(self, status: Status) -> str:
        ours = self.is_ours(status)
        self._seen |= ours
        if status.bridge_boot_id != self._grant.bridge_boot_id:
            before = not self._seen and status.t_ns <= self._granted_ns + BRIDGE_BEFORE_NS
            return "" if before else "the vehicle bridge restarted"
        if status.grants < self._grant.grants:
            return ""
        if ours and status.code not in (StatusCode.ABORT, StatusCode.EXTERNAL):
            return ""
        return status.text or f"control was taken away (status {status.code} {status.name})"

    def _broken(self, t_ns: int, inbox: Inbox) -> str:
        """Why the vehicle or its bridge can't answer for this goal, or ""."""
        clock, status = inbox.latest(CLOCK), inbox.latest(STATUS)
        if status is None or t_ns - status.t_ns > self._age_max_ns:
            return f"the vehicle bridge has been silent for {self._config.status_age_max_s:g} s"
        restarted = status.epoch_id != self._epoch_id or (clock is not None and clock.epoch_id != self._epoch_id)
        return "the vehicle restarted" if restarted else ""
