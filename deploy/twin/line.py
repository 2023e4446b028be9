"""A serial line with a baud rate, as a pseudo-terminal: its one end is a device file, its other end datagrams.

A pseudo-terminal passes everything at once. This one passes bytes no faster than its baud rate, and drops a datagram
that finds the sender's buffer full, as a flight controller does.
"""

import contextlib
import fcntl
import os
import tty
from collections import deque
from pathlib import Path

BITS_PER_BYTE = 10
"""A serial line sends a start bit and a stop bit with each byte."""
BUFFER_BYTES = 1500
"""The sender's buffer, beside what is on the way."""
SLICE_MAX_S = 0.02
"""A line that was not moved for longer than this has idled meanwhile."""


class Line:
    """The line's end in the hardware.

    Args:
        path: where the device's link is made for the other end; one that is there is replaced.
        baud: bits per second.

    Attributes:
        dropped: number of datagrams that found the buffer full.
    """

    def __init__(self, path: Path, baud: int) -> None:
        self.path = path
        self.dropped = 0
        self._bytes_per_s = baud / BITS_PER_BYTE
        self._master, self._slave = -1, -1
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._moved_s: float | None = None
        self._may_send = self._may_read = 0.0
        """Bytes that may pass now in each direction."""
        self.plug()

    def plug(self) -> None:
        """Put the plug in: the device is there."""
        self._master, self._slave = os.openpty()  # the slave stays open: reading fails while nobody has it open
        tty.setraw(self._slave)
        fcntl.fcntl(self._master, fcntl.F_SETFL, os.O_NONBLOCK)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        """Pull the plug: the device is gone, and what was on the way is lost."""
        self.path.unlink(missing_ok=True)
        for end in (self._master, self._slave):
            with contextlib.suppress(OSError):
                os.close(end)
        self._master = self._slave = -1
        self._waiting.clear()
        self._waiting_bytes = 0

    @property
    def is_plugged(self) -> bool:
        """Whether the device is there."""
        return self._master >= 0

    def put(self, datagram: bytes) -> None:
        """Send a datagram to the other end, or drop it."""
        if not self.is_plugged or self._waiting_bytes + len(datagram) > BUFFER_BYTES:
            self.dropped += 1
            return
        self._waiting.append(datagram)
        self._waiting_bytes += len(datagram)

    def move(self, now_s: float) -> bytes:
        """Pass what the baud rate permits since the last call.

        Args:
            now_s: monotonic time.

        Returns:
            What came from the other end.
        """
        passed_s = 0.0 if self._moved_s is None else min(now_s - self._moved_s, SLICE_MAX_S)
        self._moved_s = now_s
        if not self.is_plugged:
            return b""
        grant = passed_s * self._bytes_per_s
        self._may_send = self._may_send + grant if self._waiting else grant
        self._send()
        self._may_read += grant
        count = int(self._may_read)
        try:
            data = os.read(self._master, count) if count else b""
        except (BlockingIOError, OSError):
            data = b""
        self._may_read = self._may_read - len(data) if len(data) == count else 0.0
        return data

    def _send(self) -> None:
        while self._waiting and self._may_send >= 1.0:
            datagram = self._waiting[0]
            part = datagram[: int(self._may_send)]
            try:
                sent = os.write(self._master, part)
            except BlockingIOError:  # nobody reads: the line itself loses what it carries
                sent = len(part)
            self._may_send -= sent
            self._waiting_bytes -= sent
            if sent == len(datagram):
                self._waiting.popleft()
            else:
                self._waiting[0] = datagram[sent:]

    def close(self) -> None:
        """Remove the device."""
        if self.is_plugged:
            self.unplug()
