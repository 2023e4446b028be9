"""Notifications to systemd, for a launcher that it has started: see `jezero install-service`. Source: sd_notify(3)."""

import contextlib
import os
import socket
from collections.abc import MutableMapping

PINGS_PER_TIMEOUT = 2
"""systemd advises two notifications within the time after which it kills the launcher."""


class SystemdNotifier:
    """Tells systemd that the services have started, how the vehicle is, and that the launcher's loop still runs.

    The loop itself sends the notifications, with no thread of their own: a frozen launcher, which supervises nothing,
    sends none.

    Args:
        environment: the launcher's; systemd's variables are taken out of it, as they mean no service.

    Attributes:
        due_s: monotonic time in s of the next notification that the loop runs; None where systemd wants none.
    """

    def __init__(self, environment: MutableMapping[str, str]) -> None:
        address = environment.pop("NOTIFY_SOCKET", "")
        timeout_us = environment.pop("WATCHDOG_USEC", "")
        pid = environment.pop("WATCHDOG_PID", "")
        self.due_s: float | None = None
        self._period_s = 0.0
        self._started = False
        self._status = ""
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if address else None
        if self._socket is not None:
            self._socket.setblocking(False)
            if timeout_us.isdigit() and pid in ("", str(os.getpid())):
                self._period_s = int(timeout_us) * 1e-6 / PINGS_PER_TIMEOUT
                self.due_s = 0.0

    def update(self, now_s: float, status: str, *, started: bool, stopping: bool) -> None:
        """Send what is new or due; called in each turn of the launcher's loop.

        Args:
            now_s: monotonic time.
            status: a sentence for `systemctl status`.
            started: whether every service has been started.
            stopping: whether the services are being stopped.
        """
        if self._socket is None:
            return
        lines = []
        if started and not self._started:
            self._started = True
            lines.append("READY=1")
        if status != self._status:
            self._status = status
            lines.append(f"STATUS={status.splitlines()[0] if status else ''}")
            if stopping:
                lines.append("STOPPING=1")
        if self.due_s is not None and now_s >= self.due_s:
            self.due_s = now_s + self._period_s
            lines.append("WATCHDOG=1")
        if lines:
            with contextlib.suppress(OSError):  # systemd itself is being started anew; the next one is due soon
                self._socket.sendto("\n".join(lines).encode(), self._address)

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
