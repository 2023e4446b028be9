"""`jezero gridsweep`: its words, its files, its refusals, and what it leaves behind."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result

from jezero.cli.main import main
from jezero.cli.polygon_file import PolygonFileError, read_polygon
from jezero.client.dataset import Dataset
from jezero.client.errors import Aborted
from jezero.client.images import Picture
from jezero.schemas.actions import AreaCoverageGoal, CoverageResult, ImagesFeedback, PlanReply
from jezero.schemas.images import LISTING
from jezero.schemas.topics import Action
from tests.client.test_dataset import picture

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
    result = run(tmp_path, "--polygon", str(file), "--z", "-9", "--overlap", "0.8", "--sidelap", "0.6")
    assert result.exit_code == 0, result.output
    assert "lines 6.04 m apart" in result.output
    assert "every 2.27 m" in result.output


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("a.csv", "0,0\n1,zero\n", 'line 2: "1,zero" is not "north,east"'),
        ("a.csv", "", "has no corners"),
        ("a.json", "{", "is not JSON"),
        ("a.json", "[]", "has no GeoJSON Polygon"),
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
    assert list(outline) == [(0, 0), (4, 0), (4, 4)]
    assert [list(hole) for hole in holes] == [[(1, 1), (1.5, 1), (1.5, 1.2)]]


# -- flown --


GOAL = AreaCoverageGoal(
    polygon_ned_m=((0.0, 0.0), (4.0, 0.0), (4.0, 4.0)), z_ned_m=-5.0, resolution_m=2.0, start_ned_m=(0.0, 0.0)
)


class FakeGoal:
    """A coverage that gives its pictures and ends as told."""

    goal_id, warning, remaining_s = "g", "", 42.0

    def __init__(self, pictures: list[Picture], result: CoverageResult, outcome: str) -> None:
        self._pictures, self._result, self._outcome = pictures, result, outcome

    def pictures(self, watch: Callable[[ImagesFeedback], None]) -> Iterator[Picture]:
        for taken in self._pictures:
            watch(ImagesFeedback(pos_uav_ned_m=taken.image.pos_uav_ned_m, taken=1, planned=4))
            yield taken

    def result(self) -> CoverageResult:
        if self._outcome == "aborted":
            raise Aborted("no pictures: the camera is gone", self._result)
        return self._result


class FakeVehicle:
    """Flies two of four pictures, then the rest.

    Attributes:
        goals: that it was asked to fly.
    """

    def __init__(self) -> None:
        self.goals: list[AreaCoverageGoal] = []

    def status(self) -> Any:
        return SimpleNamespace(odometry=SimpleNamespace(pos_uav_ned_m=(1.5, 2.5, -3.0)))

    def plan(self, action: Action[Any], goal: AreaCoverageGoal) -> PlanReply:
        return PlanReply(accepted=True, duration_s=42.0)

    def send(self, action: Action[Any], goal: AreaCoverageGoal) -> FakeGoal:
        self.goals.append(goal)
        first = goal.first_picture
        pictures = [picture(index) for index in range(first, first + 2)]
        resume = None if first else msgspec.structs.replace(goal, first_picture=2)
        images = tuple(taken.image for taken in pictures)
        result = CoverageResult(
            completed=resume is None, pos_uav_ned_m=(0.0, 0.0, -5.0), images=images, covered=0.5, resume=resume
        )
        return FakeGoal(pictures, result, "aborted" if resume else "succeeded")


@pytest.fixture
def vehicle(monkeypatch: pytest.MonkeyPatch) -> FakeVehicle:
    fake = FakeVehicle()

    @contextmanager
    def connected(*_: Any) -> Iterator[FakeVehicle]:
        with suppress(Aborted):
            yield fake

    monkeypatch.setattr("jezero.cli.survey.connected", connected)
    return fake


def test_a_coverage_that_ended_early_is_completed_in_its_folder(tmp_path: Path, vehicle: FakeVehicle) -> None:
    area, folder = tmp_path / "area.geojson", tmp_path / "run"
    area.write_text(json.dumps(SQUARE))
    words = ["gridsweep", "--polygon", str(area), "--z", "-5", "--resolution", "2", "--out", str(folder)]
    CliRunner().invoke(main, words)
    listing = json.loads((folder / LISTING).read_text())
    assert [image["file"] for image in listing["images"]] == ["0000.jpg", "0001.jpg"]
    assert listing["goal"]["start_ned_m"] == [1.5, 2.5] and len(listing["track_ned_m"]) == 2
    assert json.loads((folder / "resume.json").read_text())["first_picture"] == 2
    done = CliRunner().invoke(main, ["gridsweep", "--resume", str(folder), "--json"])
    assert done.exit_code == 0, done.output
    assert vehicle.goals[1] == msgspec.structs.replace(vehicle.goals[0], first_picture=2)
    listing = json.loads((folder / LISTING).read_text())
    assert [image["index"] for image in listing["images"]] == [0, 1, 2, 3]
    assert len((folder / "geo.txt").read_text().splitlines()) == 5
    again = CliRunner().invoke(main, ["gridsweep", "--resume", str(folder)])
    assert again.exit_code == 0 and f"nothing is missing in {folder}: all 4 images are there" in again.output
    assert len(vehicle.goals) == 2


def kill(folder: Path, images: int) -> None:
    """Put a completed coverage's folder into the state in which a killed command leaves it after some images."""
    with Dataset(folder) as dataset:
        dataset.note(action="area_coverage", goal=GOAL, planned=4)
        for index in range(images):
            dataset.add(picture(index))
    (folder / "resume.json").write_bytes(msgspec.json.encode(GOAL))


