"""How the end of a mission is shown: in words, by its colour, and by the exit code."""

from collections.abc import Iterator
from typing import Any

import pytest

from jezero.cli.exit_codes import ABORTED, INCOMPLETE
from jezero.cli.mission import _follow, in_words
from jezero.cli.shared import Printer
from jezero.schemas.mission import MissionProgress


def progress(**fields: Any) -> MissionProgress:
    return MissionProgress(t_ns=0, mission_id="m", name="survey", step=5, steps=5, label="land", **fields)


class Flown:
    """A vehicle whose mission has one progress: its end."""

    def __init__(self, end: MissionProgress) -> None:
        self._end = end

    @property
    def mission(self) -> "Flown":
        return self

    def watch(self) -> Iterator[MissionProgress]:
        yield self._end


@pytest.mark.parametrize(
    ("end", "words", "code"),
    [
        (progress(state="succeeded"), "survey: succeeded, 5 steps", 0),
        (progress(state="succeeded", left_out=2), "survey: succeeded, 2 of 5 steps left out", INCOMPLETE),
        (
            progress(state="failed", reason="too far"),
            "survey: failed at step 5 of 5, land: too far. jezero mission resume tries the step again",
            ABORTED,
        ),
    ],
)
def test_an_end_without_some_steps_differs_from_success(end: MissionProgress, words: str, code: int) -> None:
    assert in_words(end) == words
    vehicle: Any = Flown(end)
    if code == 0:
        _follow(Printer(False), vehicle, "m")
        return
    with pytest.raises(SystemExit) as ended:
        _follow(Printer(False), vehicle, "m")
    assert ended.value.code == code
