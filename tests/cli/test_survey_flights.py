"""`jezero gridsweep` with a vehicle: the flown plan, pictures on disk, and coverages that are completed later."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from jezero.cli.goals import take_pictures
from jezero.cli.main import main
from jezero.cli.options import Origin
from jezero.cli.survey import around_origin
from jezero.cli.terminal import Printer
from jezero.client.dataset import Dataset
from jezero.client.errors import Aborted
from jezero.client.images import Picture
from jezero.schemas.actions import PlannedCoverage, PlanReply
from jezero.schemas.goals import AreaCoverageGoal, CoverageResult, ImagesFeedback
from jezero.schemas.images import LISTING
from jezero.schemas.rows import Action
from tests.cli.areas import SQUARE, field
from tests.client.test_dataset import picture

__all__ = ["field"]

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
