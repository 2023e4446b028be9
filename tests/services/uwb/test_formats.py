"""The formats of the UWB modules: good lines and frames, damaged ones, and any bytes whatever."""

import json
import struct
from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jezero.services.uwb.config import Format
from jezero.services.uwb.dwm1001 import PROMPT, START, WAKE, Dwm1001
from jezero.services.uwb.formats import Round, parser_of
from jezero.services.uwb.json_lines import RangeLines
from jezero.services.uwb.nooploop import Nooploop

MS = 1_000_000
ROUND: Round = {"022E": 3.44, "1A2B": 5.01}
LEC = b"DIST,2,AN0,022E,7.94,8.03,0.00,3.44,AN1,1A2B,0.00,-8.03,0.00,5.01,POS,6.95,5.37,-1.97,52\r\n"
LES = b"022E[7.94,8.03,0.00]=3.44 1A2B[0.00,-8.03,0.00]=5.01 le_us=3082 est[6.97,5.17,-1.77,53]\r\n"


def frame(mark: int, ranges_mm: dict[int, int]) -> bytes:
    """A frame of Nooploop, written down from its description: sizes 119 and 13, or 21 and 7."""
    fixed, node = (119, 13) if mark == 4 else (21, 7)
    nodes = b"".join(
        (bytes((1, number)) + struct.pack("<i", mm)[:3]).ljust(node, b"\x55") for number, mm in ranges_mm.items()
    )
    head = struct.pack("<BBH", 0x55, mark, fixed + len(nodes) + 1)
    body = head.ljust(fixed - 1, b"\x07") + bytes((len(ranges_mm),)) + nodes
    return body + bytes((sum(body) % 256,))


GOOD: dict[Format, tuple[bytes, Round]] = {
    "dwm1001": (LEC, ROUND),
    "json": (json.dumps({"ranges_m": ROUND}).encode() + b"\n", ROUND),
    "nooploop": (frame(5, {0: 3440, 7: 5010}), {"0": 3.44, "7": 5.01}),
}
FORMATS: tuple[Format, ...] = ("dwm1001", "json", "nooploop")


@pytest.mark.parametrize("line", [LEC, LES, PROMPT + LEC, b"dwm> " + LES, LEC[: LEC.index(b",POS")] + b"\r\n"])
def test_a_line_of_each_command_of_the_dwm1001_gives_its_ranges_also_behind_a_prompt(line: bytes) -> None:
    assert Dwm1001().receive(line) == [pytest.approx(ROUND)]


@pytest.mark.parametrize(
    "damage",
    [
        lambda line: line.replace(b"3.44", b"3.4"),
        lambda line: line.replace(b"3.44", b"3.4x"),
        lambda line: line.replace(b",AN1", b"AN1"),
        lambda line: line.replace(b"DIST,2", b"DIST,3"),
        lambda line: line.replace(b"022E", b"02E"),
        lambda line: line[:40] + b"\r\n",
        lambda line: line[30:],
        lambda line: line.replace(b"5.01,POS", b"nan,POS"),
    ],
)
def test_a_damaged_line_of_the_dwm1001_gives_no_range_and_is_counted(damage: Callable[[bytes], bytes]) -> None:
    parser = Dwm1001()
    parser.receive(LEC)
    assert parser.receive(damage(LEC)) == []
    assert parser.bad == 1
    assert parser.receive(LEC) == [pytest.approx(ROUND)]


def test_the_greeting_and_the_echo_of_the_dwm1001_are_no_damaged_lines() -> None:
    parser = Dwm1001()
    parser.receive(b"\r\n\r\n DWM1001 TWR Real Time Location System\r\n\r\n Help : ? or help\r\n\r\ndwm> ")
    parser.receive(b"lec\r\n" + LEC)
    parser.receive(b"dwm> lec\r\nPOS,7.10,5.24,-2.03,53\r\n")
    assert parser.bad == 0


def test_a_quiet_dwm1001_is_woken_and_its_ranges_are_started_after_the_prompt() -> None:
    parser = Dwm1001()
    sent: list[tuple[int, bytes]] = []
    for t_ms in range(0, 6000, 100):
        if sent and sent[-1] == (t_ms - 100, WAKE):
            parser.receive(b"\r\ndwm> ")
        elif sent and sent[-1][1] == START:
            parser.receive((b"lec\r\n" if sent[-1][0] == t_ms - 100 else b"") + LEC)
        else:
            parser.receive(b"")
        if data := parser.due(t_ms * MS):
            sent.append((t_ms, data))
    assert [data for _, data in sent] == [WAKE, START]
    assert sent[0][0] == 2000
    assert 2500 <= sent[1][0] <= 2700


