"""Claims to services: of two launchers that start at the same instant, only one starts each service."""

import contextlib
import errno
import hashlib
import socket
import struct
from collections.abc import Iterable

from jezero.deploy.launcher.state import AlreadyUpError


class Claims:
    """The services that no other launcher of this machine may start, until this process ends or `close` is called.

    A claim is a Unix socket with an abstract name. Like the ports it belongs to the machine's network, ends with its
    process, and is no file that another user could have put there.
    """

    def __init__(self) -> None:
        self._sockets: list[socket.socket] = []

    def take(self, *owner: str) -> bool:
        """Claim something; False if another launcher has claimed it.

        Args:
            owner: words that name it.
        """
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(_address(owner))
            claim.listen()
        except OSError as error:
            claim.close()
            if error.errno != errno.EADDRINUSE:
                raise
            return False
        self._sockets.append(claim)
        return True

    def take_services(self, services: Iterable[str], vehicle: str, router: str) -> None:
        """Claim services of a vehicle.

        Raises:
            AlreadyUpError: another launcher has claimed one of them.
        """
        for service in sorted(services):  # in one order, so that two launchers can't each get a part and both give up
            if not self.take(router, vehicle, service):
                pid = _holder((router, vehicle, service)) or "of an unknown id"
                raise AlreadyUpError(
                    f"{service} of vehicle {vehicle} belongs to launcher process {pid} already. Stop that with "
                    "`jezero down`, or choose another vehicle with JEZERO_VEHICLE"
                )

    def close(self) -> None:
        """Give all claims up."""
        for claim in self._sockets:
            claim.close()
        self._sockets.clear()


def _address(owner: Iterable[str]) -> str:
    """Abstract address, which has to be shorter than the names may be."""
    return f"\0jezero-{hashlib.sha256(' '.join(owner).encode()).hexdigest()}"


def _holder(owner: Iterable[str]) -> str:
    """Id of the process with a claim, "" if it has just ended. Source: unix(7), SO_PEERCRED."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as probe:
        probe.connect(_address(owner))
        pid, _, _ = struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))
        return str(pid)
    return ""
