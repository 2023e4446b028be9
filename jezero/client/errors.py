"""What can go wrong, each with a name of its own."""

from typing import Any


class JezeroError(Exception):
    """Base of all errors of the client."""


class Unreachable(JezeroError):  # noqa: N818
    """No router, no server, or it died: nobody is there to answer."""


class Refused(JezeroError):  # noqa: N818
    """The vehicle may not do this now.

    Attributes:
        reason: why, and what to do instead.
        code: the vehicle's status code at that time, None when unknown.
    """

    def __init__(self, reason: str, code: int | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.code = code


class EndedError(JezeroError):
    """Base of `Aborted` and `Canceled`: a goal ended without success.

    Attributes:
        result: what the goal reported all the same, e.g. where it ended.
    """

    def __init__(self, reason: str, result: Any = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.result = result


class Aborted(EndedError):  # noqa: N818
    """The goal was accepted but could not be finished; the vehicle hovers or obeys somebody else."""


class Canceled(EndedError):  # noqa: N818
    """The goal was canceled; the vehicle hovers."""


class TimedOut(JezeroError):  # noqa: N818
    """No answer in time. A goal waited for goes on."""
