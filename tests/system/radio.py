"""Computers with networks of their own, as network namespaces, and radio links between them: slow, late and lossy.

A link is a TUN device in each of two namespaces; a thread of the test carries packets from one to the other. So TCP
meets what it meets on a radio, whatever the kernel has modules for.

Source: ip-netns(8), setns(2), https://docs.kernel.org/networking/tuntap.html.
"""

import contextlib
import ctypes
import fcntl
import heapq
import os
import random
import select
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Self

TUN = Path("/dev/net/tun")
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
CLONE_NEWNET = 0x40000000
PACKET_MAX = 2048
QUEUE_MAX_S = 0.3
"""A packet that would wait longer for the radio is dropped."""


class Radio(NamedTuple):
    """Qualities of a link; both directions share its rate.

    Attributes:
        rate_bps: bits a second.
        delay_s: time that each packet takes besides.
        loss: share of the packets that are lost.
    """

    rate_bps: float = 1e6
    delay_s: float = 0.05
    loss: float = 0.05


CABLE = Radio(rate_bps=1e9, delay_s=0.0, loss=0.0)


@dataclass
class _Link:
    radio: Radio
    ends: tuple[int, int]
    """File descriptors of the two TUN devices."""
    is_cut: bool = False
    free_s: float = 0.0
    """Monotonic time at which the radio has sent all that waits."""
    carried_bytes: int = 0


def missing() -> str:
    """Why this machine can't have such networks, or ""."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if not TUN.exists():
        return f"there is no {TUN}"
    try:
        subprocess.run(["ip", "netns", "list"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return "there is no ip(8) with network namespaces"
    return ""


@dataclass
class Network:
    """Computers and the links between them, for a `with` block, which removes them.

    Args:
        computers: their names.
    """

    computers: tuple[str, ...]
    _links: list[tuple[frozenset[str], _Link]] = field(default_factory=list)

    def __enter__(self) -> Self:
        for computer in self.computers:
            _ip("netns", "add", self.namespace(computer))
            _ip("-n", self.namespace(computer), "link", "set", "lo", "up")
        self._stop_read, self._stop_write = os.pipe()
        self._random = random.Random(1)
        self._thread = threading.Thread(target=self._carry, daemon=True)
        return self

    def __exit__(self, *_: object) -> None:
        os.write(self._stop_write, b"x")
        if self._thread.ident is not None:
            self._thread.join()
        for _pair, link in self._links:
            for end in link.ends:
                os.close(end)
        os.close(self._stop_read)
        os.close(self._stop_write)
        for computer in self.computers:
            subprocess.run(["ip", "netns", "del", self.namespace(computer)], check=False)

    def namespace(self, computer: str) -> str:
        return f"jezero-{os.getpid()}-{computer}"

    def words(self, computer: str) -> list[str]:
        """Words before a command that runs it on a computer."""
        return ["ip", "netns", "exec", self.namespace(computer)]

    def add_link(self, one: str, other: str, radio: Radio) -> tuple[str, str]:
        """Link two computers, before `start`; returns the IP address of each on it."""
        number = len(self._links)
        addresses = f"10.77.{number}.1", f"10.77.{number}.2"
        ends = []
        for computer, address in zip((one, other), addresses, strict=True):
            device = f"radio{number}"
            ends.append(_open_tun(self.namespace(computer), device))
            _ip("-n", self.namespace(computer), "addr", "add", f"{address}/30", "dev", device)
            _ip("-n", self.namespace(computer), "link", "set", device, "up")
        self._links.append((frozenset((one, other)), _Link(radio, (ends[0], ends[1]))))
        return addresses

    def start(self) -> None:
        """Start to carry packets."""
        self._thread.start()

    @contextlib.contextmanager
    def cut(self, one: str, other: str) -> Iterator[None]:
        """Let the radio between two computers carry nothing in the `with` block."""
        link = self._radio(one, other)
        link.is_cut = True
        try:
            yield
        finally:
            link.is_cut = False

    def carried_bytes(self, one: str, other: str) -> int:
        """Bytes that a radio has carried so far, in both directions, with the headers of IP and TCP."""
        return self._radio(one, other).carried_bytes

    def _radio(self, one: str, other: str) -> _Link:
        return next(link for pair, link in self._links if pair == {one, other} and link.radio is not CABLE)

    def _carry(self) -> None:
        ends = {end: (link, link.ends[1 - i]) for _, link in self._links for i, end in enumerate(link.ends)}
        waiting: list[tuple[float, int, int, bytes]] = []
        count = 0
        while True:
            timeout_s = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
            readable, _, _ = select.select([self._stop_read, *ends], [], [], timeout_s)
            if self._stop_read in readable:
                return
            for end in readable:
                link, other = ends[end]
                packet = os.read(end, PACKET_MAX)
                if (due_s := self._due_s(link, len(packet))) is not None:
                    count += 1
                    heapq.heappush(waiting, (due_s, count, other, packet))
            while waiting and waiting[0][0] <= time.monotonic():
                _, _, other, packet = heapq.heappop(waiting)
                with contextlib.suppress(OSError):  # the device is gone with its namespace
                    os.write(other, packet)

    def _due_s(self, link: _Link, size: int) -> float | None:
        """Monotonic time at which a packet arrives; None if it is lost."""
        now_s = time.monotonic()
        begin_s = max(now_s, link.free_s)
        if link.is_cut or begin_s - now_s > QUEUE_MAX_S or self._random.random() < link.radio.loss:
            return None
        link.free_s = begin_s + 8 * size / link.radio.rate_bps
        link.carried_bytes += size
        return link.free_s + link.radio.delay_s


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


def _open_tun(namespace: str, device: str) -> int:
    """Make a TUN device in a namespace; returns its file descriptor, which works in every namespace."""
    opened: list[int] = []

    def make() -> None:  # setns(2) moves one thread only
        with open(f"/run/netns/{namespace}", "rb") as file:
            if ctypes.CDLL(None, use_errno=True).setns(file.fileno(), CLONE_NEWNET) != 0:
                return
        tun = os.open(TUN, os.O_RDWR | os.O_CLOEXEC)
        fcntl.ioctl(tun, TUNSETIFF, struct.pack("16sH", device.encode(), IFF_TUN | IFF_NO_PI))
        opened.append(tun)

    thread = threading.Thread(target=make)
    thread.start()
    thread.join()
    if not opened:
        raise OSError(f"no TUN device in {namespace}")
    return opened[0]
