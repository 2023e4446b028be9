"""The time stamp of MAVLink signatures in a file: after a restart no message from before it is accepted."""

import os
import sys
from pathlib import Path

from jezero.base.files import describe_os_error, write_whole

NAME = "mavlink_stamp"
"""The file in the run folder. It outlasts the stack."""
FUTURE_MAX_S = 60
"""Time by which an accepted message's time stamp may be ahead of the clock; the same as `mavlink.Signing.WINDOW`."""


def kept_stamp_path() -> Path | None:
    """The file below `JEZERO_RUN_DIR`; None without a run folder."""
    run_dir = os.environ.get("JEZERO_RUN_DIR")
    return Path(run_dir).absolute() / NAME if run_dir else None


def load(path: Path | None, now_10us: int) -> int:
    """The kept time stamp; -1 when none was ever kept.

    A file that can't be read counts as the latest time stamp that can have been accepted until now.

    Args:
        path: the file; None without a run folder.
        now_10us: present time, in the units of time stamps.
    """
    if path is None:
        return -1
    try:
        return int(path.read_text("ascii"))
    except FileNotFoundError:
        return -1
    except (OSError, ValueError) as error:
        why = describe_os_error(error) if isinstance(error, OSError) else f"{path} is damaged"
        print(f"{why}: no signed message is accepted for about {FUTURE_MAX_S} s", file=sys.stderr, flush=True)
        return now_10us + 100_000 * FUTURE_MAX_S


def save(path: Path | None, stamp_10us: int) -> None:
    """Write the time stamp into its file.

    It doesn't wait for the disk (fsync), which takes some ten milliseconds, in which nobody controls the motors: a loss
    of power may lose what was written in the last seconds. When the file can't be written, the message is accepted all
    the same, because whoever flies needs the link more.
    """
    if path is None:
        return
    try:
        write_whole(path, f"{stamp_10us}\n".encode("ascii"))
    except OSError as error:
        why = describe_os_error(error)
        print(f"{why}: after a restart a captured MAVLink message could be accepted", file=sys.stderr, flush=True)
