"""Background tasks as both buses execute them: a pickled function in, a pickled outcome out."""

import pickle
import traceback
from collections.abc import Callable
from typing import Any, NamedTuple


class TaskOutcome(NamedTuple):
    """Outcome of one task.

    Attributes:
        value: return value of the function; None after an error.
        error: reason why there is no value, or None.
    """

    value: Any
    error: str | None = None


CANCELED = TaskOutcome(None, "canceled")


def pickled(function: Callable[[], Any]) -> bytes | TaskOutcome:
    """A function as `execute` takes it, or the outcome of one that can't be sent to another process."""
    try:
        return pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        return TaskOutcome(None, f"it can't be sent to a process of its own ({error}): use a function of a module")


def execute(frame: bytes) -> bytes:
    """Execute a pickled function; returns the pickled outcome. An exception's traceback goes to standard error."""
    try:
        function: Callable[[], Any] = pickle.loads(frame)
        return pickle.dumps(TaskOutcome(function()))
    except Exception as error:  # noqa: BLE001 - the service decides what the failure of its task means
        traceback.print_exception(error)
        text = f"{type(error).__name__}: {error}; the traceback is in the log of the server"
        return pickle.dumps(TaskOutcome(None, text))


def read_outcome(data: bytes) -> TaskOutcome:
    """The outcome that `execute` has made."""
    try:
        outcome: TaskOutcome = pickle.loads(data)
    except Exception as error:  # noqa: BLE001 - a value's own code may raise anything
        return TaskOutcome(None, f"its value can't be read: {type(error).__name__}: {error}")
    return outcome
