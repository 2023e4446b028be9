"""Vehicle time without a simulator: the flight controller's time since its boot, by MAVLink's TIMESYNC.

The bridge asks ten times a second. A reply holds the controller's time at some moment between the bridge's request and
the reply's arrival, so a short round trip says most. A line through the replies with short round trips gives the
controller's time at any moment, and how much faster its clock is than this computer's.
"""

import os
import sys
from collections import deque
from collections.abc import Callable
from math import sqrt
from pathlib import Path

import msgspec

from jezero.schemas.state import Clock
from jezero.schemas.units import NS_PER_S

PERIOD_NS = 100_000_000
WINDOW_NS = 10 * NS_PER_S
"""Replies of this time make the line."""
OUTSTANDING_MAX = 20
"""Requests whose replies may still come."""
ROUND_TRIP_MAX_NS = 500_000_000
"""A later reply says nothing."""
KNOWN_AFTER = 5
"""Number of replies from which on the controller's time counts as known. For a bridge that is started anew in flight
one is enough, as a second without setpoints is the controller's failsafe."""
NOISE_NS = 500_000
"""What the times of two replies may differ by, beside their round trips: both programs take turns."""
STD_DRIFT = 0.02
"""Standard deviation of a drift about which nothing is known yet. A controller in a slow simulation loses up to 4 % of
this computer's time. Source: PX4 in SIH with lockstep."""
JUMP_MIN_NS = 20_000_000
JUMPED_AFTER = 3
"""A jump of the controller's clock is believed after as many replies in a row that contradict the line."""
REBOOT_STEP_NS = NS_PER_S
"""The controller was booted anew when its time steps back by more than this."""
DRIFT_MAX = 0.05


class Offset(msgspec.Struct, frozen=True):
    """How the controller's clock relates to this computer's.

    Attributes:
        offset_ns: the controller's time minus this computer's, at `wall_ns`.
        wall_ns: this computer's monotonic time.
        rate: seconds of the controller in a second of this computer.
        spread_ns: standard deviation of the replies from the line.
        round_trip_ns: shortest round trip in the window.
    """

    offset_ns: int
    wall_ns: int
    rate: float
    spread_ns: float
    round_trip_ns: int

    def controller_ns(self, wall_ns: int) -> int:
        """The controller's time at a time of this computer."""
        return wall_ns + self.offset_ns + int((self.rate - 1.0) * (wall_ns - self.wall_ns))

    @property
    def text(self) -> str:
        """The offset's quality, for people."""
        drift_ppm = 1e6 * (self.rate - 1.0)
        return (
            f"its clock is known within {max(self.spread_ns, 1e4) * 1e-6:.2f} ms, drift {drift_ppm:+.0f} ppm, "
            f"round trip {self.round_trip_ns * 1e-6:.1f} ms"
        )


class _Reply(msgspec.Struct, frozen=True):
    """`controller_ns` is the controller's time in the middle of the round trip, `wall_ns` this computer's."""

    wall_ns: int
    controller_ns: int
    round_trip_ns: int


