"""Reads what the gate has denied, and to whom, from Zenoh's log, the only place where Zenoh reports it.

Zenoh writes each decision of its access control at its finest level, and a handshake that failed as a warning. They go
into a file in memory in the place of the standard output. A thread takes them from there and keeps what was denied.
Writing to such a file never waits, as it would for a pipe that is full: a member that floods the gate can cost lines of
the log, and never holds up a message.

The same lines say how much each member sends. One that sends far more than people and their programs do is excluded for
some time.

Source: the messages of zenoh 1.10.2, `zenoh/src/net/routing/interceptor/access_control.rs`.
"""

import fcntl
import os
import re
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

import zenoh

from jezero.base.plain_text import plain
from jezero.keys.members import HOST_ROLES

LEVELS = "off,zenoh::net::routing::interceptor::access_control=trace,zenoh_link_tls::unicast=warn"
READ_PERIOD_S = 0.05
READ_MAX_BYTES = 200_000
"""Bytes of the log that are read in one period, some thousand lines; the rest is lost."""
LOG_MAX_BYTES = 4_000_000
"""Size from which the file is emptied."""
KEY_MAX = 100
"""Characters of a key in the log and in health."""
NAMED_FOR_S = 60.0
"""Time for which health names a denial, and in which it is not logged again."""
DENIALS_MAX = 20
"""Number of denials of one member that are kept and logged. It may try any key, and must not fill the log with that."""
NAMES_MAX = 1000
SHOWN_MAX = 3
"""Number of newest denials of one member in health."""
MESSAGES_MAX_HZ, MESSAGES_BURST = 300.0, 1500.0
"""Requests, messages and declarations that one member may send, and how many at once: a computer declares some hundred
when its link begins."""
EXCLUDED_FOR_S = 10.0
"""Time for which a member that sends more is excluded, since its last message."""
UNKNOWN, CONNECTIONS, EXCLUDED = "unknown", "connections", "excluded"
"""Stand for a member whose name is unknown, for connections that ended before the member was known, and for members
that are excluded, whose denials must not hide that."""
WORDS = {
    "Put": "publish on {}",
    "Delete": "delete {}",
    "Query": "send a request to {}",
    "Reply": "reply on {}",
    "Declare Queryable": "take requests on {}",
    "Liveliness Token": "register as {}",
}
DECLARED = frozenset({"Declare Queryable", "Liveliness Token"})
"""What the router of a computer does by itself for the programs behind it: no attempt of anybody."""
HANDSHAKES = {
    rb"certificate expired": "its certificate has expired",
    rb"not valid yet": "its certificate is not valid yet, or this computer's clock is behind",
    rb"UnknownIssuer|BadSignature": "its certificate is another team's",
    rb"UnknownCA": "its bundle is another team's, or it has none",
    rb"DecryptError": "its bundle is another team's",
    rb"NoCertificatesPresented|sent no certificates": "it shows no certificate",
    rb"does not allow extended key usage": "its certificate is not that of a member who connects to routers",
    rb"CaUsedAsEndEntity": "it shows the certificate of an authority in the place of its own",
    rb"UnsupportedCriticalExtension": "its certificate is none that `jezero keys` makes",
    rb"BadCertificate": "it uses an address that is not in this computer's certificate",
    rb"CertificateExpired": "it takes this computer's certificate for expired: renew it, or its clock is wrong",
    rb"UnsupportedCertificate": "it takes this computer's certificate for none of a router",
    rb"CertificateUnknown": "it doesn't take this computer's certificate",
    rb"peer is incompatible|ProtocolVersion": "it has no TLS 1.3",
    rb"handshake eof|Connection reset": "it went away before it showed a certificate",
    rb"InvalidContentType|MessageTooLarge|InvalidEmptyPayload|unexpected": "it speaks no TLS",
    rb"Timeout during": "it began TLS, and fell silent",
}
"""Why a handshake failed, by words of the reason; see https://docs.rs/rustls/latest/rustls/enum.Error.html."""
_DECISION = re.compile(
    rb"ThreadId\((?P<thread>\d+)\) \S+access_control: (?:"
    rb"(?P<block>ACL \(\w+\): caching)|"
    rb"(?P<cached>Using cached result: )?(?P<session>[0-9a-f]+)(?: on (?P<subject>\S+))? is "
    rb"(?P<denied>un)?authorized to (?P<what>[A-Z][A-Za-z/ ]+) \((?P<flow>\w+)\) on (?P<key>.+)|"
    rb"(?P<stranger>[0-9a-f]+) did not match any configured ACL subject)"
)
_HANDSHAKE = re.compile(rb"WARN .*zenoh_link_tls::unicast: (?P<reason>.+)")
_BLOCK_END = b"Declare Liveliness Subscriber"
"""The last message of a block of permissions. Zenoh works those out in advance for a key: they are no attempts."""


