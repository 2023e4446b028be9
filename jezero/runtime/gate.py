"""The gate: the router between other computers and that of this one, in the process of the latter.

The programs of this computer speak through a router of their own, so that nothing that happens on a link with another
computer holds them up. Zenoh reads certificates and rights when a router opens. So when the files of the bundle change,
by `jezero keys renew` or `revoke`, the gate alone is opened anew: other computers are cut off for about a second, and
who has control keeps it.
"""

from collections.abc import Iterable
from pathlib import Path

import zenoh

from jezero.keys.bundle import files_of
from jezero.keys.diagnosis import bundle_problem
from jezero.keys.members import MEMBERS
from jezero.runtime.config import HostLinks
from jezero.runtime.routing import ListenError, close, open_gate
from jezero.runtime.uplinks import Uplinks

Files = tuple[tuple[Path, int, int] | None, ...]
"""Path, time of change (ns) and size (bytes) of each file; None for one that is missing."""


class Gate:
    """A gate that follows the files of its bundle.

    Args:
        router: Zenoh's endpoint of the router of this computer's own programs.
        vehicle: name of the vehicle within the keys.
        links: links with other computers.

    Raises:
        ListenError: see `open_router`.
    """

    def __init__(self, router: str, vehicle: str, links: HostLinks) -> None:
        self._router, self._vehicle, self._links = router, vehicle, links
        self._endpoints = (*links.listen, *links.connect)
        self._used = self._seen = _files(self._endpoints)
        self._keys_problem = ""
        self._session: zenoh.Session | None = None
        self._uplinks: Uplinks | None = None
        self._open()

    @property
    def session(self) -> zenoh.Session | None:
        """The gate's session; None while it can't be opened."""
        return self._session

    @property
    def problem(self) -> str:
        """What is wrong with the bundle or with a link, in a sentence for each, or ""."""
        missing = "" if self._uplinks is None else self._uplinks.problem
        return "; ".join(filter(None, (self._keys_problem, missing)))

    def update(self) -> bool:
        """Open the gate anew if its bundle has changed and can be used; returns whether it did.

        To be called about once a second: files that change from one call to the next are still being copied.
        """
        before, self._seen = self._seen, _files(self._endpoints)
        if self._session is not None:
            if self._seen == self._used:
                self._keys_problem = ""
                return False
            if self._seen != before:
                return False
            if problem := next(filter(None, map(bundle_problem, self._endpoints)), ""):
                self._keys_problem = f"the changed keys can't be used, the links go on with the old ones: {problem}"
                return False
        self.close()
        self._used = self._seen
        try:
            self._open()
        except ListenError as error:  # the next call tries again
            self._keys_problem = str(error)
            return False
        self._keys_problem = ""
        return True

    def _open(self) -> None:
        self._session = open_gate(self._router, self._vehicle, self._links)
        self._uplinks = Uplinks(self._session, self._links.connect)

    def close(self) -> None:
        """Close the gate."""
        if self._session is not None:
            close(self._session)
        self._session = self._uplinks = None


def _files(endpoints: Iterable[str]) -> Files:
    """The files that the gate reads when it opens, as they are now."""
    found: list[tuple[Path, int, int] | None] = []
    for path in sorted({path for endpoint in endpoints for path in (*files_of(endpoint).values(), *_lists(endpoint))}):
        try:
            state = path.stat()
        except OSError:
            found.append(None)
        else:
            found.append((path, state.st_mtime_ns, state.st_size))
    return tuple(found)


def _lists(endpoint: str) -> set[Path]:
    """The lists of members beside the files of an endpoint."""
    return {path.parent / MEMBERS for path in files_of(endpoint).values()}
