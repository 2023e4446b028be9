"""Processes that fly side by side, each in its own virtual time."""

import multiprocessing
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.pool import Pool
from types import FrameType


@contextmanager
def workers(jobs: int) -> Iterator[Pool]:
    """So many processes; they and their temporary files go when the block is left, by Ctrl-C and SIGTERM too."""
    before = signal.signal(signal.SIGTERM, _leave)
    try:
        with (
            tempfile.TemporaryDirectory(prefix="jezero-", ignore_cleanup_errors=True) as folder,
            multiprocessing.get_context("spawn").Pool(jobs, _begin, (folder,)) as pool,
        ):
            yield pool
    finally:
        signal.signal(signal.SIGTERM, before)


def _leave(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


def _begin(folder: str) -> None:
    """In each process: its temporary files are put where they are taken away; Ctrl-C is for the parent to hear."""
    tempfile.tempdir = folder
    signal.signal(signal.SIGINT, signal.SIG_IGN)