@dataclass
class _Denied:
    """What was denied to one member."""

    newest_s: dict[str, float] = field(default_factory=dict)
    """Time of the newest denial of each kind within `NAMED_FOR_S`, in the order of these times."""

    def add(self, text: str, now_s: float) -> None:
        """Add a denial, and log the first of its kind, unless there are `DENIALS_MAX` kinds already."""
        self._forget(now_s)
        if text not in self.newest_s and len(self.newest_s) < DENIALS_MAX:
            print(f"gate: {text}", file=sys.stderr, flush=True)
        self.newest_s.pop(text, None)
        self.newest_s[text] = now_s
        if len(self.newest_s) > DENIALS_MAX:
            del self.newest_s[next(iter(self.newest_s))]

    def newest(self, now_s: float) -> list[str]:
        """The newest denials, newest first, `SHOWN_MAX` of them at most."""
        self._forget(now_s)
        new = list(reversed(self.newest_s))
        return [*new[:SHOWN_MAX], f"and {len(new) - SHOWN_MAX} more"] if len(new) > SHOWN_MAX else new

    def _forget(self, now_s: float) -> None:
        self.newest_s = {text: at_s for text, at_s in self.newest_s.items() if now_s - at_s <= NAMED_FOR_S}


@dataclass
class _Allowance:
    """How many messages a member may send now, a bucket that fills at `MESSAGES_MAX_HZ`."""

    left: float = MESSAGES_BURST
    updated_s: float = 0.0
    excluded_until_s: float = 0.0

    def take(self, count: int, now_s: float) -> bool:
        """Take some messages; returns whether the member is excluded for them from now on."""
        self.left = min(MESSAGES_BURST, self.left + MESSAGES_MAX_HZ * (now_s - self.updated_s)) - count
        self.updated_s = now_s
        was_excluded = now_s < self.excluded_until_s
        if self.left < 0.0 or was_excluded:
            self.left = MESSAGES_BURST
            self.excluded_until_s = now_s + EXCLUDED_FOR_S
        return now_s < self.excluded_until_s and not was_excluded