class TimeSync:
    """Estimates the controller's time from requests and replies.

    Args:
        known_after: number of replies from which on its time counts as known.

    Attributes:
        offset: the estimate; None until it is known.
        boots: number of times that the controller was booted anew since the first reply.
        jumps: number of times that its clock has jumped.
    """

    def __init__(self, known_after: int = KNOWN_AFTER) -> None:
        self._known_after = known_after
        self.offset: Offset | None = None
        self.boots = 0
        self.jumps = 0
        self._replies: deque[_Reply] = deque()
        self._contradicting: list[_Reply] = []
        """The last replies in a row that contradict the line, all on one side of it."""
        self._outstanding: deque[int] = deque(maxlen=OUTSTANDING_MAX)
        self._asked_ns: int | None = None
        self._newest: _Reply | None = None

    def due(self, wall_ns: int) -> bool:
        """Whether to send a request now, with `wall_ns` as its time stamp."""
        if self._asked_ns is not None and wall_ns - self._asked_ns < PERIOD_NS:
            return False
        self._asked_ns = wall_ns
        self._outstanding.append(wall_ns)
        return True

    def on_reply(self, controller_ns: int, asked_ns: int, wall_ns: int) -> None:
        """Take in a reply.

        Args:
            controller_ns: the controller's time since its boot, `tc1`.
            asked_ns: the time stamp of the request, `ts1`; a reply to another program is ignored.
            wall_ns: this computer's monotonic time when the reply arrived.
        """
        if asked_ns not in self._outstanding:
            return
        self._outstanding.remove(asked_ns)
        round_trip_ns = wall_ns - asked_ns
        if not 0 <= round_trip_ns <= ROUND_TRIP_MAX_NS or controller_ns < 0:
            return
        reply = _Reply(asked_ns + round_trip_ns // 2, controller_ns, round_trip_ns)
        last, self._newest = self._newest, reply
        if last is not None and reply.wall_ns >= last.wall_ns and last.controller_ns - controller_ns > REBOOT_STEP_NS:
            self.boots += 1
            self._restart([reply])
        elif self.offset is not None and self._contradicts(reply, self.offset):
            self._on_contradiction(reply, self.offset)
        else:
            self._contradicting.clear()
            self._replies.append(reply)
            self._fit()

    def _contradicts(self, reply: _Reply, offset: Offset) -> bool:
        """Whether the difference from the line is more than the round trip can explain."""
        difference_ns = reply.controller_ns - offset.controller_ns(reply.wall_ns)
        return abs(difference_ns) > JUMP_MIN_NS + (reply.round_trip_ns + offset.round_trip_ns) // 2

    def _on_contradiction(self, reply: _Reply, offset: Offset) -> None:
        def is_ahead(each: _Reply) -> bool:
            return each.controller_ns > offset.controller_ns(each.wall_ns)

        if self._contradicting and is_ahead(self._contradicting[-1]) is not is_ahead(reply):
            self._contradicting.clear()
        self._contradicting.append(reply)
        if len(self._contradicting) >= JUMPED_AFTER:
            self.jumps += 1
            self._restart(self._contradicting)

    def _restart(self, replies: list[_Reply]) -> None:
        """Begin anew; until the new line is known, the newest reply alone gives the time."""
        self._replies = deque(replies)
        self._contradicting = []
        newest = replies[-1]
        self.offset = Offset(newest.controller_ns - newest.wall_ns, newest.wall_ns, 1.0, 0.0, newest.round_trip_ns)
        self._fit()

    def _fit(self) -> None:
        """Least squares with weights: a round trip says little about what lies within it."""
        replies = self._replies
        while replies[-1].wall_ns - replies[0].wall_ns > WINDOW_NS:
            replies.popleft()
        if len(replies) < self._known_after:
            return
        shortest_ns = min(reply.round_trip_ns for reply in replies)
        # Times from here on are relative to the newest reply, in ns as float: exact enough over ten seconds.
        at_ns, base_ns = replies[-1].wall_ns, replies[-1].controller_ns - replies[-1].wall_ns
        weights = [1.0 / (reply.round_trip_ns - shortest_ns + NOISE_NS) ** 2 for reply in replies]
        times = [float(reply.wall_ns - at_ns) for reply in replies]
        offsets = [float(reply.controller_ns - reply.wall_ns - base_ns) for reply in replies]
        total = sum(weights)
        time = sum(w * t for w, t in zip(weights, times, strict=True)) / total
        offset = sum(w * o for w, o in zip(weights, offsets, strict=True)) / total
        variance = sum(w * (t - time) ** 2 for w, t in zip(weights, times, strict=True))
        moved = (w * (t - time) * (o - offset) for w, t, o in zip(weights, times, offsets, strict=True))
        slope = sum(moved) / (variance + STD_DRIFT**-2)
        squares = (w * (o - offset - slope * (t - time)) ** 2 for w, t, o in zip(weights, times, offsets, strict=True))
        offset_ns = base_ns + int(offset - slope * time)
        self.offset = Offset(offset_ns, at_ns, 1.0 + slope, sqrt(sum(squares) / total), shortest_ns)


class ControllerClock:
    """Makes `clock` of the controller's time, and the epoch of its boots.

    Args:
        boot_id: differs between two runs of the bridge; the first epoch's id, where none was kept.
        kept: the epoch of the bridge before; None without one.
        keep: gets the epoch at its begin and every ten seconds.

    Attributes:
        sync: the estimate of the controller's time.
    """

    def __init__(self, boot_id: int, kept: "KeptEpoch | None", keep: Callable[["KeptEpoch"], None]) -> None:
        self.sync = TimeSync(KNOWN_AFTER if kept is None else 1)
        self._kept = kept
        self._keep = keep
        self._first_id = boot_id
        self._epoch: tuple[int, int] | None = None
        """Number of the controller's boots at the begin of the epoch, and the epoch's id."""
        self._published_ns = self._kept_ns = -WINDOW_NS

    def due(self, host_ns: int) -> Clock | None:
        """The message that is due now; None where none is, or the controller's time isn't known.

        Args:
            host_ns: this computer's monotonic time.
        """
        offset = self.sync.offset
        if offset is None or host_ns - self._published_ns < PERIOD_NS:
            return None
        self._published_ns = host_ns
        t_ns = max(0, offset.controller_ns(host_ns))
        if self._epoch is None or self._epoch[0] != self.sync.boots:
            self._epoch = (self.sync.boots, self._next_id(t_ns, host_ns))
            self._kept_ns = -WINDOW_NS
        if host_ns - self._kept_ns >= KEEP_PERIOD_NS:
            self._kept_ns = host_ns
            self._keep(KeptEpoch(self._epoch[1], t_ns, host_ns))
        return Clock(t_ns=t_ns, epoch_id=self._epoch[1], wall_ns=host_ns)

    def _next_id(self, t_ns: int, host_ns: int) -> int:
        if self._epoch is not None:
            return self._epoch[1] + 1
        if self._kept is None:
            return self._first_id
        same = self._kept.is_same_boot(t_ns, host_ns)
        return self._kept.epoch_id if same else self._kept.epoch_id + 1


# -- the epoch -------------------------------------------------------------------------------------------

NAME = "epoch.json"
"""The file in the run folder; the controller may run on while the stack is started anew."""
KEEP_PERIOD_NS = 10 * NS_PER_S
SAME_WITHIN_NS = NS_PER_S


class KeptEpoch(msgspec.Struct, frozen=True):
    """The epoch of a bridge, in a file: one that is started anew knows whether the controller ran on meanwhile.

    Attributes:
        epoch_id: id of the epoch.
        controller_ns: the controller's time when this was written.
        wall_ns: this computer's monotonic time then.
    """

    epoch_id: int
    controller_ns: int
    wall_ns: int

    def is_same_boot(self, controller_ns: int, wall_ns: int) -> bool:
        """Whether the controller has run since this was written, by its time now."""
        passed_ns = wall_ns - self.wall_ns
        difference_ns = controller_ns - self.controller_ns - passed_ns
        return passed_ns >= 0 and abs(difference_ns) <= SAME_WITHIN_NS + DRIFT_MAX * passed_ns


def kept_epoch_path() -> Path | None:
    """The file below `JEZERO_RUN_DIR`; None without a run folder."""
    run_dir = os.environ.get("JEZERO_RUN_DIR")
    return Path(run_dir).absolute() / NAME if run_dir else None


def load_epoch(path: Path) -> KeptEpoch | None:
    """The epoch of the bridge before; None when there was none, or it can't be read."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=KeptEpoch)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError) as error:
        print(f"the epoch in {path} can't be read and is left out: {error}", file=sys.stderr)
        return None


def save_epoch(path: Path, epoch: KeptEpoch) -> None:
    """Write the epoch into its file; without it a bridge that is started anew in flight begins a new epoch."""
    new = path.with_suffix(".new")
    try:
        new.write_bytes(msgspec.json.encode(epoch))
        new.replace(path)
    except OSError as error:
        print(f"the epoch can't be kept over a restart of the bridge: {error}", file=sys.stderr)
