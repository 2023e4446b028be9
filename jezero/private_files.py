"""Files that only this user can read. Recordings, images and logs show where somebody has flown."""

import os


def keep_private() -> None:
    """Let this process and its children make folders of mode 0700 and files of 0600 from now on.

    A folder that exists keeps its mode. On Windows this has no effect.
    """
    os.umask(0o077)
