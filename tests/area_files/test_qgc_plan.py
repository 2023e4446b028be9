"""Plans of QGroundControl: what is read, and the sentences for what is not."""

from pathlib import Path
from typing import Any

import pytest

from tests.area_files.samples import FIELD, degrees, near, read, sentence


def plan(*surveys: Any, polygons: Any = (), circles: Any = ()) -> dict[str, Any]:
    items = [{"type": "ComplexItem", "complexItemType": "survey", "polygon": degrees(corners)} for corners in surveys]
    fences = [{"polygon": degrees(corners), "inclusion": inclusion} for corners, inclusion in polygons]
    rounds = [{"circle": {"center": degrees([at])[0], "radius": r}, "inclusion": i} for at, r, i in circles]
    geofence = {"polygons": fences, "circles": rounds}
    return {"fileType": "Plan", "mission": {"items": [{"type": "SimpleItem"}, *items]}, "geoFence": geofence}


AROUND = ((-50.0, -50.0), (-50.0, 90.0), (90.0, 90.0), (90.0, -50.0))


def test_a_plan_is_its_survey_without_the_exclusion_fences_in_it(tmp_path: Path) -> None:
    inside, outside = ((5.0, 15.0), (5.0, 20.0), (9.0, 20.0)), ((60.0, 60.0), (60.0, 70.0), (70.0, 70.0))
    fences = [(AROUND, True), (inside, False), (outside, False)]
    content = plan(FIELD, polygons=fences, circles=[((15.0, 25.0), 3.0, False)])
    for name in ("area.plan", "area.json"):
        area = read(tmp_path, name, content)
        assert near(area.polygon_ned_m, FIELD)
        assert len(area.holes_ned_m) == 2
        assert all(((n - 15.0) ** 2 + (e - 25.0) ** 2) ** 0.5 >= 3.0 for n, e in area.holes_ned_m[1])


def test_a_plan_without_a_survey_is_the_geofence_that_includes_an_area(tmp_path: Path) -> None:
    assert read(tmp_path, "area.plan", plan(polygons=[(AROUND, True)])).name == "geofence polygon 1"
    circle = read(tmp_path, "area.plan", plan(circles=[((10.0, 0.0), 20.0, True)]))
    assert all(((n - 10.0) ** 2 + e**2) ** 0.5 == pytest.approx(20.0, abs=0.001) for n, e in circle.polygon_ned_m)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ({}, 'is not a plan of QGroundControl: it has no "fileType": "Plan"'),
        ([], "is not a plan of QGroundControl"),
        (plan(), "has neither a survey nor a geofence that includes an area"),
        (plan(polygons=[(AROUND, False)]), "has neither a survey nor a geofence that includes an area"),
        (plan(FIELD, FIELD), "has 2 areas, choose one with --feature NUMBER or NAME: 1 survey 1 (1050 m²), 2 survey 2"),
        (plan(circles=[((0.0, 0.0), -1.0, True)]), 'geofence circle 1: its radius "-1.0" is not within 0 to 50000 m'),
        (
            {"fileType": "Plan", "mission": {"items": [{"complexItemType": "CorridorScan"}]}},
            "its items are CorridorScan",
        ),
        (
            {"fileType": "Plan", "mission": {"items": [{"complexItemType": "survey"}]}},
            "survey 1 has no list of corners",
        ),
        (
            {"fileType": "Plan", "mission": {"items": [{"complexItemType": "survey", "polygon": [[1, "a"]]}]}},
            "survey 1, corner 1: \"[1, 'a']\" is not [latitude, longitude] in degrees",
        ),
        ({"fileType": "Plan", "geoFence": {"polygons": [3], "circles": 4}}, 'geofence polygon 1: "3" is not a fence'),
        ({"fileType": "Plan", "geoFence": {"circles": [{}]}}, 'geofence circle 1: "{}" is not a circle'),
    ],
)
def test_what_is_no_plan_with_an_area_is_refused_with_its_place(tmp_path: Path, content: Any, why: str) -> None:
    assert why in sentence(tmp_path, "area.plan", content)
