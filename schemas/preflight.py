"""Preflight checks: what a pilot checks before a takeoff."""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.schemas.struct import Message, Payload, Text

Verdict = Literal["passed", "warning", "failed"]
"""`warning` is worth knowing, `failed` keeps the vehicle on the ground."""
Override = Literal["services", "clock", "sensors", "noise", "gnss", "compass", "battery", "storage"]
"""Name of a check that a takeoff may override."""
CheckName = Literal["autopilot", "rover", "fence"] | Override
"""Name of a check. `autopilot` and `fence` can't be overridden, as the autopilot would not arm, and goals outside the
fence are refused; `rover` never fails."""


class Check(Payload, frozen=True, kw_only=True):
    """Outcome of one preflight check.

    Attributes:
        name: name of the check.
        verdict: outcome: `passed`, `warning` or `failed`.
        text: what was found, with figures, and what to do about it, for people.
    """

    name: CheckName
    verdict: Verdict
    text: Text


class PreflightReport(Message, frozen=True, kw_only=True):
    """Outcome of all preflight checks; `t_ns` is the end of the second in which the sensors were read.

    Attributes:
        epoch_id: id of the epoch, see `Clock`.
        checks: outcome of each check.
    """

    epoch_id: int
    checks: Annotated[tuple[Check, ...], Meta(max_length=32)]

    def failed(self) -> tuple[Check, ...]:
        """Checks that have failed."""
        return tuple(check for check in self.checks if check.verdict == "failed")


class GetPreflight(Payload, frozen=True, kw_only=True):
    """Request to check everything anew, which takes a second and a half; it has no fields."""


class PreflightReply(Payload, frozen=True, kw_only=True):
    """Reply to `GetPreflight`.

    Attributes:
        report: outcome of all checks. None for a request that was refused.
        reason: reason of a refusal, for people.
    """

    report: PreflightReport | None = None
    reason: Text = ""
