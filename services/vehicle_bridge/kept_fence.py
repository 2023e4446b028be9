"""The fence that was set by a request, in a file: a bridge that the launcher restarts holds it too."""

import os
import sys
from pathlib import Path

import msgspec

from jezero.schemas.fence import Fence, SetFence

NAME = "fence.json"
"""The file in the run folder; a stack that starts removes the one of the stack before."""


def kept_fence_path() -> Path | None:
    """The file below `JEZERO_RUN_DIR`; None without a run folder."""
    run_dir = os.environ.get("JEZERO_RUN_DIR")
    return Path(run_dir).absolute() / NAME if run_dir else None


def load(path: Path) -> SetFence | None:
    """The last request in force; None when there was none in this stack, or it can't be read."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=SetFence)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError) as error:
        print(f"the fence in {path} can't be read and is left out: {error}", file=sys.stderr)
        return None


def save(path: Path, fence: Fence | None) -> None:
    """Write the fence into its file; one that can't be written holds until the bridge ends."""
    new = path.with_suffix(".new")
    try:
        new.write_bytes(msgspec.json.encode(SetFence(fence=fence)))
        new.replace(path)
    except OSError as error:
        print(f"the fence can't be kept over a restart of the bridge: {error}", file=sys.stderr)
