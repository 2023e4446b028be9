"""The password's file and its hash."""

import stat
from pathlib import Path

import pytest

pytest.importorskip("argon2", reason="the extra jezero[ground] is not installed")

from jezero.runtime.config import ConfigError
from jezero.services.ground_station.password import hash_of, matches, read_password, write_password


def test_a_hash_matches_its_own_password_only() -> None:
    hashed = hash_of("correct horse")
    assert matches("correct horse", hashed)
    assert not matches("correct horsf", hashed)
    assert not matches("", hashed)
    assert "horse" not in hashed
    assert hash_of("correct horse") != hashed  # each has a salt of its own


def test_the_file_can_be_read_by_its_owner_only_also_when_it_replaces_one_that_others_could_read(
    tmp_path: Path,
) -> None:
    file = tmp_path / "folder" / "password"
    file.parent.mkdir()
    file.touch(0o644)
    write_password(file, "correct horse")
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert matches("correct horse", read_password(file))


@pytest.mark.parametrize("password", ["short", "x" * 201])
def test_a_password_of_a_wrong_length_is_refused(tmp_path: Path, password: str) -> None:
    with pytest.raises(ValueError, match="choose 8 to 200"):
        write_password(tmp_path / "password", password)
    assert not list(tmp_path.iterdir())


def test_a_file_that_others_can_read_is_refused_with_the_command_that_helps(tmp_path: Path) -> None:
    file = tmp_path / "password"
    write_password(file, "correct horse")
    file.chmod(0o640)
    with pytest.raises(ConfigError, match="chmod 600"):
        read_password(file)


@pytest.mark.parametrize(
    "content", ["", "correct horse", "scrypt 32768 8 1 AAAA AAAA", "$argon2id$v=19$m=19456,t=2,p=1$AAAA", "\x80"]
)
def test_a_damaged_file_is_refused_and_so_is_another_kind_of_hash(tmp_path: Path, content: str) -> None:
    file = tmp_path / "password"
    file.write_text(content, encoding="latin-1")
    file.chmod(0o600)
    with pytest.raises(ConfigError, match="no Argon2 hash: `jezero ground --set-password`"):
        read_password(file)
