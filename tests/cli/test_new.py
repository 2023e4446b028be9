"""`jezero new action` refuses names that the stack or Python has already."""

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
        ("class", "action 'class' is a word of Python's syntax"),
        ("none", "action 'none' is a word of Python's syntax"),
        ("plan", "action 'plan' would have the class Plan, a name that jezero uses"),
        ("msgspec", "action 'msgspec' has the name of a Python module that is installed already"),
        ("jezero", "action 'jezero' has the name of a Python module"),
        ("numpy", "action 'numpy' has the name of a Python module"),
        ("json", "action 'json' has the name of a Python module"),
        ("test", "action 'test' has the name of a Python module"),
    ],
)
def test_a_name_that_can_not_be_used_is_refused_and_nothing_is_written(
    name: str, sentence: str, tmp_path: Path
) -> None:
    outcome = CliRunner().invoke(main, ["new", "action", name, "--into", str(tmp_path)])
    assert outcome.exit_code == 2
    assert sentence in " ".join(outcome.output.split())
    assert not list(tmp_path.iterdir())


def test_an_installed_action_can_be_written_again_and_a_folder_of_its_name_hinders_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = tmp_path / "site"
    (installed / "lawnmower").mkdir(parents=True)
    (installed / "my_spiral.py").touch()
    monkeypatch.syspath_prepend(installed)
    words = ["new", "action", "--into", str(tmp_path)]
    assert CliRunner().invoke(main, [*words, "my_spiral"]).exit_code == 2
    monkeypatch.setattr("jezero.cli.new.plugin_names", lambda: ("my_spiral",))
    for name in ("my_spiral", "lawnmower"):
        assert CliRunner().invoke(main, [*words, name]).exit_code == 0
        assert (tmp_path / name / "src" / f"{name}.py").is_file()
