"""Mistakes in a mission file, and the error that names them."""

from collections.abc import Iterable
from dataclasses import dataclass

SHOWN_MAX = 20
"""Number of mistakes that one message names."""


@dataclass(frozen=True)
class Problem:
    """One mistake.

    Attributes:
        line: line of the file, counted from 1; 0 for the file as a whole.
        text: what is wrong, and what to write instead.
    """

    line: int
    text: str


class MissionFileError(ValueError):
    """The file is no mission.

    Attributes:
        problems: its mistakes, by line.
    """

    def __init__(self, file: object, problems: Iterable[Problem]) -> None:
        self.problems = tuple(sorted(problems, key=lambda problem: problem.line))
        shown = [
            f"{file}, line {problem.line}: {problem.text}" if problem.line else f"{file} {problem.text}"
            for problem in self.problems[:SHOWN_MAX]
        ]
        more = len(self.problems) - len(shown)
        super().__init__("\n".join([*shown, *([f"and {more} more"] if more else [])]))


class Problems:
    """Collects the mistakes of a file, so that one reading names all of them."""

    def __init__(self) -> None:
        self.found: list[Problem] = []

    def add(self, line: int, text: str) -> None:
        """Note a mistake."""
        self.found.append(Problem(line, text))


def listed(words: Iterable[str]) -> str:
    """Words for people; "none" for none."""
    return ", ".join(words) or "none"
