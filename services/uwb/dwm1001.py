"""The shell of Decawave's DWM1001: ranges by its commands `lec` and `les`.

Source: DWM1001 firmware API guide. `lec` sends lines such as
`DIST,2,AN0,022E,7.94,8.03,0.00,3.44,AN1,1A2B,0.00,8.03,0.00,5.01,POS,6.95,5.37,-1.97,52`, with each anchor's place
and range; `les` such as `022E[7.94,8.03,0.00]=3.38 le_us=3082 est[6.97,5.17,-1.77,53]`. Two carriage returns within one
second wake the shell, whose prompt is `dwm> `. Each command starts its lines, and stops them when it is sent again.
"""

import re

from jezero.base.lines import Lines

WAKE, START, PROMPT = b"\r\r", b"lec\r", b"dwm> "
QUIET_NS = 2_000_000_000
"""The shell is woken when no ranges have come for this time."""
AFTER_PROMPT_NS = 500_000_000
"""A command that still runs resumes in this time after the prompt; sending it again would stop it."""

_NUMBER = rb"-?\d{1,4}\.\d\d"
_PLACE = _NUMBER + rb"," + _NUMBER + rb"," + _NUMBER
_ID = rb"([0-9A-Fa-f]{4})"
_RANGE = rb"(\d{1,3}\.\d\d)"
"""Both decimals: a range that has lost its last digit on the line is no range."""
_LEC_ANCHOR = re.compile(rb",AN\d{1,2}," + _ID + rb"," + _PLACE + rb"," + _RANGE)
_LEC = re.compile(rb"DIST,(\d{1,2})((?:,AN\d{1,2}(?:,[^,]+){5})+?)(?:,POS(?:,[^,]+){4})?")
_LES_ANCHOR = re.compile(_ID + rb"\[" + _PLACE + rb"\]=" + _RANGE + rb" ?")
_LES = re.compile(rb"((?:" + _LES_ANCHOR.pattern + rb")+)(?:le_us=\d+ ?)?(?:est\[[^\]]*\])?")


class Dwm1001:
    """Reads the shell's lines, and starts them.

    Attributes:
        bad: number of lines that were damaged, since the first good one.
    """

    def __init__(self) -> None:
        self.bad = 0
        self._lines = Lines()
        self._heard = self._running = self._prompted = False
        self._quiet_since_ns: int | None = None
        self._prompted_ns: int | None = None

    def receive(self, data: bytes) -> list[dict[str, float]]:
        """Rounds that are complete with these bytes, oldest first."""
        before = self._lines.too_long
        rounds: list[dict[str, float]] = []
        bad = 0
        for line in self._lines.receive(data):
            if (found := _round_of(line)) is not None:
                rounds.append(found)
            elif not _is_harmless(line):
                bad += 1
        if rounds:
            self._running = self._heard = True
        if self._running:  # before, lines are those of the shell's greeting
            self.bad += bad + self._lines.too_long - before
        self._prompted = self._lines.rest.endswith(PROMPT)
        return rounds

    def due(self, wall_ns: int) -> bytes:
        """Bytes that wake the shell, or start its lines."""
        if self._heard or self._quiet_since_ns is None:
            self._heard, self._quiet_since_ns, self._prompted_ns = False, wall_ns, None
        elif self._prompted and self._prompted_ns is None:
            self._prompted_ns = wall_ns
        elif self._prompted and self._prompted_ns is not None and wall_ns - self._prompted_ns >= AFTER_PROMPT_NS:
            self._quiet_since_ns, self._prompted_ns = wall_ns, None
            self._lines.rest = b""  # the prompt is answered
            self._prompted = False
            return START
        elif wall_ns - self._quiet_since_ns >= QUIET_NS:
            self._quiet_since_ns, self._prompted_ns = wall_ns, None
            return WAKE
        return b""


def _is_harmless(line: bytes) -> bool:
    """Whether a line is a prompt, the echo of a command, or a position without ranges."""
    text = line.removeprefix(PROMPT.strip()).strip()
    return text in (b"", b"lec", b"les", b"lep") or text.startswith(b"POS,")


def _round_of(line: bytes) -> dict[str, float] | None:
    """Ranges of a line; None for another line, or a damaged one."""
    line = line.removeprefix(PROMPT.strip()).strip()
    if (csv := _LEC.fullmatch(line)) is not None:
        found = _LEC_ANCHOR.findall(csv[2])
        whole = b"".join(each.group() for each in _LEC_ANCHOR.finditer(csv[2])) == csv[2]
        if not whole or len(found) != int(csv[1]):
            return None
    elif (shown := _LES.fullmatch(line)) is not None:
        found = _LES_ANCHOR.findall(shown[1])
    else:
        return None
    return {module.decode().upper(): float(range_m) for module, range_m in found}
