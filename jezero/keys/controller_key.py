"""The key of the MAVLink signatures between a vehicle's computer and its flight controller."""

import hashlib
import os
import shlex
from pathlib import Path

from jezero.base.config import ConfigError
from jezero.base.files import describe_os_error
from jezero.keys.bundle import OTHERS_READ_OR_WRITE
from jezero.keys.files import read_plain_file
from jezero.keys.members import KeysError

CONTROLLER_KEY_VARIABLE = "JEZERO_MAVLINK_KEY_FILE"
"""Environment variable that names the file with the key. No setting has the key itself, as settings are recorded."""
REMEDY = f"sign it ({CONTROLLER_KEY_VARIABLE}), "
"""What makes a link to the controller over a network safe, for errors."""
TEXT_LENGTH_MIN = 16
"""Characters of a text that nobody guesses."""


def controller_key() -> bytes:
    """The key, 32 bytes; b"" where the variable isn't set, and nothing is signed.

    It is the SHA-256 of the file's one line of text, as in MAVProxy.

    Raises:
        ConfigError: the file can't be read, can be read by others, or has no such text.
    """
    name = os.environ.get(CONTROLLER_KEY_VARIABLE)
    if not name:
        return b""
    path = Path(name).expanduser()
    try:
        text = read_plain_file(path).strip()
        mode = path.stat().st_mode
    except KeysError as error:
        raise ConfigError(f"{CONTROLLER_KEY_VARIABLE}: {error}") from None
    except OSError as error:
        raise ConfigError(f"{CONTROLLER_KEY_VARIABLE}: {describe_os_error(error)}") from None
    if mode & OTHERS_READ_OR_WRITE:
        raise ConfigError(
            f"{CONTROLLER_KEY_VARIABLE}: other users can read or change {path}, and could fly the vehicle: type "
            f"`chmod go= {shlex.quote(str(path))}`"
        )
    if len(text) < TEXT_LENGTH_MIN or not text.isascii() or b"\n" in text:
        raise ConfigError(
            f"{CONTROLLER_KEY_VARIABLE}: {path} has to be one line of {TEXT_LENGTH_MIN} or more letters and digits: "
            f"make it with `(umask 077; openssl rand -hex 16 > {shlex.quote(str(path))})`"
        )
    return hashlib.sha256(text).digest()
