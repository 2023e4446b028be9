"""Pictures on disk, for as long as somebody may ask for them.

The shell makes one and hands it to the service that needs it: in a process below the run's folder, in one process and
virtual time in a temporary folder. What is written goes to the disk at once and nothing is kept in memory.
"""

import shutil
from pathlib import Path
from tempfile import mkdtemp
from weakref import finalize

from jezero.runtime.codec import BadPayloadError, decode, encode
from jezero.schemas.images import ImageReply

KEPT_BYTES = 4_000_000_000


class Spool:
    """The pictures of goals, one file each; of goals that are over only the last are kept.

    Args:
        folder: emptied at the start, as nobody knows any more what it holds; None: a temporary one, which
            goes with the spool.
        kept_bytes: when all goals together have more, the oldest one's pictures go. The present one's stay.
    """

    def __init__(self, folder: Path | None = None, kept_bytes: int = KEPT_BYTES) -> None:
        self._folder = Path(mkdtemp(prefix="jezero-")) if folder is None else folder
        self._kept_bytes = kept_bytes
        self._sizes: dict[str, int] = {}
        """By goal, oldest first."""
        shutil.rmtree(self._folder, ignore_errors=True)
        if folder is None:
            finalize(self, shutil.rmtree, self._folder, ignore_errors=True)

    def keep(self, picture: ImageReply) -> None:
        """Write a picture of a goal.

        Raises:
            OSError: it can't be written: the disk is full, the folder is not ours, ...
        """
        path = self._path(picture.goal_id, picture.index)
        path.parent.mkdir(parents=True, exist_ok=True)
        data = encode(picture)
        path.write_bytes(data)
        self._sizes[picture.goal_id] = self._sizes.get(picture.goal_id, 0) + len(data)
        while sum(self._sizes.values()) > self._kept_bytes and len(self._sizes) > 1:
            oldest = next(iter(self._sizes))
            del self._sizes[oldest]
            shutil.rmtree(self._path(oldest, 0).parent, ignore_errors=True)

    def get(self, goal_id: str, index: int) -> ImageReply:
        """A picture, or why it isn't there."""
        try:
            picture: ImageReply = decode(ImageReply, self._path(goal_id, index).read_bytes())
        except FileNotFoundError:
            return _none(goal_id, index, f"there is no picture {index} of goal {goal_id}, or not any more")
        except (OSError, BadPayloadError) as error:
            return _none(goal_id, index, f"picture {index} of goal {goal_id} can't be read: {error}")
        return picture

    def _path(self, goal_id: str, index: int) -> Path:
        return self._folder / f"goal-{goal_id}" / f"{index:05d}.rgb"


def _none(goal_id: str, index: int, reason: str) -> ImageReply:
    return ImageReply(goal_id=goal_id, index=index, reason=reason)