@pytest.mark.parametrize("images", [0, 1, 3])
def test_a_coverage_whose_command_was_killed_goes_on_after_the_images_that_are_there(
    tmp_path: Path, vehicle: FakeVehicle, images: int
) -> None:
    kill(tmp_path, images)
    done = CliRunner().invoke(main, ["gridsweep", "--resume", str(tmp_path)])
    assert done.exception is None or done.exit_code == 0, done.output
    assert vehicle.goals == [msgspec.structs.replace(GOAL, first_picture=images)]


def test_a_coverage_whose_command_was_killed_after_the_last_image_is_complete(
    tmp_path: Path, vehicle: FakeVehicle
) -> None:
    kill(tmp_path, 4)
    done = CliRunner().invoke(main, ["gridsweep", "--resume", str(tmp_path)])
    assert done.exit_code == 0 and "nothing is missing" in done.output
    assert vehicle.goals == [] and not (tmp_path / "resume.json").exists()


def test_a_folder_without_images_of_a_coverage_cannot_be_resumed(tmp_path: Path) -> None:
    done = CliRunner().invoke(main, ["gridsweep", "--resume", str(tmp_path)])
    assert done.exit_code == 1 and "is it the folder of a gridsweep?" in done.output


def test_pictures_do_not_go_where_others_are(tmp_path: Path, vehicle: FakeVehicle) -> None:
    area, folder = tmp_path / "area.geojson", tmp_path / "run"
    area.write_text(json.dumps(SQUARE))
    words = ["gridsweep", "--polygon", str(area), "--z", "-5", "--resolution", "2", "--out", str(folder)]
    CliRunner().invoke(main, words)
    again = CliRunner().invoke(main, words)
    assert again.exit_code == 1 and "has pictures already" in again.output
    assert len(vehicle.goals) == 1


def test_a_coverage_that_took_no_picture_is_completed_in_the_format_that_is_asked_for(
    tmp_path: Path, vehicle: FakeVehicle
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "resume.json").write_bytes(msgspec.json.encode(GOAL))
    CliRunner().invoke(main, ["gridsweep", "--resume", str(folder), "--format", "png"])
    listing = json.loads((folder / LISTING).read_text())
    assert [image["file"] for image in listing["images"]] == ["0000.png", "0001.png"]
