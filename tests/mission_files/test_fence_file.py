"""Fence files: what they become, and how each mistake is named."""

from pathlib import Path

import pytest

from jezero.mission_files import MissionFileError, read_fence

FIELDS = Path(__file__).parents[2] / "docs" / "how-to" / "fields"
GOOD = """\
fence: field
keep_in: [[-20, -20], [20, -20], [20, 20], [-20, 20]]
keep_out:
  crater: [[5, 5], [9, 5], [9, 9], [5, 9], [5, 5]]
ceiling_m: 30
floor_over_ground_m: 1.5
"""


def read(tmp_path: Path, text: str) -> str:
    """The mistakes of a fence, "" for none."""
    path = tmp_path / "fence.yaml"
    path.write_text(text)
    try:
        read_fence(path)
    except MissionFileError as error:
        return str(error).replace(f"{path}", "F")
    return ""


def test_a_file_becomes_a_fence(tmp_path: Path) -> None:
    path = tmp_path / "fence.yaml"
    path.write_text(GOOD)
    fence = read_fence(path)
    assert (fence.name, fence.ceiling_m, fence.floor_over_ground_m) == ("field", 30.0, 1.5)
    assert fence.keep_in is not None
    assert fence.keep_in.corners_ned_m[0] == (-20.0, -20.0)
    assert [zone.name for zone in fence.keep_out] == ["crater"]
    assert len(fence.keep_out[0].corners_ned_m) == 4


def test_the_geofence_of_a_plan_is_a_fence_in_degrees() -> None:
    fence = read_fence(FIELDS / "field.plan")
    assert fence.zones
    assert all(zone.corners_deg and not zone.corners_ned_m for zone in fence.zones)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "F, line 1: is empty"),
        ("fence: x\n", "F, line 1: the fence limits nothing"),
        ("cieling_m: 3\n", "did you mean 'ceiling_m'?"),
        ("fence: x\nceiling_m: -3\n", "F, line 2: ceiling_m: expected a number > 0"),
        ("ceiling_m: 3\nfloor_over_ground_m: 5\n", "floor of 5 m is not below the ceiling"),
        ("\nkeep_in: [[0, 0], [1, 0]]\n", "F, line 2: keep_in needs three corners or more"),
        ("keep_in: [[0, 0], [1, 0], [0, 0]]\n", "fewer than three corners"),
        ("keep_out: [[0, 0], [1, 0], [1, 1]]\n", "keep_out is written as `NAME: [corners]`"),
        ("degrees: true\nkeep_in: [[100, 8], [101, 8], [102, 9]]\n", "F, line 2: keep_in: expected"),
        ("keep_in: missing.kml\n", "keep_in: "),
        ("keep_in: &a [[0, 0], [1, 0], [1, 1]]\n", "anchors"),
    ],
)
def test_a_mistake_is_named_with_its_line(tmp_path: Path, text: str, expected: str) -> None:
    assert expected in read(tmp_path, text)
