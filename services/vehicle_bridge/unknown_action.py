"""Replies to requests to actions that don't exist: else their clients would hear nothing."""

from collections.abc import Callable, Collection
from difflib import get_close_matches

from jezero.schemas.actions import CancelReply, ModifyReply, PauseReply, PlanReply, Rejected, ResumeReply
from jezero.schemas.struct import Payload
from jezero.schemas.topics import RESULT

REFUSALS: dict[str, Callable[[str], Payload]] = {
    "": lambda why: Rejected(reason=why),
    "plan": lambda why: PlanReply(accepted=False, reason=why),
    "cancel": lambda why: CancelReply(canceled=False, reason=why),
    "pause": lambda why: PauseReply(paused=False, reason=why),
    "resume": lambda why: ResumeReply(resumed=False, reason=why),
    "modify": lambda why: ModifyReply(modified=False, reason=why),
}
"""Replies by the part of the key behind the action's name."""
NAME_LENGTH_MAX = 64


def refusal_of(key: str, actions: Collection[str]) -> Payload | None:
    """Reply to a request; None for one that is left to an action server, or that nobody could understand.

    Args:
        key: of the request, `@action/<name>` or `@action/<name>/<request>`.
        actions: names of all actions.
    """
    name, _, request = key.removeprefix("@action/").partition("/")
    if name in actions or key == RESULT.name or request not in REFUSALS:
        return None
    nearest = get_close_matches(name, actions, n=1)
    meant = f" Did you mean {nearest[0]}?" if nearest else ""
    shown = name if len(name) <= NAME_LENGTH_MAX else f"{name[:NAME_LENGTH_MAX]}…"
    return REFUSALS[request](
        f"there is no action {shown!r}; there are {', '.join(actions)}.{meant} `action/*/description` has their fields"
    )
