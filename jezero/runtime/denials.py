"""Reads what the router has denied, and to whom, from Zenoh's log, the only place where Zenoh reports it.

Zenoh writes each decision of its access control at its finest level, and a handshake that failed as a warning. A thread
reads them from a pipe in the place of the standard output, and keeps what was denied.

Source: the messages of zenoh 1.10.2, `zenoh/src/net/routing/interceptor/access_control.rs`.
"""

import fcntl
import os
import re
import sys
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

import zenoh

from jezero.keys.members import HOST_ROLES
from jezero.plain_text import plain

LEVELS = "off,zenoh::net::routing::interceptor::access_control=trace,zenoh_link_tls::unicast=warn"
PIPE_BYTES = 1 << 20
"""Room for the lines of `READ_PERIOD_S` at 20,000 messages a second: Zenoh waits for a reader of a full pipe."""
READ_PERIOD_S = 0.05
NAMED_FOR_S = 60.0
"""Time for which health names a denial, and after which one that goes on is logged again."""
DENIALS_MAX = 20
"""Number of denials of one member that are kept, and of its lines in the log within `NAMED_FOR_S`. It may try any key,
and must not hide by that what others try."""
SHOWN_MAX = 3
"""Number of newest denials of one member in health."""
UNKNOWN, CONNECTIONS = "unknown", "connections"
"""Stand for a member whose name is unknown, and for connections that ended before the member was known."""
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
    b"certificate expired": "its certificate has expired",
    b"not valid yet": "its certificate is not valid yet, or this computer's clock is behind",
    b"UnknownIssuer": "its certificate is another team's",
    b"BadSignature": "its certificate is another team's",
    b"UnknownCA": "its bundle is another team's, or it has none",
    b"DecryptError": "its bundle is another team's",
    b"NoCertificatesPresented": "it shows no certificate",
    b"InvalidContentType": "it speaks no TLS",
    b"sent no certificates": "it shows no certificate",
    b"does not allow extended key usage": "its certificate is not that of a member who connects to routers",
    b"CaUsedAsEndEntity": "it shows the certificate of an authority in the place of its own",
    b"UnsupportedCriticalExtension": "its certificate is none that `jezero keys` makes",
    b"BadCertificate": "it uses an address that is not in this computer's certificate",
    b"CertificateExpired": "it takes this computer's certificate for expired: renew it, or its clock is wrong",
    b"UnsupportedCertificate": "it takes this computer's certificate for none of a router",
    b"CertificateUnknown": "it doesn't take this computer's certificate",
    b"peer is incompatible": "it has no TLS 1.3",
    b"ProtocolVersion": "it has no TLS 1.3",
    b"handshake eof": "it went away before it showed a certificate",
    b"Connection reset": "it went away before it showed a certificate",
    b"MessageTooLarge": "it speaks no TLS",
    b"InvalidEmptyPayload": "it speaks no TLS",
    b"unexpected": "it speaks no TLS",
    b"Timeout during": "it began TLS, and fell silent",
}
"""Why a handshake failed, by a word of the reason; see https://docs.rs/rustls/latest/rustls/enum.Error.html."""
_DENIED = re.compile(
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
class _Denial:
    logged_s: float
    newest_s: float
    count: int = 0


@dataclass
class _Denied:
    """What was denied to one member."""

    denials: dict[str, _Denial] = field(default_factory=dict)
    logged_s: deque[float] = field(default_factory=deque)
    """Times of the lines in the log within `NAMED_FOR_S`."""

    def add(self, text: str, now_s: float) -> None:
        known = self.denials.get(text)
        if known is None or now_s - known.logged_s > NAMED_FOR_S:
            self._log(f"{text} ({known.count} times since the last line)" if known else text, now_s)
            known = self.denials[text] = _Denial(logged_s=now_s, newest_s=now_s)
        known.count += 1
        known.newest_s = now_s
        if len(self.denials) > DENIALS_MAX:
            del self.denials[min(self.denials, key=lambda each: self.denials[each].newest_s)]

    def _log(self, text: str, now_s: float) -> None:
        while self.logged_s and now_s - self.logged_s[0] > NAMED_FOR_S:
            self.logged_s.popleft()
        if len(self.logged_s) < DENIALS_MAX:
            self.logged_s.append(now_s)
            end = "; more of this within a minute is not logged" if len(self.logged_s) == DENIALS_MAX else ""
            print(f"router: {text}{end}", file=sys.stderr, flush=True)

    def newest(self, now_s: float) -> list[str]:
        """Denials of the last `NAMED_FOR_S`, newest first, `SHOWN_MAX` of them at most."""
        ages_s = {text: now_s - denial.newest_s for text, denial in self.denials.items()}
        new = sorted((text for text, age_s in ages_s.items() if age_s <= NAMED_FOR_S), key=lambda text: ages_s[text])
        return [*new[:SHOWN_MAX], f"and {len(new) - SHOWN_MAX} more"] if len(new) > SHOWN_MAX else new


class Denials:
    """Denials so far, each with the time of the newest and the number of them.

    Args:
        member_of: name of the member by Zenoh's id of its session, or "" for an unknown one.
    """

    def __init__(self, member_of: Callable[[str], str]) -> None:
        self._member_of = member_of
        self._denied: defaultdict[str, _Denied] = defaultdict(_Denied)
        """What was denied, by member, `UNKNOWN` or `CONNECTIONS`."""
        self._in_block: set[bytes] = set()
        """Threads of Zenoh that are in a block of permissions."""
        self._lock = threading.Lock()

    def watch(self) -> None:
        """Take the process' standard output for Zenoh's log, and read it in a thread; to be called once."""
        out, into = os.pipe()
        with suppress(OSError):  # this user has many large pipes already
            fcntl.fcntl(into, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        os.dup2(into, sys.stdout.fileno())
        os.close(into)
        os.environ |= {"RUST_LOG": LEVELS, "NO_COLOR": "1"}  # no escape codes between the words
        zenoh.try_init_log_from_env()  # type: ignore[no-untyped-call]
        threading.Thread(target=self._read, args=(out,), daemon=True).start()

    def _read(self, out: int) -> None:
        rest = b""
        try:
            while chunk := os.read(out, PIPE_BYTES):
                time.sleep(READ_PERIOD_S)  # until a session that has just begun is in Zenoh's list
                lines, _, rest = (rest + chunk).rpartition(b"\n")
                self.add(lines, time.monotonic())
        finally:  # Zenoh must not wait for a pipe that nobody reads
            os.close(out)

    def add(self, lines: bytes, now_s: float) -> None:
        """Add lines of Zenoh's log.

        Args:
            lines: whole lines.
            now_s: monotonic time.
        """
        for line in lines.splitlines():
            match = _DENIED.search(line)
            if match is not None:
                self._add_decision(match, now_s)
            elif handshake := _HANDSHAKE.search(line):
                words = _handshake_words(handshake["reason"])
                self._count(CONNECTIONS, f"a connection was refused: {words}", now_s)

    def _add_decision(self, match: re.Match[bytes], now_s: float) -> None:
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
        elif match["denied"] and match["flow"] == b"ingress":
            self._add_attempt(match, now_s)

    def _add_attempt(self, match: re.Match[bytes], now_s: float) -> None:
        what, session = match["what"].decode(), match["session"].decode()
        name = self._member_of(session) or _common_name(match["subject"] or b"")
        by_itself = what in DECLARED and name.partition("-")[0] in HOST_ROLES
        if what in WORDS and not by_itself:
            own = plain(match["key"].decode(errors="replace"))
            self._count(name or UNKNOWN, f"{name or f'session {session}'} may not {WORDS[what].format(own)}", now_s)

    def _count(self, who: str, text: str, now_s: float) -> None:
        with self._lock:
            self._denied[who].add(text, now_s)

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
    known = (words for mark, words in HANDSHAKES.items() if mark in reason)
    return next(known, plain(reason.decode(errors="replace").partition(". Hint:")[0]))
