"""The password of the ground station: only its Argon2 hash is kept, in a file that nobody but its owner can read."""

import os
import stat
from pathlib import Path

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError, VerifyMismatchError

from jezero.os_errors import naming
from jezero.runtime.config import ConfigError

HASHER = PasswordHasher(time_cost=2, memory_cost=19 * 1024, parallelism=1)
"""Argon2id, with which each guess takes 19 MiB and about 0.05 s of one processor: the others are left to the vehicle.
Source: OWASP's sheet on storing passwords."""
LENGTH_MIN, LENGTH_MAX = 8, 200
OTHERS = stat.S_IRWXG | stat.S_IRWXO
SET_IT = "`jezero ground --set-password` sets it"


def default_password_file() -> Path:
    """This user's file: `~/.config/jezero/ground_station.password`."""
    base = os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")
    return Path(base) / "jezero" / "ground_station.password"


def hash_of(password: str) -> str:
    """A new hash of a password, with its salt and the parameters of Argon2.

    Raises:
        ValueError: the password is too short or too long.
    """
    if not LENGTH_MIN <= len(password) <= LENGTH_MAX:
        raise ValueError(f"the password has {len(password)} characters: choose {LENGTH_MIN} to {LENGTH_MAX}")
    return HASHER.hash(password)


def matches(password: str, hashed: str) -> bool:
    """Whether a password is the one of a hash.

    Raises:
        VerificationError: the hash is damaged.
        InvalidHashError: it is no hash of Argon2.
    """
    try:
        return HASHER.verify(hashed, password)
    except VerifyMismatchError:
        return False


def write_password(path: Path, password: str) -> None:
    """Write the hash of a password into a file that only this user can read.

    Raises:
        ValueError: the password is too short or too long.
        OSError: the file can't be written.
    """
    hashed = hash_of(password)
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(f"{path.name}.new")
    with naming(path):
        new.unlink(missing_ok=True)
        with open(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(f"{hashed}\n")
        new.replace(path)


def read_password(path: Path) -> str:
    """The hash in a file.

    Raises:
        ConfigError: others can read the file too, or its content is no hash.
        OSError: it can't be read.
    """
    if path.stat().st_mode & OTHERS:
        raise ConfigError(f"{path} can be read by other users: `chmod 600 {path}`")
    try:
        hashed = path.read_text(encoding="ascii").strip()
        matches("", hashed)
    except (UnicodeDecodeError, InvalidHashError, VerificationError):
        raise ConfigError(f"{path} holds no Argon2 hash: {SET_IT} anew") from None
    return hashed
