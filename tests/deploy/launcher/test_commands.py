"""The command line's table."""

import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

from jezero.cli.main import main
from jezero.cli.sections import COMMANDS


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_there_and_helps(name: str) -> None:
    result = CliRunner().invoke(main, [name, "--help"])
    assert result.exit_code == 0, result.output
    assert result.output.startswith(f"Usage: main {name}")


def test_help_names_every_command_without_importing_one() -> None:
    code = (
        "import sys; from click.testing import CliRunner; from jezero.cli.main import main;"
        "print(CliRunner().invoke(main, ['--help']).output);"
        "print('LOADED', [m for m in ('msgspec', 'zenoh', 'yaml', 'numpy', 'rich') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for name in COMMANDS:
        assert f"  {name} " in done.stdout
    assert "LOADED []" in done.stdout


def test_a_wrong_command_is_a_usage_error() -> None:
    result = CliRunner().invoke(main, ["tkeoff"])
    assert result.exit_code == click.UsageError.exit_code == 2
