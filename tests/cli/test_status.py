"""Texts of `jezero status`."""

import pytest

from jezero.cli.status import wind_text


@pytest.mark.parametrize(
    ("north_mps", "east_mps", "text"),
    [
        (-4.0, 0.0, "from 0 degrees"),
        (-4.0, 0.01, "from 0 degrees"),
        (-4.0, 0.1, "from 359 degrees"),
        (0.0, -4.0, "from 90 degrees"),
        (4.0, 0.0, "from 180 degrees"),
        (4.0, -1e-9, "from 180 degrees"),
    ],
)
def test_the_wind_comes_from_0_to_359_degrees(north_mps: float, east_mps: float, text: str) -> None:
    assert wind_text((north_mps, east_mps, 0.0), None) == f"4.0 m/s {text}"