class Denials:
    """Denials so far, each with the time of the newest and the number of them, and the members that are excluded."""

    def __init__(self) -> None:
        self._member_of: Callable[[str], str] = lambda session: ""
        self._names: dict[str, str] = {}
        """Name of the member by Zenoh's id of its session, of the newest `NAMES_MAX` sessions."""
        self._denied: defaultdict[str, _Denied] = defaultdict(_Denied)
        """What was denied, by member, `UNKNOWN`, `CONNECTIONS` or `EXCLUDED`."""
        self._allowances: defaultdict[str, _Allowance] = defaultdict(_Allowance)
        """The allowance of each member, with its name as key."""
        self._in_block: set[bytes] = set()
        """Threads of Zenoh that are in a block of permissions."""
        self._lock = threading.Lock()

    def take_log(self) -> None:
        """Let Zenoh write its log into memory, in the place of the process' standard output; before Zenoh opens."""
        log = os.memfd_create("zenoh.log")
        fcntl.fcntl(log, fcntl.F_SETFL, os.O_APPEND)
        os.dup2(log, sys.stdout.fileno())
        os.environ |= {"RUST_LOG": LEVELS, "NO_COLOR": "1"}  # no escape codes between the words
        zenoh.try_init_log_from_env()  # type: ignore[no-untyped-call]
        threading.Thread(target=self._read, args=(log,), daemon=True).start()

    def name_by(self, member_of: Callable[[str], str]) -> None:
        """Set the function that returns the name of the member by Zenoh's id of its session, "" for an unknown one."""
        self._member_of = member_of

    def _read(self, log: int) -> None:
        at = 0
        while True:
            time.sleep(READ_PERIOD_S)  # until a session that has just begun is in Zenoh's list
            size = os.fstat(log).st_size
            at = max(at, size - READ_MAX_BYTES)  # what a flood has written beyond that is lost
            lines, newline, _ = os.pread(log, READ_MAX_BYTES, at).rpartition(b"\n")
            self.add(lines, time.monotonic())
            at += len(lines) + len(newline)
            if size > LOG_MAX_BYTES:
                os.ftruncate(log, 0)
                at = 0

    def add(self, lines: bytes, now_s: float) -> None:
        """Add lines of Zenoh's log.

        Args:
            lines: whole lines.
            now_s: monotonic time.
        """
        sent: Counter[str] = Counter()
        for line in lines.splitlines():
            match = _DECISION.search(line)
            if match is not None:
                sent[self._add_decision(match, now_s)] += 1
            elif handshake := _HANDSHAKE.search(line):
                words = _handshake_words(handshake["reason"])
                self._count(CONNECTIONS, f"a connection was refused: {words}", now_s)
        for name in sent.keys() - {""}:
            with self._lock:
                excluded = self._allowances[name].take(sent[name], now_s)
            if excluded:
                limit = f"{MESSAGES_MAX_HZ:g} requests, messages and declarations a second"
                self._count(EXCLUDED, f"{name} sends more than {limit}: it is excluded for {EXCLUDED_FOR_S:g} s", now_s)

    def _add_decision(self, match: re.Match[bytes], now_s: float) -> str:
        """Add one decision; returns the name of the member whose message it was, "" where no limit holds for it."""
        thread = match["thread"]
        if match["block"]:
            self._in_block.add(thread)
        elif match["stranger"]:
            name = self._member_of(match["stranger"].decode())
            who = name or f"session {match['stranger'].decode()}"
            text = f"{who} is revoked, or not in this computer's list of members, and may do nothing"
            self._count(name or UNKNOWN, text, now_s)
        elif thread in self._in_block and not match["cached"]:
            if match["what"] == _BLOCK_END:
                self._in_block.discard(thread)
        elif match["flow"] == b"ingress":
            name = self._name_of(match)
            if match["denied"]:
                self._add_attempt(match, name, now_s)
            return "" if name.partition("-")[0] == "vehicle" else name
        return ""

    def _name_of(self, match: re.Match[bytes]) -> str:
        """Name of the member whose message it was, or ""; Zenoh names it with the first message on each key only."""
        session = match["session"].decode()
        if session not in self._names and (name := _common_name(match["subject"] or b"") or self._member_of(session)):
            self._names[session] = name
            if len(self._names) > NAMES_MAX:
                del self._names[next(iter(self._names))]
        return self._names.get(session, "")

    def _add_attempt(self, match: re.Match[bytes], name: str, now_s: float) -> None:
        what, session = match["what"].decode(), match["session"].decode()
        by_itself = what in DECLARED and name.partition("-")[0] in HOST_ROLES
        if what in WORDS and not by_itself:
            own = plain(match["key"][:KEY_MAX].decode(errors="replace"))
            self._count(name or UNKNOWN, f"{name or f'session {session}'} may not {WORDS[what].format(own)}", now_s)

    def _count(self, who: str, text: str, now_s: float) -> None:
        with self._lock:
            self._denied[who].add(text, now_s)

    def excluded(self, now_s: float) -> list[str]:
        """Names of the members whose links are to be closed."""
        with self._lock:
            return [name for name, allowance in self._allowances.items() if now_s < allowance.excluded_until_s]

    def text(self, now_s: float) -> str:
        """For health: what was denied in the last `NAMED_FOR_S`, or ""."""
        with self._lock:
            new = [text for denied in self._denied.values() for text in denied.newest(now_s)]
        return f"; denied: {', '.join(new)}" if new else ""


def _common_name(subject: bytes) -> str:
    """The member in the subject of Zenoh's log, or ""."""
    match = re.search(rb"CertCommonName\(([^)]+)\)", subject)
    return match[1].decode(errors="replace") if match else ""


def _handshake_words(reason: bytes) -> str:
    """Why a handshake failed, in words."""
    known = (words for mark, words in HANDSHAKES.items() if re.search(mark, reason))
    return next(known, plain(reason.decode(errors="replace").partition(". Hint:")[0]))
