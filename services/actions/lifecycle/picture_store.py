"""Pictures on disk, for as long as a client may request them.

`__main__.py` makes a store in the run's folder; on the memory bus the server makes one in a temporary folder. Pictures
are in memory only until the disk has stored them, because a busy disk may stand still for longer than a vehicle can be
without setpoints.
"""

import shutil
from collections.abc import Callable
from errno import EAGAIN
from functools import partial
from pathlib import Path
from tempfile import mkdtemp
from weakref import finalize

from jezero.base.codec import BadPayloadError, decode, encode
from jezero.schemas.images import ImageReply

SIZE_MAX_BYTES = 4_000_000_000
UNWRITTEN_MAX_BYTES = 64_000_000
Execute = Callable[[Callable[[], None]], None]
"""Executes functions, now or later, one after the other."""


def execute_now(work: Callable[[], None]) -> None:
    """Execute a function in the caller's thread."""
    work()


class PictureStore:
    """The pictures of goals, one file each; of past goals only the last ones are kept.

    Args:
        folder: emptied at the start, because its pictures are of goals of an earlier run; None: a temporary folder,
            which is deleted with the store.
        size_max_bytes: when all goals together have more, the pictures of the oldest goal are deleted, but never those
            of the newest.
        execute: executes the work that may wait for the disk; in another thread for a caller that must not wait.
        unwritten_max_bytes: limit of the pictures that wait for the disk.
    """

    def __init__(
        self,
        folder: Path | None = None,
        size_max_bytes: int = SIZE_MAX_BYTES,
        execute: Execute = execute_now,
        unwritten_max_bytes: int = UNWRITTEN_MAX_BYTES,
    ) -> None:
        self._folder = Path(mkdtemp(prefix="jezero-")) if folder is None else folder
        self._size_max_bytes = size_max_bytes
        self._unwritten_max_bytes = unwritten_max_bytes
        self._execute = execute
        self._sizes: dict[str, int] = {}
        """Size of the pictures of each goal, oldest goal first."""
        self._unwritten: dict[Path, bytes] = {}
        """Pictures of the newest goal that are not on disk yet."""
        self._failure: OSError | None = None
        """The newest error of the newest goal."""
        shutil.rmtree(self._folder, ignore_errors=True)
        if folder is None:
            finalize(self, shutil.rmtree, self._folder, ignore_errors=True)

    def keep(self, picture: ImageReply) -> None:
        """Write a picture of a goal.

        Raises:
            OSError: this picture or an earlier one can't be written, because the disk is full or too slow, for example.
        """
        if picture.goal_id not in self._sizes:
            self._unwritten.clear()
            self._failure = None
        path, data = self._path(picture.goal_id, picture.index), encode(picture)
        if sum(map(len, list(self._unwritten.values()))) + len(data) > self._unwritten_max_bytes:
            raise OSError(EAGAIN, "the disk doesn't keep up")
        self._unwritten[path] = data
        self._execute(partial(self._write, path, data))
        self._sizes[picture.goal_id] = self._sizes.get(picture.goal_id, 0) + len(data)
        while sum(self._sizes.values()) > self._size_max_bytes and len(self._sizes) > 1:
            oldest = next(iter(self._sizes))
            del self._sizes[oldest]
            self._execute(partial(shutil.rmtree, self._path(oldest, 0).parent, ignore_errors=True))
        if self._failure is not None:
            raise self._failure

    def _write(self, path: Path, data: bytes) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        except OSError as error:
            if path in self._unwritten:  # an error of an earlier goal must not fail the present one
                self._failure = error
        else:
            self._unwritten.pop(path, None)

    def get(self, goal_id: str, index: int) -> ImageReply:
        """A picture, or the reason why it isn't there."""
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
