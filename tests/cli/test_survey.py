"""`jezero gridsweep`: its words, its files, its refusals, and what it leaves behind."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner, Result

from jezero.cli.area import Origin, around_origin
from jezero.cli.flight import Printer
from jezero.cli.main import main
from jezero.cli.pictures import take_pictures
from jezero.client.dataset import Dataset
from jezero.client.errors import Aborted
from jezero.client.images import Picture
from jezero.schemas.actions import PlannedCoverage, PlanReply
from jezero.schemas.goals import AreaCoverageGoal, CoverageResult, ImagesFeedback
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
    result = run(tmp_path, "--polygon", str(file), "--metres", "--z", "-5", "--resolution", "0.5", "--json")
    assert result.exit_code == 0, result.output
    plan = json.loads(result.output)
    assert {"path_ned_m", "pictures_ned_m", "length_m", "time_s", "covered", "photographed", "origin_deg"} <= set(plan)
    assert plan["plan_id"] is None and plan["start"].startswith("assumed")
    assert plan["origin_deg"] == [47.397742, 8.545594]
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


@pytest.fixture
def field(tmp_path: Path) -> list[str]:
    """The options of an area in degrees, 30 m by 45 m at the simulator's origin."""
    file = tmp_path / "field.csv"
    file.write_text(DEGREES)
    return ["--polygon", str(file), "--z", "-8", "--overlap", "0.5"]


DEGREES = """latitude,longitude
47.397742,8.545594
47.397742,8.54612483
47.39796696,8.54619119
47.39801195,8.54572671
"""


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


# -- flown --


GOAL = AreaCoverageGoal(
    polygon_ned_m=((0.0, 0.0), (4.0, 0.0), (4.0, 4.0)), z_ned_m=-5.0, resolution_m=2.0, start_ned_m=(0.0, 0.0)
)


class FakeGoal:
    """A coverage that gives its pictures and ends as told."""

    goal_id, warning, remaining_s, paused = "g", "", 42.0, False

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


PLANNED = PlannedCoverage(
    plan_id="0123456789ab",
    path_ned_m=((1.0, 1.0), (3.0, 1.0)),
    pictures_ned_m=((1.0, 1.0), (3.0, 1.0)),
    start_ned_m=(1.5, 2.5),
    line_distance_m=2.0,
    picture_distance_m=2.0,
    length_m=2.0,
    duration_s=9.0,
    covered=0.99,
    photographed=0.95,
)


class FakeVehicle:
    """Flies two of four pictures, then the rest.

    Attributes:
        goals: that it was asked to fly.
        origin_deg: of its world frame.
    """

    def __init__(self) -> None:
        self.goals: list[AreaCoverageGoal] = []
        self.origin_deg: tuple[float, float, float] | None = (47.397, 8.5465, 488.0)

    def status(self) -> Any:
        odometry = SimpleNamespace(pos_uav_ned_m=(1.5, 2.5, -3.0), origin_deg=self.origin_deg)
        return SimpleNamespace(odometry=odometry)

    def plan(self, action: Action[Any], goal: AreaCoverageGoal) -> PlanReply:
        return PlanReply(accepted=True, duration_s=42.0, warning="only 95 % will be in the pictures", coverage=PLANNED)

    def subscribe(self, *_: Any) -> Any:
        return SimpleNamespace(close=lambda: None)

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
    words = ["gridsweep", "--polygon", str(area), "--metres", "--z", "-5", "--resolution", "2", "--out", str(folder)]
    CliRunner().invoke(main, words)
    listing = json.loads((folder / LISTING).read_text())
    assert [image["file"] for image in listing["images"]] == ["0000.jpg", "0001.jpg"]
    assert listing["goal"]["start_ned_m"] == [1.5, 2.5] and len(listing["track_ned_m"]) == 2
    assert json.loads((folder / "resume.json").read_text())["first_picture"] == 2
    done = CliRunner().invoke(main, ["gridsweep", "--resume", str(folder)])
    assert done.exit_code == 0, done.output
    assert "3 of 4 images, at" in done.output  # those of both flights
    assert vehicle.goals[1] == msgspec.structs.replace(vehicle.goals[0], first_picture=2)
    listing = json.loads((folder / LISTING).read_text())
    assert [image["index"] for image in listing["images"]] == [0, 1, 2, 3]
    assert len(listing["track_ned_m"]) == 2 and list(map(len, listing["earlier_tracks_ned_m"])) == [2]
    assert len((folder / "geo.txt").read_text().splitlines()) == 5
    again = CliRunner().invoke(main, ["gridsweep", "--resume", str(folder)])
    assert again.exit_code == 0 and f"nothing is missing in {folder}: all 4 images are there" in again.output
    assert len(vehicle.goals) == 2


