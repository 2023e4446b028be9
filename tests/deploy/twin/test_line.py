"""A line with a baud rate, read as a program reads a serial device."""

import os
from pathlib import Path

import serial

from jezero.deploy.twin.line import Line


def opened(line: Line) -> serial.Serial:
    return serial.Serial(str(line.path), 115_200, timeout=0, exclusive=True)


def test_bytes_pass_both_ways_no_faster_than_the_baud_rate(tmp_path: Path) -> None:
    line = Line(tmp_path / "device", baud=57_600)
    with opened(line) as other:
        other.write(bytes(1000))
        line.put(bytes(1200))
        received, sent, now_s = b"", b"", 10.0
        for _ in range(10):  # 0.1 s: 576 bytes
            sent += line.move(now_s)
            received += other.read(5000)
            now_s += 0.01
        assert 480 <= len(received) <= 580
        assert 480 <= len(sent) <= 580
        for _ in range(15):
            sent += line.move(now_s)
            received += other.read(5000)
            now_s += 0.01
        assert (len(received), len(sent)) == (1200, 1000)
    line.close()


def test_a_datagram_that_finds_the_buffer_full_is_lost_as_a_whole(tmp_path: Path) -> None:
    line = Line(tmp_path / "device", baud=57_600)
    for _ in range(10):
        line.put(bytes(280))
    assert line.dropped == 5
    line.close()


def test_a_plug_that_is_pulled_takes_the_device_away_and_put_back_brings_it(tmp_path: Path) -> None:
    line = Line(tmp_path / "device", baud=57_600)
    line.unplug()
    assert not os.path.lexists(line.path)
    line.put(b"lost")
    assert line.move(1.0) == b""
    line.plug()
    with opened(line) as other:
        line.move(2.0)
        line.put(b"again")
        line.move(2.01)
        assert other.read(100) == b"again"
    line.close()
    assert not os.path.lexists(line.path)
