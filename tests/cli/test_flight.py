"""The commands that fly, as far as they come without a vehicle."""

import json

import pytest
from click.testing import CliRunner

from jezero.cli.flight import wind_text
from jezero.cli.main import main
from jezero.cli.sections import COMMANDS

NOBODY = ["--router", "tcp/127.0.0.1:9"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("target 1 2", "Missing argument 'Z'"),
        ("target a 0 -3", "'a' is not a valid float"),
        ("target nan 0 -3", "not a finite number"),
        ("target 0 0 -inf", "not a finite number"),
        ("target 0 0 -3 moon", "'moon' is not one of"),
        ("target 0 0 -3 --sped 3", "--sped"),
        ("takeoff nan", "not a finite number"),
        ("hover 1 2", "all three"),
        ("takeoff --override nonsense", "'nonsense' is no check that can be overridden; these are: services, clock,"),
        ("target 0 0 -3 world true --override rover", "'rover' is no check that can be overridden"),
        ("land_on_spot false", "--spot X Y Z"),
        ("kill", "--yes"),
        ("rover drive 3", "not within ±2"),
        ("rover drive 0.5 nan", "not a finite number"),
        ("rover drive 0.5 --for -1", "is not positive"),
        ("rover follow nowhere.csv", "does not exist"),
        ("fly --seed -1", "--seed"),
        ("statsu", "Did you mean 'status'?"),
        ("rover drve", "Did you mean 'drive'?"),
        ("info topcs", "Did you mean 'topics'?"),
        ("status --router 127.0.0.1:7447", "write PROTOCOL/HOST:PORT, such as tcp/127.0.0.1:7447"),
        ("status --router tcp/127.0.0.1:0", "is no address of a router"),
    ],
)
def test_wrong_usage_says_what_is_wrong_and_exits_with_2(words: str, said: str) -> None:
    result = CliRunner().invoke(main, words.split())
    assert result.exit_code == 2
    assert said in result.output


@pytest.mark.long
@pytest.mark.parametrize("command", ["target 0 0 -4 world true", "takeoff 3", "abort", "status", "hover 0 0 -3"])
def test_without_a_stack_it_says_so_and_exits_with_5(command: str) -> None:
    result = CliRunner().invoke(main, [*command.split(), *NOBODY])
    assert result.exit_code == 5
    assert "no router at tcp/127.0.0.1:9" in result.stderr
    assert result.stdout == ""


def test_with_json_the_last_line_of_standard_output_tells_it_too() -> None:
    result = CliRunner().invoke(main, ["takeoff", "--json", *NOBODY])
    assert result.exit_code == 5
    assert json.loads(result.stdout.splitlines()[-1])["type"] == "unreachable"


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_has_help(command: str) -> None:
    result = CliRunner().invoke(main, [command, "--help"])
    assert result.exit_code == 0
    assert len(result.output.splitlines()) > 4


@pytest.mark.parametrize(
    ("north_mps", "east_mps", "text"),
    [
        (-4.0, 0.0, "from 0 degrees"),
        (-4.0, 0.01, "from 0 degrees"),
        (-4.0, 0.1, "from 359 degrees"),
        (0.0, -4.0, "from 90 degrees"),
        (4.0, 0.0, "from 180 degrees"),
        (4.0, -1e-9, "from 180 degrees"),
    ],
)
def test_the_wind_comes_from_0_to_359_degrees(north_mps: float, east_mps: float, text: str) -> None:
    assert wind_text((north_mps, east_mps, 0.0), None) == f"4.0 m/s {text}"


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["modify"], "Missing argument 'KEY=VALUE"),
        (["modify", "speed_mps"], "'speed_mps' is not KEY=VALUE, such as speed_mps=1.5"),
        (["modify", "=1"], "'=1' is not KEY=VALUE"),
        (["modify", "speed_mps=1", "speed_mps=2"], "speed_mps is given twice"),
    ],
)
def test_wrong_words_of_modify_are_told_in_one_sentence(words: list[str], problem: str) -> None:
    run = CliRunner().invoke(main, words)
    assert run.exit_code == 2
    assert problem in run.output
