"""What the twin prints for the stack that flies it."""

from pathlib import Path

import pytest

from jezero.deploy.twin.twin import flying_command

UP = "jezero up --profile onboard --profile rover --profile ground"


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("JEZERO_WORLD", raising=False)
    monkeypatch.delenv("JEZERO_MAVLINK_KEY_FILE", raising=False)


def test_the_command_that_flies_the_twin_names_its_settings() -> None:
    assert flying_command(Path("/twin/config")) == f"JEZERO_CONFIG_DIR=/twin/config {UP}"
    assert flying_command(Path("/my twin/config")) == f"JEZERO_CONFIG_DIR='/my twin/config' {UP}"


def test_the_stack_that_flies_the_twin_gets_its_world_and_its_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command is typed in another terminal, perhaps in another folder, so it has whole paths."""
    (tmp_path / "dunes.toml").touch()
    (tmp_path / "mavlink.key").touch()
    monkeypatch.setenv("JEZERO_WORLD", "mars")
    assert flying_command(Path("/c")) == f"JEZERO_CONFIG_DIR=/c JEZERO_WORLD=mars {UP}"
    monkeypatch.setenv("JEZERO_WORLD", "dunes.toml")
    monkeypatch.setenv("JEZERO_MAVLINK_KEY_FILE", "mavlink.key")
    files = f"JEZERO_WORLD={tmp_path}/dunes.toml JEZERO_MAVLINK_KEY_FILE={tmp_path}/mavlink.key"
    assert flying_command(Path("/c")) == f"JEZERO_CONFIG_DIR=/c {files} {UP}"
