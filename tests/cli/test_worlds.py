"""`--world`: which world a command takes, and what it says about one that it can't."""

import os

import pytest
from click.testing import CliRunner, Result

from jezero.cli.main import main


@pytest.fixture(autouse=True)
def own_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command sets the variable for the processes that it starts; a test must not keep it."""
    monkeypatch.setenv("JEZERO_WORLD", "")


def invoke(*words: str) -> Result:
    return CliRunner().invoke(main, words)


@pytest.mark.parametrize("command", [("up",), ("demo", "--fast"), ("fly", "--fast"), ("bench", "landing")])
def test_a_world_that_does_not_exist_is_refused_with_the_nearest_name(command: tuple[str, ...]) -> None:
    result = invoke(*command, "--world", "mras")
    assert result.exit_code == 2
    assert "there is no world 'mras'; did you mean 'mars'? Known are harbour, mars, playground" in result.output


def test_a_running_stack_has_a_world_already() -> None:
    result = invoke("fly", "--world", "mars")
    assert result.exit_code == 2
    assert "--world needs --fast: a running stack has its world from `jezero up --world`" in result.output


def test_px4_does_not_start_on_mars(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_AUTOPILOT", "px4")
    result = invoke("up", "--world", "mars")
    assert result.exit_code == 1
    assert "PX4 assumes the Earth's gravity of 9.81 m/s², and here it is 3.71 m/s²" in result.output
    assert os.environ["JEZERO_WORLD"] == "mars"


def test_a_world_of_the_environment_is_checked_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_WORLD", "mras")
    result = invoke("fly", "--fast")
    assert result.exit_code == 1
    assert "there is no world 'mras'" in result.output
