"""Files that jezero writes: for this user alone, whole or not at all, and what the operating system refuses."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EDQUOT, EFBIG, EMFILE, ENOSPC, EROFS
from pathlib import Path

NOT_UTF8 = "is no text in UTF-8: save it as UTF-8"
"""What is wrong with a file that a person has written, after its path."""
HINTS = {
    EDQUOT: "make room on the disk, or choose another folder",
    EFBIG: "`ulimit -f` limits the size of files",
    EMFILE: "`ulimit -n` limits the number of open files",
    ENOSPC: "make room on the disk, or choose another folder",
    EROFS: "choose another folder",
}


def keep_private() -> None:
    """Let this process and its children make folders of mode 0700 and files of 0600 from now on.

    Recordings, images and logs show where somebody has flown. A folder that exists keeps its mode. On
    Windows this has no effect.
    """
    os.umask(0o077)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file that has its old content or the new one whenever this process is killed, or the disk is full.

    Raises:
        OSError: it can't be written; the old content is still there.
    """
    new = path.with_name(f"{path.name}.new")
    with naming(path):
        new.write_bytes(data)
        new.replace(path)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Add the file to an error of the block: the operating system names it when it opens a file, not when it writes."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            error.filename = str(path)
        raise


def describe_os_error(error: OSError) -> str:
    """The file, what is wrong with it, and what helps, as far as they are known."""
    where = "" if error.filename is None else f"{error.filename}: "
    hint = HINTS.get(error.errno or 0)
    return f"{where}{error.strerror or error}{f' ({hint})' if hint else ''}"
