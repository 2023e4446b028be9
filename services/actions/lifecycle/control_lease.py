"""The control lease of a goal: the right to send setpoints, which the bridge grants and may take away."""

from jezero.runtime.service import Inbox
from jezero.schemas.commands import AcquireReply
from jezero.schemas.state import STATUS_WORDS, Clock, Status, StatusCode
from jezero.schemas.topics import CLOCK, STATUS
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.lifecycle.vehicle_view import STATUS_AGE_MAX_S

BRIDGE_RESTART_MARGIN_NS = 100_000_000
"""A status of another run of the bridge that is at most this much newer than the grant is from the previous run."""


class ControlLease:
    """The control lease of one goal.

    Args:
        epoch_id: of the vehicle that the goal is for.

    Attributes:
        id: control id that setpoints and the release carry; "" before the grant.
    """

    def __init__(self, epoch_id: int) -> None:
        self._epoch_id = epoch_id
        self.id = ""
        self._grant = AcquireReply(granted=False)
        self._age_max_ns = STATUS_AGE_MAX_S * NS_PER_S
        self._granted_ns = 0
        self._confirmed = False
        """Whether a status has confirmed that the goal is in charge."""
        self._checked: tuple[Status | None, Clock | None] = (None, None)
        """The newest messages that were checked and by which the goal was in charge."""

    def begin(self, grant: AcquireReply, t_ns: int) -> None:
        """Begin with the bridge's grant."""
        self.id = grant.control_id
        self._grant = grant
        self._granted_ns = t_ns

    def is_ours(self, status: Status) -> bool:
        """Whether the goal is in charge by this status."""
        return status.bridge_boot_id == self._grant.bridge_boot_id and status.grant == self._grant.grants

    def loss_reason(self, t_ns: int, inbox: Inbox) -> str:
        """Reason why this goal isn't in charge any more and needs no release, or ""."""
        latest, clock = inbox.latest(STATUS), inbox.latest(CLOCK)
        checked, checked_clock = self._checked
        if (
            latest is checked
            and clock is checked_clock
            and latest is not None
            and t_ns - latest.t_ns <= self._age_max_ns
        ):
            return ""
        if (reason := self._connection_loss(t_ns, inbox)) or latest is None:
            return reason
        for status in inbox.new(STATUS) or (latest,):
            if lost := self._loss_by_status(status):
                return lost
        self._checked = (latest, clock)
        return ""

    def bridge_loss_reason(self, t_ns: int, inbox: Inbox) -> str:
        """Reason why the bridge that granted control can't confirm its release, or ""."""
        status = inbox.latest(STATUS)
        if reason := self._connection_loss(t_ns, inbox):
            return reason
        another = status is not None and self._confirmed and status.bridge_boot_id != self._grant.bridge_boot_id
        return "the vehicle bridge restarted" if another else ""

    def _loss_by_status(self, status: Status) -> str:
        ours = self.is_ours(status)
        self._confirmed |= ours
        if status.bridge_boot_id != self._grant.bridge_boot_id:
            before = not self._confirmed and status.t_ns <= self._granted_ns + BRIDGE_RESTART_MARGIN_NS
            return "" if before else "the vehicle bridge restarted"
        if status.grants < self._grant.grants:
            return ""
        if ours and status.code not in (StatusCode.ABORT, StatusCode.EXTERNAL):
            return ""
        return status.text or f"control was taken away, the vehicle {STATUS_WORDS[StatusCode(status.code)]}"

    def _connection_loss(self, t_ns: int, inbox: Inbox) -> str:
        """Reason why the bridge is silent or the vehicle is another one, or ""."""
        clock, status = inbox.latest(CLOCK), inbox.latest(STATUS)
        if status is None or t_ns - status.t_ns > self._age_max_ns:
            return f"the vehicle bridge has been silent for {STATUS_AGE_MAX_S:g} s"
        epochs = {status.epoch_id, self._epoch_id if clock is None else clock.epoch_id}
        epochs.discard(0)  # a bridge that has just started doesn't know the epoch
        return "the vehicle restarted" if epochs - {self._epoch_id} else ""
