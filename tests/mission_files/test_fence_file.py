"""Fence files: what they become, and how each mistake is named."""

import json
from pathlib import Path
from typing import Any

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


def test_several_areas_that_touch_are_one_area_to_stay_in(tmp_path: Path) -> None:
    path = tmp_path / "fence.yaml"
    path.write_text("keep_in:\n  a: [[0, 0], [9, 0], [9, 9], [0, 9]]\n  b: [[5, 5], [15, 5], [15, 15], [5, 15]]\n")
    whole = read_fence(path).keep_in
    assert whole is not None and whole.name == "a and b" and len(whole.corners_ned_m) == 8


def plan(tmp_path: Path, geofence: dict[str, Any]) -> Path:
    path = tmp_path / "field.plan"
    path.write_text(json.dumps({"fileType": "Plan", "geoFence": geofence}))
    return path


def test_areas_of_a_plan_that_touch_are_one_and_others_are_refused(tmp_path: Path) -> None:
    def square(east: float) -> dict[str, Any]:
        corners = [[47.0, 8.0 + east], [47.001, 8.0 + east], [47.001, 8.001 + east], [47.0, 8.001 + east]]
        return {"inclusion": True, "polygon": corners}

    read = read_fence(plan(tmp_path, {"version": 2, "polygons": [square(0.0), square(0.0005)]}))
    assert read.keep_in is not None and len(read.keep_in.corners_deg) >= 4
    with pytest.raises(MissionFileError, match="don't touch"):
        read_fence(plan(tmp_path, {"version": 2, "polygons": [square(0.0), square(0.01)]}))


def test_the_one_area_of_a_geofence_of_2017_is_read(tmp_path: Path) -> None:
    circle = {"radius": 50, "center": [47.0, 8.0]}
    old = {"version": 1, "polygon": [[47.0, 8.0], [47.001, 8.0], [47.001, 8.001]], "circle": circle}
    read = read_fence(plan(tmp_path, old))
    assert read.keep_in is not None and len(read.keep_in.corners_deg) == 3 and not read.keep_out
    read = read_fence(plan(tmp_path, old | {"polygon": []}))
    assert read.keep_in is not None and len(read.keep_in.corners_deg) == 72


def test_a_geofence_or_plan_of_another_version_is_refused_by_its_version(tmp_path: Path) -> None:
    with pytest.raises(MissionFileError, match='geofence of version "3", and versions 1 and 2 are read'):
        read_fence(plan(tmp_path, {"version": 3, "polygon": [[47.0, 8.0], [47.001, 8.0], [47.001, 8.001]]}))
    newer = tmp_path / "newer.plan"
    newer.write_text(json.dumps({"fileType": "Plan", "version": 42}))
    with pytest.raises(MissionFileError, match='is a plan of version "42"'):
        read_fence(newer)
    with pytest.raises(MissionFileError, match="has no geofence"):
        read_fence(plan(tmp_path, {"version": 1, "polygon": []}))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "F, line 1: is empty"),
        ("fence: x\n", "F, line 1: the fence limits nothing"),
        ("cieling_m: 3\n", "did you mean 'ceiling_m'?"),
        ("fence: x\nceiling_m: -3\n", "F, line 2: ceiling_m: expected a number above 0"),
        ("ceiling_m: 3\nfloor_over_ground_m: 5\n", "floor of 5 m is not below the ceiling"),
        ("\nkeep_in: [[0, 0], [1, 0]]\n", "F, line 2: keep_in needs three corners or more"),
        ("keep_in: [[0, 0], [1, 0], [0, 0]]\n", "fewer than three corners"),
        ("keep_out: [[0, 0], [1, 0], [1, 1]]\n", "keep_out is written as `NAME: [corners]`"),
        ("degrees: true\nkeep_in: [[100, 8], [101, 8], [102, 9]]\n", "F, line 2: keep_in: "),
        ("keep_in: missing.kml\n", "keep_in: "),
        ("keep_in: &a [[0, 0], [1, 0], [1, 1]]\n", "anchors"),
        ("keep_in: [[-9, -9], [9, 9], [9, -9], [-9, 9]]\n", "F, line 1: keep_in: its edges cross or touch at"),
        ("keep_out:\n  a: [[0, 0], [5, 0], [10, 0]]\n", "F, line 2: a: it has no area"),
        ("keep_in: [[.nan, 0], [5, 0], [5, 5]]\n", "F, line 1: .nan is no number here"),
        ("ceiling_m: .inf\n", "F, line 1: .inf is no number here"),
        ("keep_in: [[47.3977, 8.5455], [47.3987, 8.5455], [47.3987, 8.5465]]\n", "are they degrees?"),
        ("keep_in: [[-5, -5], [5, -5], [5, 5], [-5, 5]]\nkeep_out:\n  all: [[-9, -9], [9, -9], [9, 9], [-9, 9]]\n",
         "F is no fence: nothing is left to fly in: 'all' to stay out of"),
        ("keep_in:\n  a: [[0, 0], [5, 0], [5, 5]]\n  b: [[20, 0], [25, 0], [25, 5]]\n", "line 1: keep_in: the 2 areas"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_line(tmp_path: Path, text: str, expected: str) -> None:
    assert expected in read(tmp_path, text)