def test_a_dwm1001_that_sends_already_is_sent_nothing() -> None:
    parser = Dwm1001()
    sent = b""
    for t_ms in range(0, 6000, 100):
        parser.receive((b"\r\ndwm> " if t_ms == 1000 else b"") + LEC)
        sent += parser.due(t_ms * MS)
    assert sent == b""


def test_a_dwm1001_that_falls_silent_is_woken_again() -> None:
    parser = Dwm1001()
    parser.receive(LEC)
    due = [(t_ms, parser.due(t_ms * MS)) for t_ms in range(0, 5000, 100)]
    assert [(t_ms, data) for t_ms, data in due if data] == [(2000, WAKE), (4000, WAKE)]


@pytest.mark.parametrize("mark", [4, 5])
def test_a_frame_of_nooploop_gives_its_distances_in_metres(mark: int) -> None:
    assert Nooploop().receive(frame(mark, {0: 3440, 12: 0x7FFFFF, 255: 1})) == [
        pytest.approx({"0": 3.44, "12": 8388.607, "255": 0.001})
    ]


def test_a_frame_of_nooploop_with_a_wrong_sum_is_counted_and_one_inside_it_is_found() -> None:
    good = frame(5, {1: 2000})
    damaged = bytearray(frame(4, {1: 1000, 2: 1000, 3: 1000}))
    damaged[30 : 30 + len(good)] = good
    parser = Nooploop()
    assert parser.receive(bytes(damaged)) == [{"1": 2.0}]
    assert parser.bad == 1


def test_a_negative_distance_of_nooploop_is_left_out() -> None:
    assert Nooploop().receive(frame(5, {1: -5, 2: 2000})) == [{"2": 2.0}]


@pytest.mark.parametrize(
    "line",
    [b"[1]", b"{}", b'{"ranges_m": {"A": -1}}', b'{"ranges_m": {"A": null}}', b'{"ranges_m": {"": 1.0}}', b"\xff\xfe",
     b'{"ranges_m": {"A": 1e999}}', b"[" * 4000, b"x" * 9000],
)  # fmt: skip
def test_a_line_that_is_no_object_with_ranges_is_counted(line: bytes) -> None:
    parser = RangeLines()
    assert parser.receive(line + b"\n") == []
    assert parser.bad == 1


def test_a_line_of_json_may_have_other_fields_and_no_ranges() -> None:
    parser = RangeLines()
    assert parser.receive(b'{"battery_v": 3.9, "ranges_m": {"a1": 2}}\n{"ranges_m": {}}\r\n\r\n') == [{"A1": 2.0}]
    assert parser.bad == 0


FRAGMENTS = st.sampled_from([*(data for data, _ in GOOD.values()), LES, PROMPT, b"DIST,", b"\x55\x04", b"\x55\x05\x16"])
NOISE = st.lists(st.binary(max_size=40) | FRAGMENTS | FRAGMENTS.map(lambda f: f[: len(f) // 2]), max_size=4)


@pytest.mark.long
@pytest.mark.parametrize("kind", FORMATS)
@settings(max_examples=10_000 // len(FORMATS), database=None)
@given(noise=NOISE.map(b"".join), cuts=st.lists(st.integers(0, 300), max_size=4))
def test_no_bytes_raise_however_they_are_cut_and_the_next_good_ones_are_read(
    kind: Format, noise: bytes, cuts: list[int]
) -> None:
    good, expected = GOOD[kind]
    # The end of a text line, or more bytes than the longest frame that garbage can have announced.
    data = noise + (bytes(1100) if kind == "nooploop" else b"\n") + good
    parser = parser_of(kind)
    bounds = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    rounds: list[Round] = []
    for begin, end in pairwise(bounds):
        rounds += parser.receive(data[begin:end])
        parser.due(end * MS)
    assert rounds[-1] == pytest.approx(expected)
    assert all(0.0 <= range_m <= 1e4 for each in rounds for range_m in each.values())
    whole = parser_of(kind)
    assert whole.receive(data) == rounds
