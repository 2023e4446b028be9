"""Figures of pictures: from a log where they were taken, from a dataset what they show."""

from math import atan2, cos, pi, sin
from pathlib import Path

import msgspec
import pytest
from PIL import Image as Pillow

from jezero.client.dataset import Dataset
from jezero.recording import Entry
from jezero.report.coverage_track import draw_coverage_tracks
from jezero.report.pictures import SHEET_MAX, draw_contact_sheet, draw_orbits
from jezero.report.report import ReportError, draw_run
from jezero.schemas import topics
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.goals import ImagesFeedback
from jezero.schemas.images import LISTING
from jezero.schemas.state import Odometry
from tests.client.test_dataset import picture


def around(i: int, n: int) -> tuple[float, float, float]:
    angle_rad = 2.0 * pi * i / n
    return (2.0 * cos(angle_rad), 2.0 * sin(angle_rad), -4.0)


def an_orbit(goal_id: str, first_ns: int) -> list[Entry]:
    """Eight pictures, and odometry in between."""
    entries = []
    topic = topics.feedback_of(topics.GET_IMAGES).name
    for i in range(80):
        t_ns, place = first_ns + i * 100_000_000, around(i, 80)
        odometry = Odometry(
            t_ns=t_ns,
            epoch_id=1,
            pos_uav_ned_m=place,
            vel_uav_ned_mps=(0.0, 0.0, 0.0),
            q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
            rates_uav_frd_rps=(0.0, 0.0, 0.0),
        )
        entries.append(Entry(t_ns, topics.ODOMETRY.name, odometry))
        yaw_rad = atan2(-place[1], -place[0])
        image = msgspec.structs.replace(picture(i // 10).image, pos_uav_ned_m=place, yaw_rad=yaw_rad)
        images = (image,) if i % 10 == 0 else ()
        content = ImagesFeedback(pos_uav_ned_m=place, taken=i // 10, planned=8, images=images)
        message = FeedbackMessage(t_ns=t_ns, goal_id=goal_id, action="get_images", code=6, feedback=content)
        entries.append(Entry(t_ns, topic, message))
    return entries


def test_each_orbit_of_a_log_has_a_figure(tmp_path: Path) -> None:
    entries = [*an_orbit("a", 0), *an_orbit("b", 20_000_000_000)]
    files = draw_orbits(entries, tmp_path, "png")
    assert [file.name for file in files] == ["orbit.png", "orbit_2.png"]
    assert all(file.stat().st_size > 5_000 for file in files)
    assert draw_orbits([], tmp_path, "png") == []


@pytest.mark.parametrize("with_images", [True, False])
def test_each_coverage_of_a_log_has_a_figure(with_images: bool, tmp_path: Path) -> None:
    topic = topics.feedback_of(topics.AREA_COVERAGE).name
    entries = []
    for entry in [*an_orbit("a", 0), *an_orbit("b", 20_000_000_000)]:
        message = entry.message
        if isinstance(message, FeedbackMessage):
            images = message.feedback.images if with_images else ()
            content = msgspec.structs.replace(message.feedback, images=images)
            message = msgspec.structs.replace(message, action="area_coverage", feedback=content)
            entries.append(Entry(entry.logged_ns, topic, message))
        else:
            entries.append(entry)
    files = draw_coverage_tracks(entries, tmp_path, "svg")
    assert [file.name for file in files] == ["coverage_track.svg", "coverage_track_2.svg"]
    text = "8 of 8 pictures" if with_images else "8 pictures planned, none in the feedback"
    assert all(text in file.read_text() and "no truth in the recording" in file.read_text() for file in files)
    assert draw_orbits(entries, tmp_path, "png") == []


@pytest.mark.parametrize("count", [1, 5, SHEET_MAX + 10])
def test_a_contact_sheet_has_a_bounded_number_of_pictures(count: int, tmp_path: Path) -> None:
    with Dataset(tmp_path, "png") as dataset:
        for index in range(count):
            dataset.add(picture(index))
    (file,) = draw_contact_sheet(tmp_path, "png")
    with Pillow.open(file) as sheet:
        assert sheet.width > 1000
    assert draw_contact_sheet(tmp_path / "elsewhere", "png") == []


def test_a_run_may_be_only_a_dataset_but_not_nothing(tmp_path: Path) -> None:
    with Dataset(tmp_path / "run") as dataset:
        dataset.add(picture(0))
    (tmp_path / "run" / "images.json").write_text("[]")  # OpenDroneMap's
    files, flown = draw_run(tmp_path / "run")
    assert [file.name for file in files] == ["contact_sheet.png"]
    assert flown == []
    with pytest.raises(ReportError, match=r"no recording|No such file"):
        draw_run(tmp_path / "elsewhere")
    (tmp_path / "run" / LISTING).write_text("{")
    with pytest.raises(ReportError, match=r"images\.json can't be drawn"):
        draw_run(tmp_path / "run")
