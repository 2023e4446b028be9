"""Errors of the client."""

from typing import Any


class JezeroError(Exception):
    """Base of all errors of the client."""


class Unreachable(JezeroError):  # noqa: N818
    """No router or no server replies, or the connection to it is lost."""


class Refused(JezeroError):  # noqa: N818
    """The vehicle refused a goal or a request.

    Attributes:
        reason: why, and what to do about it.
        code: the vehicle's status code at that time; None if unknown.
        input_missing: a plan was refused for a measurement that is missing now.
    """

    def __init__(self, reason: str, code: int | None = None, *, input_missing: bool = False) -> None:
        super().__init__(reason)
        self.reason = reason
        self.code = code
        self.input_missing = input_missing


class EndedError(JezeroError):
    """Base of `Aborted` and `Canceled`: a goal ended without success.

    Attributes:
        reason: why the goal ended.
        result: the goal's result all the same, e.g. the last position; None without one.
    """

    def __init__(self, reason: str, result: Any = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.result = result


class Aborted(EndedError):  # noqa: N818
    """The goal was accepted but not completed; the vehicle hovers, or somebody else has control."""


class Canceled(EndedError):  # noqa: N818
    """The goal was canceled; the vehicle hovers."""


class TimedOut(JezeroError):  # noqa: N818
    """No reply or no result in time. A goal continues."""
