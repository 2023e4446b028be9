"""What `jezero COMMAND --help` prints."""

import pytest
from click.testing import CliRunner

from jezero.cli.main import main
from jezero.cli.sections import COMMANDS


@pytest.mark.parametrize("name", COMMANDS)
def test_no_sentence_of_a_commands_help_is_cut(name: str) -> None:
    done = CliRunner().invoke(main, [name, "--help"])
    assert done.exit_code == 0
    sentences = done.output.partition("\n\n")[2]  # after the usage, which has dots of its own
    assert not [line for line in sentences.splitlines() if line.endswith("...")]
