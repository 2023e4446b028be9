"""The rover's formats: readings worked out by hand, damaged lines, and any bytes whatever."""

from itertools import pairwise
from math import pi, radians

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jezero.services.rover_driver.config import RoverDriverConfig
from jezero.services.rover_driver.json_lines import OdometryLines
from jezero.services.rover_driver.nmea import Nmea

S = 1_000_000_000
KNOT_MPS = 0.514444


def sentence(text: str) -> bytes:
    check = 0
    for byte in text.encode():
        check ^= byte
    return f"${text}*{check:02X}\r\n".encode()


def rmc(speed_kn: float = 1.0, course_deg: float = 90.0, status: str = "A") -> bytes:
    return sentence(f"GNRMC,103607.00,{status},4723.86452,N,00832.73564,E,{speed_kn:.3f},{course_deg:.1f},060326,,,A,V")


def hdt(heading_deg: float) -> bytes:
    return sentence(f"GNHDT,{heading_deg:.2f},T")


def gga(quality: int) -> bytes:
    return sentence(f"GNGGA,103607.00,4723.86452,N,00832.73564,E,{quality},20,0.6,488.0,M,47.0,M,,")


@pytest.mark.parametrize(("course_deg", "sign"), [(90.0, 1.0), (100.0, 1.0), (270.0, -1.0), (265.0, -1.0)])
def test_the_speed_is_along_the_heading_and_negative_when_the_course_is_behind(course_deg: float, sign: float) -> None:
    (reading,) = Nmea().receive(hdt(90.0) + gga(4) + rmc(2.0, course_deg), S)
    assert reading.speed_mps == pytest.approx(sign * 2.0 * KNOT_MPS, abs=1e-4)
    assert reading.yaw_rad == pytest.approx(pi / 2)


def test_a_heading_west_of_north_is_negative() -> None:
    (reading,) = Nmea().receive(hdt(350.0) + rmc(), S)
    assert reading.yaw_rad == pytest.approx(radians(-10.0))


def test_the_yaw_rate_is_that_of_the_headings_also_over_north_or_the_receivers_own() -> None:
    nmea = Nmea()
    for i in range(11):  # 2 degrees in 0.1 s
        (reading,) = nmea.receive(hdt((350.0 + 2.0 * i) % 360.0) + rmc(), S + i * S // 10)
    assert reading.yaw_rate_rps == pytest.approx(radians(20.0), rel=1e-3)
    (reading,) = nmea.receive(sentence("GNROT,-60.0,A") + hdt(10.0) + rmc(), 2 * S + S // 10)
    assert reading.yaw_rate_rps == pytest.approx(radians(-1.0))


@pytest.mark.parametrize(
    ("data", "word"),
    [(hdt(1.0) + rmc(status="V"), "no fix"), (hdt(1.0) + gga(0) + rmc(), "no fix"), (rmc(), "no heading"),
     (sentence("GNHDT,,T") + rmc(), "no heading")],
)  # fmt: skip
def test_without_a_fix_or_a_heading_there_is_no_reading_and_it_is_named(data: bytes, word: str) -> None:
    nmea = Nmea()
    assert nmea.receive(data, S) == []
    assert word in nmea.problem
    assert len(nmea.receive(hdt(1.0) + gga(4) + rmc(), S)) == 1
    assert nmea.problem == ""


def test_an_old_heading_is_none() -> None:
    nmea = Nmea()
    nmea.receive(hdt(1.0), S)
    assert nmea.receive(rmc(), 2 * S) == []
    assert "no heading" in nmea.problem


@pytest.mark.parametrize("line", [rmc().replace(b"A", b"B", 1), rmc()[:30] + b"\r\n", b"\xff\x00\r\n", rmc()[5:]])
def test_a_damaged_sentence_is_counted_and_the_next_one_is_read(line: bytes) -> None:
    nmea = Nmea()
    assert nmea.receive(hdt(1.0) + line, S) == []
    assert nmea.bad == 1
    assert len(nmea.receive(rmc(), S)) == 1


def test_other_sentences_are_no_damage() -> None:
    nmea = Nmea()
    assert nmea.receive(sentence("GPGSV,1,1,00") + sentence("PUBX,00,1") + b"\r\n", S) == []
    assert nmea.bad == 0


def test_a_line_of_json_has_the_motion_or_the_counts_of_the_wheels() -> None:
    lines = OdometryLines(RoverDriverConfig(ticks_per_m=1000.0, track_m=0.5))
    (reading,) = lines.receive(b'{"yaw_rad": 0.5, "speed_mps": -0.2, "roll_rad": 0.1}\n', S)
    assert (reading.yaw_rad, reading.speed_mps, reading.yaw_rate_rps, reading.roll_rad) == (0.5, -0.2, 0.0, 0.1)
    assert lines.receive(b'{"yaw_rad": 0.5, "ticks": [1000, 2000]}\n', S) == []
    (reading,) = lines.receive(b'{"yaw_rad": 0.5, "ticks": [1060, 2040]}\n', S + S // 10)
    assert reading.speed_mps == pytest.approx(0.5)  # 0.06 m and 0.04 m in 0.1 s
    assert reading.yaw_rate_rps == pytest.approx(0.4)  # the left wheels are faster: clockwise


def test_counts_that_start_anew_are_no_speed() -> None:
    lines = OdometryLines(RoverDriverConfig(ticks_per_m=1000.0))
    lines.receive(b'{"yaw_rad": 0.5, "ticks": [900000, 900000]}\n', S)
    assert lines.receive(b'{"yaw_rad": 0.5, "ticks": [0, 0]}\n', S + S // 10) == []
    assert len(lines.receive(b'{"yaw_rad": 0.5, "ticks": [10, 10]}\n', S + S // 5)) == 1


@pytest.mark.parametrize(
    "line", [b"{}", b"[]", b'{"yaw_rad": 9, "speed_mps": 0}', b'{"yaw_rad": null}', b"\xff", b"[" * 4000]
)
def test_a_line_that_is_no_odometry_is_counted(line: bytes) -> None:
    lines = OdometryLines(RoverDriverConfig())
    assert lines.receive(line + b"\n", S) == []
    assert lines.bad == 1


GOOD = {"nmea": hdt(90.0) + gga(4) + rmc(), "json": b'{"yaw_rad": 0.5, "speed_mps": 0.25}\n'}
STRANGE = ("GNROT,x,A", "GNGGA", "GNHDT,a,b,c", "GNRMC,999999,A,0,N,0,E,x,y,99,,,", "GNHDT")
FRAGMENTS = st.sampled_from([*GOOD.values(), rmc(status="V"), gga(0), *map(sentence, STRANGE)])
NOISE = st.lists(st.binary(max_size=40) | FRAGMENTS | FRAGMENTS.map(lambda f: f[: len(f) // 2]), max_size=4)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["nmea", "json"])
@settings(max_examples=5_000, database=None)
@given(noise=NOISE.map(b"".join), cuts=st.lists(st.integers(0, 300), max_size=4))
def test_no_bytes_raise_however_they_are_cut_and_the_next_good_ones_are_read(
    kind: str, noise: bytes, cuts: list[int]
) -> None:
    data = noise + b"\n" + GOOD[kind]
    parser = Nmea() if kind == "nmea" else OdometryLines(RoverDriverConfig())
    bounds = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    readings = [each for begin, end in pairwise(bounds) for each in parser.receive(data[begin:end], S)]
    assert readings
    assert all(abs(each.yaw_rad) <= pi and abs(each.speed_mps) <= 51.0 for each in readings)
