"""`jezero sim`, as far as it comes without a stack."""

import json

import pytest
from click.testing import CliRunner

from jezero.cli.main import main

NOBODY = ["--router", "tcp/127.0.0.1:9"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("sim place 1", "Missing argument 'EAST'"),
        ("sim place nan 1", "not a finite number"),
        ("sim wind 4", "Missing argument 'FROM'"),
        ("sim speed fast", "'fast' is not a valid float"),
        ("sim fault battery off", "no faults of 'battery'; it has those of: gyro, accel, mag, baro, gps,"),
        ("sim fault gps broken", "'broken' is no kind of fault; these are: off, stuck,"),
        ("sim fault gps", "jezero sim fault gps off"),
        ("sim speed -1", "-1.0 is not in the range 0.1<=x<=20"),
        ("sim speed 0", "0.0 is not in the range 0.1<=x<=20"),
        ("sim step -1", "-1.0 is not in the range 0.004<=x<=60"),
        ("sim scen", "Did you mean 'scene'?"),
    ],
)
def test_wrong_usage_says_what_is_wrong_and_exits_with_2(words: str, said: str) -> None:
    result = CliRunner().invoke(main, words.split())
    assert result.exit_code == 2
    assert said in result.output


def test_without_a_stack_it_says_so_and_exits_with_5() -> None:
    result = CliRunner().invoke(main, ["sim", "pause", "--json", *NOBODY])
    assert result.exit_code == 5
    assert "no router at tcp/127.0.0.1:9" in result.stderr
    assert json.loads(result.stdout)["type"] == "unreachable"
