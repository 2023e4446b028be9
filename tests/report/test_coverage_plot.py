"""Figures of coverages: from a plan, and from what a flight's dataset tells."""

import json
from pathlib import Path

import pytest

from jezero.report.coverage_plot import draw_coverage
from jezero.schemas.goals import AreaCoverageGoal
from jezero.schemas.images import LISTING
from jezero.services.actions.area_coverage.coverage_plan import plan_coverage
from jezero.services.actions.config import ActionsConfig

CORNERS = ((0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (0.0, 2.0))


def dataset(folder: Path, frame: str) -> None:
    goal = AreaCoverageGoal(polygon_ned_m=CORNERS, z_ned_m=-4.0, resolution_m=0.5, start_ned_m=(0.0, 0.0))
    plan = plan_coverage(goal, ActionsConfig())
    told = {"polygon_ned_m": CORNERS, "z_ned_m": -4.0, "resolution_m": 0.5, "start_ned_m": (0.0, 0.0), "frame": frame}
    images = [{"pos_uav_ned_m": (north + 0.02, east, -4.0)} for north, east in plan.pictures_m]
    track = [(north, east + 0.03, -4.0) for north, east in plan.trajectory.pos_m]
    content = {"goal": told, "images": images, "track_ned_m": track, "track_frame": frame}
    (folder / LISTING).parent.mkdir()
    (folder / LISTING).write_text(json.dumps(content))


@pytest.mark.parametrize("frame", ["world", "rover"])
def test_a_coverage_is_drawn_beside_its_plan(tmp_path: Path, frame: str) -> None:
    dataset(tmp_path, frame)
    (file,) = draw_coverage(tmp_path, "svg")
    drawing = file.read_text()
    assert file.name == "coverage.svg"
    assert "<!-- start of the path -->" in drawing and "<!-- flown path -->" in drawing
    assert "cm RMS from the path" in drawing


def test_the_ways_of_all_flights_of_a_resumed_coverage_are_drawn(tmp_path: Path) -> None:
    dataset(tmp_path, "world")
    lines = [draw_coverage(tmp_path, "svg")[0].read_text().count('<g id="line2d')]
    content = json.loads((tmp_path / LISTING).read_text())
    for flights in (1, 2):
        content["earlier_tracks_ned_m"] = [[(0.0, 0.0, -4.0), (0.2, 0.0, -4.0)]] * flights
        (tmp_path / LISTING).write_text(json.dumps(content))
        lines.append(draw_coverage(tmp_path, "svg")[0].read_text().count('<g id="line2d'))
    assert [count - lines[0] for count in lines] == [0, 1, 2]


def test_a_folder_without_a_coverage_has_no_figure_of_one(tmp_path: Path) -> None:
    assert draw_coverage(tmp_path, "png") == []
    (tmp_path / LISTING).parent.mkdir()
    (tmp_path / LISTING).write_text(json.dumps({"images": [{"pos_uav_ned_m": [0.0, 0.0, -3.0]}]}))
    assert draw_coverage(tmp_path, "png") == []
