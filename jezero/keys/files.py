"""Reads the files of a bundle, which are plain ones of a bounded size."""

import os
import stat
from pathlib import Path

BYTES_MAX = 1_000_000
"""The largest file of a bundle is the list of members, with 0.2 kB for each."""


class KeysError(ValueError):
    """The team's folder, a bundle or a request for one is wrong; the message says what to do."""


def read_plain_file(path: Path) -> bytes:
    """Read a file as a whole. A device, a pipe or a folder would never end, or would hold up whoever opens it.

    Raises:
        KeysError: it is no plain file, or too large.
        OSError: it can't be read.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe without a writer would block
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise KeysError(f"{path} is no plain file: copy it anew from the computer that has the team")
        with open(descriptor, "rb", closefd=False) as file:
            data = file.read(BYTES_MAX + 1)
    finally:
        os.close(descriptor)
    if len(data) > BYTES_MAX:
        raise KeysError(
            f"{path} has more than {BYTES_MAX // 1_000_000} MB, which no file of a bundle has: copy it anew"
        )
    return data
