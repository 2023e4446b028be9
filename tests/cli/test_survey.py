"""`jezero gridsweep`: its words, its files, its refusals, and what it leaves behind."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from jezero.cli.main import main
from tests.cli.areas import HOLE, SQUARE, field

__all__ = ["field"]


def run(tmp_path: Path, *words: str, typed: str | None = None) -> Result:
    return CliRunner().invoke(
        main, ["gridsweep", "--plan-only", "--out", str(tmp_path / "plan.png"), *words], input=typed
    )


def test_the_prompts_of_the_thesis_lead_to_its_plan(tmp_path: Path) -> None:
    corners = "7\n0\n0\n3\n5\n7\n4\n7\n2\n4\n1\n3\n2\n0\n0\n"
    result = run(tmp_path, typed=corners + "-5\n0.25\n")
    assert result.exit_code == 0, result.output
    assert "Grid point n. 7 :" in result.output
    assert "16.5 m²" in result.output
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")


def test_a_plan_is_told_to_programs(tmp_path: Path) -> None:
    file = tmp_path / "area.geojson"
    file.write_text(
        json.dumps({"type": "Feature", "geometry": {**SQUARE, "coordinates": [*SQUARE["coordinates"], HOLE]}})
    )
    result = run(tmp_path, "--polygon", str(file), "--metres", "--z", "-5", "--resolution", "0.5", "--json")
    assert result.exit_code == 0, result.output
    plan = json.loads(result.output)
    assert {"path_ned_m", "pictures_ned_m", "length_m", "time_s", "covered", "photographed", "origin_deg"} <= set(plan)
    assert plan["plan_id"] is None and plan["start"].startswith("assumed")
    assert plan["origin_deg"] == [47.397742, 8.545594]
    assert len(plan["pictures_ned_m"]) == pytest.approx(plan["length_m"] / 0.5, abs=1)
    assert plan["covered"] > 0.99
    assert not any(1.01 < n < 1.99 and 1.01 < e < 1.99 for n, e in plan["path_ned_m"])


def test_the_lines_and_the_images_are_as_angle_and_picture_distance_say(tmp_path: Path) -> None:
    file = tmp_path / "area.geojson"
    file.write_text(json.dumps(SQUARE))
    common = ("--polygon", str(file), "--metres", "--z", "-5", "--resolution", "0.5", "--json")
    plans = [
        json.loads(run(tmp_path, *common, "--picture-distance", "0.25", "--angle", angle).output)
        for angle in ("0", "90", "-90")
    ]
    for plan in plans:
        assert len(plan["pictures_ned_m"]) == pytest.approx(plan["length_m"] / 0.25, abs=1)
    assert plans[0]["path_ned_m"] != plans[1]["path_ned_m"] == plans[2]["path_ned_m"]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--z", "5", "--resolution", "0.5"), "5 m up is −5"),
        (("--z", "-5", "--resolution", "0.005"), "needs about 640000 pictures, more than 3000"),
        (("--z", "-5", "--resolution", "0.5", "--overlap", "0.7"), "choose one of them"),
        (("--z", "-5", "--resolution", "0"), "above 0 m"),
        (("--z", "-5", "--resolution", "1", "--picture-distance", "0"), "x>0"),
        (("--z", "-5", "--resolution", "1", "--angle", "400"), "-360.0<=x<=360.0"),
        (("--z", "-5", "--overlap", "0.7", "--picture-distance", "1"), "choose one of them"),
        (("--z", "-5", "--resolution", "nan"), "finite"),
        (("--z", "-5", "--resolution", "1", "--speed", "50"), "speed 50 m/s is not within"),
        (("--z", "-500", "--resolution", "1"), "beyond the limit of 120 m"),
    ],
)
def test_wrong_numbers_are_refused_with_what_to_do(tmp_path: Path, words: tuple[str, ...], why: str) -> None:
    file = tmp_path / "area.geojson"
    file.write_text(json.dumps(SQUARE))
    result = run(tmp_path, "--polygon", str(file), "--metres", *words)
    assert result.exit_code != 0
    assert why in result.output


def test_overlaps_set_the_distances_from_what_the_camera_sees(tmp_path: Path) -> None:
    file = tmp_path / "area.csv"
    file.write_text("north,east\n0,0\n30,0\n30,30\n0,30\n")
    result = run(tmp_path, "--polygon", str(file), "--z", "-9", "--overlap", "0.8", "--sidelap", "0.6")
    assert result.exit_code == 0, result.output
    assert "lines 6.04 m apart" in result.output
    assert "every 2.27 m" in result.output


def test_an_area_in_degrees_is_planned_around_the_origin_of_the_simulator_or_the_one_that_is_given(
    tmp_path: Path, field: list[str]
) -> None:
    here = run(tmp_path, *field).output
    assert "place       north 0 to 30 m, east 0 to 45 m from the world's origin at 47.397742, 8.545594" in here
    assert "(the simulator's settings)" in here
    there = run(tmp_path, *field, "--origin", "47.397", "8.5465").output
    assert "place       north 83 to 113 m, east -68 to -23 m from the world's origin at 47.397000, 8.546500" in there
    far = run(tmp_path, *field, "--origin", "-33.9", "18.4")
    assert far.exit_code == 1 and "from the world's origin, which is at -33.900000, 18.400000" in far.output
    for words in (("91", "8"), ("47", "181"), ("nan", "8")):
        assert "a latitude within ±90 and a longitude" in run(tmp_path, *field, "--origin", *words).output


def test_the_area_of_a_file_with_several_is_chosen_by_its_name(tmp_path: Path) -> None:
    file = tmp_path / "area.geojson"
    fields = [{"type": "Feature", "properties": {"name": name}, "geometry": SQUARE} for name in ("a", "b")]
    file.write_text(json.dumps({"type": "FeatureCollection", "features": fields}))
    words = ["--polygon", str(file), "--metres", "--z", "-5", "--resolution", "1"]
    refused = run(tmp_path, *words)
    assert refused.exit_code == 1
    assert "has 2 areas, choose one with --feature NUMBER or NAME: 1 a (16 m²), 2 b (16 m²)" in refused.output
    assert run(tmp_path, *words, "--feature", "b").exit_code == 0


def test_degrees_are_never_relative_to_the_rover(tmp_path: Path, field: list[str]) -> None:
    refused = run(tmp_path, *field, "rover")
    assert refused.exit_code == 1 and "leave out `rover`" in refused.output


def write_ring(file: Path, corners_deg: list[tuple[float, float]]) -> list[str]:
    """Write a polygon of latitudes and longitudes as GeoJSON; the options that name it."""
    ring = [[longitude, latitude] for latitude, longitude in (*corners_deg, corners_deg[0])]
    file.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    return ["--polygon", str(file), "--z", "-8", "--overlap", "0.5"]


CROSSED = [(47.3977, 8.5456), (47.3980, 8.5460), (47.3977, 8.5460), (47.3980, 8.5456)]


def test_a_crossing_is_named_in_the_degrees_of_the_file(tmp_path: Path) -> None:
    refused = run(tmp_path, *write_ring(tmp_path / "crossed.geojson", CROSSED))
    assert refused.exit_code == 1
    assert "crosses or touches itself at latitude 47.39785" in refused.output
    assert "longitude 8.5458000 (12.01 m north, 15.51 m east): give its corners in order" in refused.output
    square = [(47.3977, 8.5456), (47.3980, 8.5456), (47.3980, 8.5460), (47.3977, 8.5460)]
    repaired = run(tmp_path, *write_ring(tmp_path / "spike.geojson", [*square[:2], (47.3981, 8.5456), *square[1:]]))
    assert repaired.exit_code == 0
    named = "left out: at latitude 47.3981000, longitude 8.5456000 (39.81 m north, 0.45 m east)"
    assert named in repaired.output
    told = run(tmp_path, "--polygon", str(tmp_path / "spike.geojson"), "--z", "-8", "--overlap", "0.5", "--json")
    assert named in json.loads(told.stdout)["warning"]


def test_a_crossing_in_a_file_in_metres_is_named_in_metres(tmp_path: Path) -> None:
    file = tmp_path / "area.csv"
    file.write_text("north,east\n0,0\n10,10\n10,0\n0,10\n")
    refused = run(tmp_path, "--polygon", str(file), "--z", "-8", "--overlap", "0.5")
    assert "crosses or touches itself at 5.00 m north, 5.00 m east: give" in refused.output


@pytest.mark.parametrize("name", ["plan.txt", "plan", "folder.png"])
def test_a_plan_is_drawn_into_a_png_file_only(tmp_path: Path, field: list[str], name: str) -> None:
    (tmp_path / "folder.png").mkdir()
    refused = run(tmp_path, *field, "--out", str(tmp_path / name))
    assert refused.exit_code == 2 and "--out is a PNG file, such as plan.png" in refused.output
