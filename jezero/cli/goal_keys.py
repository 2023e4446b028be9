"""Keys while the progress of a goal is shown: p pauses it, r resumes it."""

from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from jezero.cli.keyboard import Keyboard

if TYPE_CHECKING:
    from jezero.cli.shared import Printer
    from jezero.client import Goal

HINT = "p pauses, r resumes, Ctrl+C cancels"


class GoalKeys:
    """The keys of one goal; a context manager. Without a terminal, and with JSON, there are none."""

    def __init__(self, printer: "Printer", goal: "Goal[Any, Any]") -> None:
        self._printer = printer
        self._goal = goal
        self._keyboard = Keyboard()

    def __enter__(self) -> Self:
        self._keyboard.__enter__()
        if self._keyboard.attached and not self._printer.as_json:
            self._printer.hint(HINT)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._keyboard.__exit__(kind, error, trace)

    def poll(self) -> None:
        """Send the request of the key that was pressed last, if any; a refusal is a warning."""
        if not self._keyboard.attached or self._printer.as_json:
            return
        from jezero.client import Refused

        pressed = self._keyboard.read(0.0)[-1:]
        try:
            if pressed in ("p", "P"):
                self._goal.pause()
            elif pressed in ("r", "R"):
                self._goal.resume()
        except Refused as error:
            self._printer.warn(str(error))
