"""The password of the ground station: only its scrypt hash is kept, in a file that nobody but its owner can read."""

import base64
import binascii
import hashlib
import hmac
import os
import secrets
import stat
from pathlib import Path

from jezero.os_errors import naming
from jezero.runtime.config import ConfigError

COST, BLOCK_SIZE, PARALLELISM = 2**15, 8, 1
"""Parameters of scrypt, with which each guess takes 32 MiB and about 0.1 s. Source: RFC 7914; OWASP's sheet on storing
passwords."""
MEMORY_MAX_BYTES = 2**26
SALT_BYTES = 16
LENGTH_MIN, LENGTH_MAX = 8, 200
OTHERS = stat.S_IRWXG | stat.S_IRWXO
SET_IT = "`jezero ground --set-password` sets it"


def default_password_file() -> Path:
    """This user's file: `~/.config/jezero/ground_station.password`."""
    base = os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")
    return Path(base) / "jezero" / "ground_station.password"


def hash_of(password: str) -> str:
    """A new hash of a password, with its salt and the parameters of scrypt.

    Raises:
        ValueError: the password is too short or too long.
    """
    if not LENGTH_MIN <= len(password) <= LENGTH_MAX:
        raise ValueError(f"the password has {len(password)} characters: choose {LENGTH_MIN} to {LENGTH_MAX}")
    salt = secrets.token_bytes(SALT_BYTES)
    hashed = _scrypt(password, salt, COST, BLOCK_SIZE, PARALLELISM)
    encoded = (base64.b64encode(part).decode() for part in (salt, hashed))
    return " ".join(("scrypt", str(COST), str(BLOCK_SIZE), str(PARALLELISM), *encoded))


def matches(password: str, hashed: str) -> bool:
    """Whether a password is the one of a hash. It takes about 0.1 s.

    Raises:
        ValueError: the hash is damaged.
    """
    try:
        kind, cost, block_size, parallelism, salt, expected = hashed.split()
        if kind != "scrypt":
            raise ValueError(kind)
        given = _scrypt(password[:LENGTH_MAX], base64.b64decode(salt), int(cost), int(block_size), int(parallelism))
        return hmac.compare_digest(given, base64.b64decode(expected))
    except (ValueError, binascii.Error):
        raise ValueError(f"the file of the password is damaged: {SET_IT} anew") from None


def _scrypt(password: str, salt: bytes, cost: int, block_size: int, parallelism: int) -> bytes:
    return hashlib.scrypt(
        password.encode(), salt=salt, n=cost, r=block_size, p=parallelism, maxmem=MEMORY_MAX_BYTES, dklen=32
    )


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
    try:
        if path.stat().st_mode & OTHERS:
            raise ConfigError(f"{path} can be read by other users: `chmod 600 {path}`")
        hashed = path.read_text(encoding="ascii").strip()
    except UnicodeDecodeError:
        hashed = ""
    try:
        matches("", hashed)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    return hashed
