"""`jezero gridsweep --plan-only`: its words, its files, its refusals."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from jezero.cli.main import main
from jezero.cli.polygon_file import PolygonFileError, read_polygon

SQUARE = {"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]]}
HOLE = [[1, 1], [1, 2], [2, 2], [2, 1], [1, 1]]


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
    result = run(tmp_path, "--polygon", str(file), "--z", "-5", "--resolution", "0.5", "--json")
    assert result.exit_code == 0, result.output
    plan = json.loads(result.output)
    assert set(plan) == {"path_ned_m", "pictures_ned_m", "length_m", "time_s", "covered"}
    assert len(plan["pictures_ned_m"]) == pytest.approx(plan["length_m"] / 0.5, abs=1)
    assert plan["covered"] > 0.99
    assert not any(1.01 < n < 1.99 and 1.01 < e < 1.99 for n, e in plan["path_ned_m"])


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--z", "5", "--resolution", "0.5"), "5 m up is −5"),
        (("--z", "-5", "--resolution", "0.005"), "needs about 640000 pictures, more than 3000"),
        (("--z", "-5", "--resolution", "0.5", "--overlap", "0.7"), "choose one of them"),
        (("--z", "-5", "--resolution", "0"), "above 0 m"),
        (("--z", "-5", "--resolution", "nan"), "finite"),
        (("--z", "-5", "--resolution", "1", "--speed", "50"), "speed 50 m/s is not within"),
        (("--z", "-500", "--resolution", "1"), "beyond the limit of 120 m"),
    ],
)
def test_wrong_numbers_are_refused_with_what_to_do(tmp_path: Path, words: tuple[str, ...], why: str) -> None:
    file = tmp_path / "area.geojson"
    file.write_text(json.dumps(SQUARE))
    result = run(tmp_path, "--polygon", str(file), *words)
    assert result.exit_code != 0
    assert why in result.output


def test_overlaps_set_the_distances_from_what_the_camera_sees(tmp_path: Path) -> None:
    file = tmp_path / "area.csv"
    file.write_text("north,east\n0,0\n30,0\n30,30\n0,30\n")
    result = run(tmp_path, "--polygon", str(file), "--z", "-10", "--overlap", "0.8", "--sidelap", "0.6")
    assert result.exit_code == 0, result.output
    assert "lines 6.71 m apart" in result.output
    assert "every 2.52 m" in result.output


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("a.csv", "0,0\n1,zero\n", 'line 2: "1,zero" is not "north,east"'),
        ("a.csv", "", "holds no corners"),
        ("a.json", "{", "is not JSON"),
        ("a.json", "[]", "holds no GeoJSON Polygon"),
        ("a.json", '{"type": "Polygon", "coordinates": [[["a"]]]}', "must be rings of"),
        ("a.json", json.dumps({**SQUARE, "crs": {}}), "names a coordinate system"),
    ],
)
def test_files_that_hold_no_polygon_are_refused(tmp_path: Path, name: str, text: str, why: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(PolygonFileError, match=why):
        read_polygon(tmp_path / name)


def test_a_csv_file_has_an_empty_line_before_each_hole(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("0,0\n4,0\n4,4\n\n1,1\n1.5,1\n1.5,1.2\n")
    outline, holes = read_polygon(tmp_path / "a.csv")
    assert outline == ((0, 0), (4, 0), (4, 4))
    assert holes == (((1, 1), (1.5, 1), (1.5, 1.2)),)
