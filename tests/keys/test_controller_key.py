"""The file with the key of the flight controller's link."""

import hashlib
from pathlib import Path

import pytest

from jezero.base.config import ConfigError
from jezero.keys.controller_key import controller_key

TEXT = "0123456789abcdef0123456789abcdef"


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file with a good text, which the variable names."""
    path = tmp_path / "mavlink.key"
    path.touch(0o600)
    path.write_text(TEXT + "\n")
    monkeypatch.setenv("JEZERO_MAVLINK_KEY_FILE", str(path))
    return path


def test_the_key_is_the_sum_of_the_text(file: Path) -> None:
    assert controller_key() == hashlib.sha256(TEXT.encode()).digest()


def test_without_the_variable_nothing_is_signed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JEZERO_MAVLINK_KEY_FILE", raising=False)
    assert controller_key() == b""


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602])
def test_a_file_that_others_can_read_or_change_is_refused_with_the_command(file: Path, mode: int) -> None:
    file.chmod(mode)
    with pytest.raises(ConfigError, match=r"other users can read or change .*: type `chmod go= "):
        controller_key()


@pytest.mark.parametrize("text", ["", "short\n", f"{TEXT}\n{TEXT}\n", "ä" * 20])
def test_a_text_that_is_no_key_is_refused_with_a_way_to_make_one(file: Path, text: str) -> None:
    file.write_text(text)
    with pytest.raises(ConfigError, match="one line of 16 or more letters and digits: make it with"):
        controller_key()


def test_a_missing_file_and_a_folder_are_named(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_MAVLINK_KEY_FILE", str(file.parent))
    with pytest.raises(ConfigError, match="JEZERO_MAVLINK_KEY_FILE: "):
        controller_key()
    monkeypatch.setenv("JEZERO_MAVLINK_KEY_FILE", str(file.parent / "none"))
    with pytest.raises(ConfigError, match=r"JEZERO_MAVLINK_KEY_FILE: .*none"):
        controller_key()
