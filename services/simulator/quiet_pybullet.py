"""PyBullet, imported without the line about its build that it prints on standard error."""

import os
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def _without_standard_error() -> "Iterator[None]":
    """Send to nowhere what the block prints on standard error, by C code too."""
    sys.stderr.flush()
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    os.close(null)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


with _without_standard_error():
    import pybullet

__all__ = ["pybullet"]
