"""Which seeds are flown: those of a commit, and for how long."""

import os
import re
import subprocess
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

WHOLE_HASH = re.compile(r"[0-9a-f]{40}")
FIRST_MAX = 100_000_000


class NoCheckoutError(Exception):
    """A folder in which git, if there is one, knows no commits; says why."""


def commit_hash(revision: str, folder: Path) -> str:
    """The hash of a commit; nothing else of the history is needed.

    Args:
        revision: a whole hash, for which no checkout is needed, or what git understands in the folder, e.g. HEAD.

    Raises:
        NoCheckoutError: there is no git, or the folder is in no checkout.
        ValueError: the checkout has no such commit.
    """
    if WHOLE_HASH.fullmatch(revision):
        return revision
    try:
        inside = _git(folder, "rev-parse", "--git-dir")
    except FileNotFoundError:
        raise NoCheckoutError("git is not installed") from None
    if inside.returncode != 0:
        raise NoCheckoutError(inside.stderr.strip().partition("\n")[0])
    found = _git(folder, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}")
    if found.returncode != 0:
        raise ValueError(f"{folder} has no commit {revision}")
    return found.stdout.strip()


def _git(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        ("git", *words), cwd=folder, env=os.environ | {"LC_ALL": "C"}, capture_output=True, text=True, check=False
    )


def first_seed(commit: str) -> int:
    """Where the seeds of a commit begin: each commit flies others, and the same ones when it is tried again."""
    return int(commit[:12], 16) % FIRST_MAX


def in_time(seeds: Iterable[int], minutes: float) -> Iterator[int]:
    """The seeds up to the one that is begun last before the time is over; at least one."""
    end_s = time.monotonic() + 60.0 * minutes
    for seed in seeds:
        yield seed
        if time.monotonic() >= end_s:
            return
