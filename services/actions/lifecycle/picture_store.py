"""Pictures on disk, for as long as somebody may ask for them.

The shell makes one and hands it to the service that needs it: in a process below the run's folder, in one process and
virtual time in a temporary folder. In memory is only what the disk hasn't taken yet: a busy one may stand still for
longer than a vehicle can be without setpoints.
"""

import shutil
from collections.abc import Callable
from errno import EAGAIN
from functools import partial
from pathlib import Path
from tempfile import mkdtemp
from weakref import finalize

from jezero.codec import BadPayloadError, decode, encode
from jezero.schemas.images import ImageReply

KEPT_BYTES = 4_000_000_000
UNWRITTEN_BYTES = 64_000_000
Do = Callable[[Callable[[], None]], None]
"""Carries out what is given to it, sooner or later, one after the other."""


def at_once(work: Callable[[], None]) -> None:
    """Carry out what is given."""
    work()


class PictureStore:
    """The pictures of goals, one file each; of goals that are over only the last are kept.

    Args:
        folder: emptied at the start, as nobody knows any more what it holds; None: a temporary one, which
            goes with the spool.
        kept_bytes: when all goals together have more, the oldest one's pictures go. The present one's stay.
        do: carries out what may wait for the disk; beside the caller, if he must not.
        unwritten_bytes: so much may wait for the disk.
    """

    def __init__(
        self,
        folder: Path | None = None,
        kept_bytes: int = KEPT_BYTES,
        do: Do = at_once,
        unwritten_bytes: int = UNWRITTEN_BYTES,
    ) -> None:
        self._folder = Path(mkdtemp(prefix="jezero-")) if folder is None else folder
        self._kept_bytes = kept_bytes
        self._unwritten_bytes = unwritten_bytes
        self._do = do
        self._sizes: dict[str, int] = {}
        """By goal, oldest first."""
        self._unwritten: dict[Path, bytes] = {}
        """Of the newest goal, what the disk hasn't taken."""
        self._failure: OSError | None = None
        """The newest, of the newest goal."""
        shutil.rmtree(self._folder, ignore_errors=True)
        if folder is None:
            finalize(self, shutil.rmtree, self._folder, ignore_errors=True)

    def keep(self, picture: ImageReply) -> None:
        """Write a picture of a goal.

        Raises:
            OSError: it, or one before it, can't be written: the disk is full or too slow, the folder is not ours, ...
        """
        if picture.goal_id not in self._sizes:
            self._unwritten.clear()
            self._failure = None
        path, data = self._path(picture.goal_id, picture.index), encode(picture)
        if sum(map(len, list(self._unwritten.values()))) + len(data) > self._unwritten_bytes:
            raise OSError(EAGAIN, "the disk doesn't keep up")
        self._unwritten[path] = data
        self._do(partial(self._write, path, data))
        self._sizes[picture.goal_id] = self._sizes.get(picture.goal_id, 0) + len(data)
        while sum(self._sizes.values()) > self._kept_bytes and len(self._sizes) > 1:
            oldest = next(iter(self._sizes))
            del self._sizes[oldest]
            self._do(partial(shutil.rmtree, self._path(oldest, 0).parent, ignore_errors=True))
        if self._failure is not None:
            raise self._failure

    def _write(self, path: Path, data: bytes) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        except OSError as error:
            if path in self._unwritten:  # else of an earlier goal
                self._failure = error
        else:
            self._unwritten.pop(path, None)

    def get(self, goal_id: str, index: int) -> ImageReply:
        """A picture, or why it isn't there."""
        path = self._path(goal_id, index)
        try:
            data = self._unwritten.get(path)
            picture: ImageReply = decode(ImageReply, path.read_bytes() if data is None else data)
        except FileNotFoundError:
            return _none(goal_id, index, f"there is no picture {index} of goal {goal_id}, or not any more")
        except (OSError, BadPayloadError) as error:
            return _none(goal_id, index, f"picture {index} of goal {goal_id} can't be read: {error}")
        return picture

    def _path(self, goal_id: str, index: int) -> Path:
        return self._folder / f"goal-{goal_id}" / f"{index:05d}.rgb"


def _none(goal_id: str, index: int, reason: str) -> ImageReply:
    return ImageReply(goal_id=goal_id, index=index, reason=reason)
