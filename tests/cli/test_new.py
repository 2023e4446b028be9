"""`jezero new action` refuses names that the stack has already."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from jezero.cli.main import main


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("recorder", "action 'recorder' has the name of a service"),
        ("actions", "action 'actions' has the name of a service"),
        ("takeoff", "action 'takeoff' is one of jezero's own"),
        ("Spiral", "action 'Spiral': use lower-case letters"),
    ],
)
def test_a_name_that_can_not_be_used_is_refused_and_nothing_is_written(
    name: str, sentence: str, tmp_path: Path
) -> None:
    outcome = CliRunner().invoke(main, ["new", "action", name, "--into", str(tmp_path)])
    assert outcome.exit_code == 2
    assert sentence in " ".join(outcome.output.split())
    assert not list(tmp_path.iterdir())
