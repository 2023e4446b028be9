"""Keys while the progress of a goal is shown, and the words of `jezero modify`."""

from collections.abc import Iterator
from typing import Any

import pytest
from click.testing import CliRunner

from jezero.cli.goal_keys import GoalKeys
from jezero.cli.main import main
from jezero.cli.shared import Printer
from jezero.client import Refused


class FakeGoal:
    """Notes what it is asked for; can't be resumed."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def pause(self) -> None:
        self.asked.append("pause")

    def resume(self) -> None:
        self.asked.append("resume")
        raise Refused("goal g is not paused")


class FakeKeyboard:
    """Gives one key, or several at once, at each reading."""

    attached = True

    def __init__(self, pressed: list[str]) -> None:
        self._pressed: Iterator[str] = iter(pressed)

    def read(self, timeout_s: float) -> str:
        return next(self._pressed)


def polled(pressed: list[str], *, as_json: bool = False) -> list[str]:
    """What a goal is asked for while these keys are pressed."""
    goal: Any = FakeGoal()
    keys = GoalKeys(Printer(as_json), goal)
    keyboard: Any = FakeKeyboard(pressed)
    keys._keyboard = keyboard
    for _ in pressed:
        keys.poll()
    asked: list[str] = goal.asked
    return asked


def test_p_pauses_r_resumes_and_other_keys_do_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert polled(["p", "", "x", "R", "\x1b[C", "xp"]) == ["pause", "resume", "pause"]
    assert "warning: goal g is not paused" in capsys.readouterr().err


def test_with_json_there_are_no_keys() -> None:
    assert polled(["p"], as_json=True) == []


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["modify"], "Missing argument 'KEY=VALUE"),
        (["modify", "speed_mps"], "'speed_mps' is not KEY=VALUE, such as speed_mps=1.5"),
        (["modify", "=1"], "'=1' is not KEY=VALUE"),
        (["modify", "speed_mps=1", "speed_mps=2"], "speed_mps is given twice"),
    ],
)
def test_wrong_words_are_told_in_one_sentence(words: list[str], problem: str) -> None:
    run = CliRunner().invoke(main, words)
    assert run.exit_code == 2
    assert problem in run.output
