"""The gate: the router between other computers and that of this one, `python -m jezero.runtime.gate`.

It listens to other computers at `JEZERO_LISTEN`, connects to their routers at `JEZERO_CONNECT`, and is a client of this
computer's router. It is a process of its own: whatever happens on a link with another computer, or in the log of what
was denied there, the programs of this computer go on speaking through their own router.

Zenoh reads certificates and rights when a router opens. So when the files of the bundle change, by `jezero keys renew`
or `revoke`, the whole process starts anew: other computers are cut off for about a second, and who has control keeps
it.
"""

import os
import socket
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import zenoh

from jezero.base.codec import encode
from jezero.base.config import ConfigError
from jezero.base.router_address import insecurity, parse_router, shown_router
from jezero.base.zenoh_client import FIRST
from jezero.keys.bundle import files_of
from jezero.keys.diagnosis import bundle_problem, connection_problem
from jezero.keys.members import MEMBERS
from jezero.runtime.denials import Denials
from jezero.runtime.instance import HostLinks, Instance, links_from_environment, service_instance
from jezero.runtime.linux_processes import process_in_words
from jezero.runtime.router import Health, Readers, serve
from jezero.runtime.routing import ListenError, open_gate, shown
from jezero.schemas.health import GateLinks
from jezero.schemas.topics import EVERY_LINK, key

NAME = "gate"
BEAT_PERIOD_S = 1.0
LOOK_PERIOD_S = 1.0
DIAGNOSIS_PERIOD_S = 5.0
"""A diagnosis is a TLS handshake of its own, which takes room on the link."""
FILES_PERIOD_S = 0.5
CLOSE_PERIOD_S = 0.05
"""Time in which an excluded member that connects again may send."""
NICENESS = 5
"""A flood that keeps the gate busy must leave the processors to what flies."""
Files = tuple[tuple[Path, int, int], ...]
"""Path, time of change (ns) and size (bytes) of each file that is there."""


class Bundles:
    """Watches the files of the bundles that the gate has read when it opened.

    Args:
        endpoints: Zenoh's endpoints of the gate's links.

    Attributes:
        problem: why changed files can't be used, or "".
    """

    def __init__(self, endpoints: Iterable[str]) -> None:
        self.problem = ""
        self._endpoints = tuple(endpoints)
        self._used = self._seen = _files(self._endpoints)
        self._due_s = 0.0

    def changed(self) -> bool:
        """Whether the files have changed, rest, and can be used; looks every `FILES_PERIOD_S`.

        Files that change from one look to the next are still being copied.
        """
        if time.monotonic() < self._due_s:
            return False
        self._due_s = time.monotonic() + FILES_PERIOD_S
        before, self._seen = self._seen, _files(self._endpoints)
        if self._seen == self._used:
            self.problem = ""
        elif self._seen == before:
            found = next(filter(None, map(bundle_problem, self._endpoints)), "")
            self.problem = (
                f"the changed keys can't be used, the links go on with the old ones: {found}" if found else ""
            )
            return not found
        return False


class Uplinks:
    """Watches whether the gate is connected to each of the others, in a thread, as looking a name up may take long.

    Args:
        session: session of the gate.
        endpoints: Zenoh's endpoints of the other gates.

    Attributes:
        problem: a sentence for each link that is missing, or "".
    """

    def __init__(self, session: zenoh.Session, endpoints: Sequence[str]) -> None:
        self.problem = ""
        self._session = session
        self._reasons = dict.fromkeys(endpoints, "no router replies there")
        self._due_s = 0.0
        if endpoints:
            threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        with suppress(zenoh.ZError):  # the session was closed
            while True:
                linked = {link.dst.partition("/")[2].partition("?")[0] for link in self._session.info.links()}
                missing = [endpoint for endpoint in self._reasons if not linked & _addresses(endpoint)]
                if missing and time.monotonic() >= self._due_s:
                    self._due_s = time.monotonic() + DIAGNOSIS_PERIOD_S
                    self._reasons |= {each: connection_problem(each) or "no router replies there" for each in missing}
                self.problem = "; ".join(f"no link to {shown_router(each)}: {self._reasons[each]}" for each in missing)
                time.sleep(LOOK_PERIOD_S)


