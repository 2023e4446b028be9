"""Missions without a stack: their plan, made in the command's own process, and judged; the words for their end."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from jezero.cli.main import main
from jezero.cli.missions import _follow, progress_in_words
from jezero.cli.terminal import ABORTED, INCOMPLETE, Printer
from jezero.schemas.mission import MissionProgress, MissionState

NOBODY = ("--router", "tcp/127.0.0.1:1")
"""Address of a router that doesn't run."""


def check(tmp_path: Path, text: str, *options: str) -> Result:
    file = tmp_path / "mission.yaml"
    file.write_text(text)
    return CliRunner().invoke(main, ["mission", "check", str(file), *options, *NOBODY])


def test_a_mission_that_can_be_flown_is_planned_to_its_landing(tmp_path: Path) -> None:
    done = check(tmp_path, "steps: [{takeoff: {altitude_m: 10}}, {go_to: {target_ned_m: [200, 0, -10]}}, return_home]")
    assert done.exit_code == 0, done.output
    assert "no stack runs: planned for a full battery" in done.stdout
    home = next(line for line in done.stdout.splitlines() if "return home" in line)
    assert " 204 m," in home  # from where the step before ends


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("flgiht", "there is no mission 'flgiht'; did you mean 'flight'? Known are demonstration, flight, "),
        ("nosuch", "there is no mission 'nosuch'; known are demonstration, flight, "),
    ],
)
@pytest.mark.parametrize("words", [("check",), ("export", "-o", "out.plan")])
def test_a_mission_that_does_not_come_with_jezero_is_named_with_those_that_do(
    words: tuple[str, ...], name: str, sentence: str
) -> None:
    done = CliRunner().invoke(main, ["mission", *words, name, *NOBODY])
    assert done.exit_code == 1
    assert done.stderr.startswith(sentence) and done.stderr.endswith(", or the path of a file\n")


def test_a_file_of_a_mission_that_is_missing_is_named() -> None:
    done = CliRunner().invoke(main, ["mission", "check", "flgiht.yaml", *NOBODY])
    assert done.stderr == "flgiht.yaml can't be read: No such file or directory\n"


UP, AHEAD = "{takeoff: {altitude_m: 3}}", "{go_to: {target_ned_m: [9, 0, -3]}}"


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (
            f"{UP}, land_on_spot, {{go_to: {{target_ned_m: [9, 0, -3]}}}}",
            "the vehicle stands on the ground after step 2",
        ),
        (f"{UP}, {{repeat: {{times: 9, steps: [{{wait: 120}}]}}}}", "the mission would end in this step"),
    ],
)
def test_a_step_that_would_fail_is_named_and_the_command_fails(tmp_path: Path, steps: str, words: str) -> None:
    done = check(tmp_path, f"steps: [{steps}]")
    assert done.exit_code == 1
    assert f"WRONG: {words}" in done.stdout
    assert "1 of the steps would fail" in done.stderr


def test_a_wind_takes_its_charge_and_a_wrong_one_is_named(tmp_path: Path) -> None:
    text = "steps: [{takeoff: {altitude_m: 5}}, {go_to: {target_ned_m: [200, 0, -5]}}]"
    used = [
        json.loads(check(tmp_path, text, "--json", *wind).stdout)["steps"][1]["charge_used"]
        for wind in ((), ("--wind", "6", "0"))
    ]
    assert used[1] > 1.1 * used[0]
    assert check(tmp_path, text, "--wind", "nan", "0").exit_code == 2


def progress(**fields: Any) -> MissionProgress:
    return MissionProgress(t_ns=0, mission_id="m", name="survey", step=5, steps=5, label="land", **fields)


class Flown:
    """A vehicle whose mission has these progresses, the last one is its end."""

    def __init__(self, *progresses: MissionProgress) -> None:
        self._progresses = progresses

    @property
    def mission(self) -> "Flown":
        return self

    def watch(self) -> Iterator[MissionProgress]:
        yield from self._progresses


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
    assert progress_in_words(end) == words
    vehicle: Any = Flown(end)
    if code == 0:
        _follow(Printer(False), vehicle, "m")
        return
    with pytest.raises(SystemExit) as ended:
        _follow(Printer(False), vehicle, "m")
    assert ended.value.code == code


@pytest.mark.parametrize("state", ["interrupted", "paused"])
def test_a_mission_that_waits_says_so_and_how_to_end_the_command(
    state: MissionState, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicle: Any = Flown(progress(state=state), progress(state="running"), progress(state="succeeded"))
    _follow(Printer(False), vehicle, "m")
    assert capsys.readouterr().out.count("this command waits until the mission goes on") == 1
