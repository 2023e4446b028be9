"""Areas that the tests of surveys share."""

from pathlib import Path

import pytest

SQUARE = {"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]]}
HOLE = [[1, 1], [1, 2], [2, 2], [2, 1], [1, 1]]
DEGREES = """latitude,longitude
47.397742,8.545594
47.397742,8.54612483
47.39796696,8.54619119
47.39801195,8.54572671
"""


@pytest.fixture
def field(tmp_path: Path) -> list[str]:
    """The options of an area in degrees, 30 m by 45 m at the simulator's origin."""
    file = tmp_path / "field.csv"
    file.write_text(DEGREES)
    return ["--polygon", str(file), "--z", "-8", "--overlap", "0.5"]