class Beat:
    """Publishes which links the gate has, and replies with it: by this the launchers know whether a link passes.

    Args:
        session: session of the gate.
        vehicle: name of the vehicle within the keys.
    """

    def __init__(self, session: zenoh.Session, vehicle: str) -> None:
        self._session = session
        self._gate, self._process = str(session.zid()), process_in_words()
        own = key(vehicle, EVERY_LINK.name.replace("*", self._gate))
        json = zenoh.Encoding.APPLICATION_JSON
        self._publisher = session.declare_publisher(own, encoding=json, priority=FIRST)
        self._due_s = 0.0

        def reply(query: zenoh.Query) -> None:
            with query:
                query.reply(own, self._links(), encoding=json)

        self._queryable = session.declare_queryable(own, zenoh.handlers.Callback(reply, indirect=False), complete=True)

    def update(self) -> None:
        """Publish when that is due."""
        if time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + BEAT_PERIOD_S
            self._publisher.put(self._links())

    def _links(self) -> bytes:
        others = {
            str(link.zid)
            for link in self._session.info.links()
            if not link.dst.startswith("unixsock-stream/") and _is_gate(self._session, link)
        }
        return encode(GateLinks(t_ns=0, gate=self._gate, process=self._process, linked=tuple(sorted(others))))


def _addresses(endpoint: str) -> set[str]:
    """The addresses of an endpoint's host as Zenoh writes them: host:port, an IPv6 host in brackets."""
    _, host, port = parse_router(endpoint)
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except OSError:  # no such name, or nobody to ask
        return set()
    return {f"[{address[0]}]:{port}" if ":" in str(address[0]) else f"{address[0]}:{port}" for *_, address in found}


def _is_gate(session: zenoh.Session, link: zenoh.Link) -> bool:
    """Whether another computer's gate, no client, is at the other end of a link."""
    return str(link.zid) in {str(router) for router in session.info.routers_zid()}


def _files(endpoints: Iterable[str]) -> Files:
    """The files that the gate reads when it opens, as they are now."""
    paths = {path for endpoint in endpoints for path in files_of(endpoint).values()}
    found: list[tuple[Path, int, int]] = []
    for path in sorted(paths | {path.parent / MEMBERS for path in paths}):
        with suppress(OSError):
            state = path.stat()
            found.append((path, state.st_mtime_ns, state.st_size))
    return tuple(found)


def run(instance: Instance, links: HostLinks) -> None:
    """Route between this computer and others until SIGTERM or SIGINT; start the process anew when its keys change.

    Raises:
        ListenError: see `open_gate`.
    """
    os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    endpoints = (*links.listen, *links.connect)
    bundles = Bundles(endpoints)  # before the router reads them
    denials = Denials()
    denials.take_log()
    session = open_gate(instance.router, instance.vehicle, links)
    readers = Readers(NAME, session)
    denials.name_by(readers.member_of)
    uplinks, beat = Uplinks(session, links.connect), Beat(session, instance.vehicle)
    warnings = "".join(f"; {warning}" for each in endpoints if (warning := insecurity(each)))
    where = f"listening on {shown(links.listen)}" if links.listen else f"linked to {shown(links.connect)}"

    def update() -> None:
        if bundles.changed():
            text = f"{NAME}: the keys have changed: the links with other computers begin anew"
            print(text, file=sys.stderr, flush=True)
            os.execv(sys.executable, sys.orig_argv)
        readers.update()
        readers.close(denials.excluded(time.monotonic()))
        beat.update()

    def health() -> Health:
        problem = "; ".join(filter(None, (bundles.problem, uplinks.problem)))
        text = (
            problem or f"{where}{warnings}, {max(readers.sessions - 1, 0)} sessions{readers.members}"
        )  # but for the own router
        return "degraded" if problem else "ok", f"{text}{readers.text}{denials.text(time.monotonic())}"

    serve(NAME, session, instance.vehicle, update, health, period_s=CLOSE_PERIOD_S)


def main() -> int:
    """Run the gate of the instance in the environment."""
    try:
        links = links_from_environment()
        if not any(links):
            raise ConfigError("JEZERO_LISTEN and JEZERO_CONNECT are empty: a gate needs one of them")
        run(service_instance(), links)
    except (ConfigError, ListenError) as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return os.EX_CONFIG if isinstance(error, ConfigError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
