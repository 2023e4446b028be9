"""Worker processes that fly in parallel, each in its own virtual time."""

import multiprocessing
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.pool import Pool
from types import FrameType


@contextmanager
def workers(jobs: int) -> Iterator[Pool]:
    """Pool of `jobs` processes, removed with their temporary files at the block's end, also after Ctrl-C or SIGTERM."""
    previous_handler = signal.signal(signal.SIGTERM, _exit_on_sigterm)
    try:
        with (
            tempfile.TemporaryDirectory(prefix="jezero-", ignore_cleanup_errors=True) as folder,
            multiprocessing.get_context("spawn").Pool(jobs, _initialize, (folder,)) as pool,
        ):
            yield pool
    finally:
        signal.signal(signal.SIGTERM, previous_handler)


def _exit_on_sigterm(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


def _initialize(folder: str) -> None:
    """Put a worker's temporary files into a folder that the parent deletes, and leave Ctrl-C to the parent."""
    tempfile.tempdir = folder
    signal.signal(signal.SIGINT, signal.SIG_IGN)