def test_the_plan_that_is_shown_is_the_one_that_is_flown_and_its_warning_is_printed_once_before(
    tmp_path: Path, vehicle: FakeVehicle, field: list[str]
) -> None:
    done = CliRunner().invoke(main, ["gridsweep", *field, "--out", str(tmp_path / "run")])
    shown = "area_coverage: 42 s; 2 images, 99.0 % of the area swept, 95.0 % photographed"
    assert done.stdout.index(shown) < done.stdout.index("gridsweep: accepted")
    assert done.stderr.count("warning: only 95 % will be in the pictures") == 1
    assert [goal.plan_id for goal in vehicle.goals] == [PLANNED.plan_id]
    noted = json.loads((tmp_path / "run" / LISTING).read_text())["goal"]
    assert (noted["plan_id"], noted["start_ned_m"]) == ("", list(PLANNED.start_ned_m))


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
    assert vehicle.goals == [msgspec.structs.replace(GOAL, first_picture=images, plan_id=PLANNED.plan_id)]


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
    words = ["gridsweep", "--polygon", str(area), "--metres", "--z", "-5", "--resolution", "2", "--out", str(folder)]
    CliRunner().invoke(main, words)
    again = CliRunner().invoke(main, words)
    assert again.exit_code == 1 and "has pictures already" in again.output
    assert len(vehicle.goals) == 1


def test_a_canceled_coverage_keeps_the_way_that_it_flew_before(tmp_path: Path) -> None:
    class CanceledGoal(FakeGoal):
        canceled = False

        def pictures(self, watch: Callable[[ImagesFeedback], None]) -> Iterator[Picture]:
            yield from super().pictures(watch)
            if not self.canceled:
                raise KeyboardInterrupt

        def cancel(self) -> None:
            self.canceled = True

    result = CoverageResult(completed=False, pos_uav_ned_m=(0.0, 0.0, -5.0), images=(), covered=0.5, resume=None)
    goal: Any = CanceledGoal([picture(0), picture(1)], result, "succeeded")
    dataset = Dataset(tmp_path)
    take_pictures(Printer(as_json=False), goal, "gridsweep", dataset)
    assert goal.canceled
    assert len(json.loads((tmp_path / LISTING).read_text())["track_ned_m"]) == 4


def test_a_coverage_that_took_no_picture_is_completed_in_the_format_that_is_asked_for(
    tmp_path: Path, vehicle: FakeVehicle
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "resume.json").write_bytes(msgspec.json.encode(GOAL))
    CliRunner().invoke(main, ["gridsweep", "--resume", str(folder), "--format", "png"])
    listing = json.loads((folder / LISTING).read_text())
    assert [image["file"] for image in listing["images"]] == ["0000.png", "0001.png"]


def test_an_area_in_degrees_is_flown_around_the_origin_of_the_vehicle(
    tmp_path: Path, vehicle: FakeVehicle, field: list[str]
) -> None:
    done = CliRunner().invoke(main, ["gridsweep", *field, "--out", str(tmp_path / "run")])
    assert "area: north 83 to 113 m, east -68 to -23 m from the world's origin at 47.397000, 8.546500" in done.output
    assert vehicle.goals[0].polygon_ned_m[0] == pytest.approx((82.5, -68.2), abs=0.1)
    assert vehicle.goals[0].origin_deg == (47.397, 8.5465)  # by which the vehicle names places in degrees


def test_an_area_in_degrees_waits_for_an_origin_that_is_known_and_the_vehicle_s_own(
    tmp_path: Path, vehicle: FakeVehicle, field: list[str]
) -> None:
    given = CliRunner().invoke(main, ["gridsweep", *field, "--origin", "47.4", "8.5"])
    assert given.exit_code == 2 and "--origin is for --plan-only" in given.output
    vehicle.origin_deg = None
    unknown = CliRunner().invoke(main, ["gridsweep", *field, "--out", str(tmp_path / "run")])
    assert unknown.exit_code == 1 and "the world's origin is not known yet" in unknown.output
    assert vehicle.goals == []


def test_a_resumed_coverage_is_over_the_same_ground_after_the_autopilot_placed_its_origin_anew(
    tmp_path: Path, vehicle: FakeVehicle, field: list[str]
) -> None:
    """A ten-thousandth of a degree of latitude is 11.12 m: the ground is that much farther south of the new origin."""
    folder = tmp_path / "run"
    CliRunner().invoke(main, ["gridsweep", *field, "--out", str(folder)])
    vehicle.origin_deg = (47.3971, 8.5465, 488.0)
    done = CliRunner().invoke(main, ["gridsweep", "--resume", str(folder)])
    assert done.exit_code == 0, done.output
    first, second = vehicle.goals
    assert second.origin_deg == (47.3971, 8.5465)
    assert second.first_picture == 2
    by_m = (np.array(second.polygon_ned_m) - np.array(first.polygon_ned_m)).tolist()
    assert by_m == [pytest.approx((-11.12, 0.0), abs=0.01)] * len(by_m)


def test_holes_and_start_of_a_coverage_move_with_its_area_and_an_area_in_metres_stays() -> None:
    goal = msgspec.structs.replace(GOAL, holes_ned_m=(((1.0, 1.0), (2.0, 1.0), (2.0, 2.0)),), origin_deg=(0.0, 8.0))
    east = Origin((0.0, 8.0001), "the vehicle's")
    moved = around_origin(goal, east)
    assert moved.polygon_ned_m[0] == pytest.approx((0.0, -11.12), abs=0.01)
    assert moved.holes_ned_m[0][2] == pytest.approx((2.0, -9.12), abs=0.01)
    assert moved.start_ned_m == pytest.approx((0.0, -11.12), abs=0.01)
    assert around_origin(GOAL, east) == GOAL
    assert around_origin(goal, None) == goal
