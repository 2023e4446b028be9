"""Seeds of a campaign: those of a commit, and those that start before a time limit."""

import os
import re
import subprocess
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

WHOLE_HASH = re.compile(r"[0-9a-f]{40}")
FIRST_MAX = 100_000_000


class NoCheckoutError(Exception):
    """Git is not installed, or the folder is in no checkout; the text is the reason."""


def commit_hash(revision: str, folder: Path) -> str:
    """Hash of a commit, also in a shallow clone.

    Args:
        revision: a full hash, which needs no checkout, or any revision of the folder's checkout, e.g. HEAD.
        folder: folder of the checkout.

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
    """First seed of a commit: other commits fly other seeds, the same commit always the same ones."""
    return int(commit[:12], 16) % FIRST_MAX


def seeds_for_minutes(seeds: Iterable[int], minutes: float) -> Iterator[int]:
    """Yield seeds until the time in minutes is over; at least one."""
    end_s = time.monotonic() + 60.0 * minutes
    for seed in seeds:
        yield seed
        if time.monotonic() >= end_s:
            return
