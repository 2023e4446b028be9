"""Files of rover drives: what is in them, and what is wrong with them."""

from pathlib import Path

import pytest

from jezero.client.rover import Leg, read_legs

HEADER = "duration_s,speed_mps,yaw_rate_rps\n"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "drive.csv"
    path.write_text(text)
    return path


def test_a_file_has_one_leg_per_line(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER + "10, 0.5, 0\n\n5,-1,0.2\n")
    assert read_legs(path) == [Leg(10.0, 0.5, 0.0), Leg(5.0, -1.0, 0.2)]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the first line must be duration_s,speed_mps,yaw_rate_rps"),
        ("1,2,3\n", "the first line must be"),
        (HEADER, "has no line below"),
        (HEADER + "1,2\n", "line 2: '1,2' is not three numbers"),
        (HEADER + "1,1,0\n1,fast,0\n", "line 3"),
        (HEADER + "0,1,0\n", "duration 0 s is not positive"),
        (HEADER + "nan,1,0\n", "duration nan s is not positive"),
        (HEADER + "inf,1,0\n", "duration must be finite"),
        (HEADER + "1,2.5,0\n", "speed 2.5 m/s is not within ±2"),
        (HEADER + "1,nan,0\n", "speed nan m/s"),
        (HEADER + "1,1,-1.5\n", "yaw rate -1.5 rad/s is not within ±1"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ValueError, match=r"drive\.csv") as caught:
        read_legs(written(tmp_path, text))
    assert said in str(caught.value)
