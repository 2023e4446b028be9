"""Hash of all messages of a flight: two flights of the same seed have the same one."""

import hashlib

from jezero.codec import split_attachment


class MessageDigest:
    """SHA-256 of the messages of a bus, of images the header only."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def update(self, t_ns: int, topic: str, data: bytes) -> None:
        """Add one message."""
        self._digest.update(b"%d %s %b\n" % (t_ns, topic.encode(), split_attachment(data)[0]))

    def hexdigest(self) -> str:
        """The hash of the messages so far."""
        return self._digest.hexdigest()
