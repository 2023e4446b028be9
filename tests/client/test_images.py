"""Goals that take pictures as a client sees them, against a real router and a hand-made server."""

from pathlib import Path

import msgspec
import pytest
import zenoh
from click.testing import CliRunner

from jezero import Aborted, JezeroError, Vehicle
from jezero.cli.main import main
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Feedback, PlanReply, Result
from jezero.schemas.commands import Outcome
from jezero.schemas.goals import GetImagesGoal, ImagesFeedback, ImagesResult
from jezero.schemas.images import GetImage, Image, ImageReply
from tests.client.rig import Server, endpoint, server, vehicle, wait_until_served
from tests.client.test_dataset import HEIGHT_PX, WIDTH_PX, picture

__all__ = ["endpoint", "server", "vehicle"]
PLACE = (1.0, 2.0, -4.0)
KEPT = 3
"""The server has the pixels of so many pictures."""


def pixels_of(index: int) -> bytes:
    return bytes([index]) * (3 * WIDTH_PX * HEIGHT_PX)


def serve_pictures(server: Server) -> None:
    """As an action server: pixels as the payload, everything else attached."""

    def on_query(query: zenoh.Query) -> None:
        assert query.payload is not None
        wanted = msgspec.json.decode(query.payload.to_bytes(), type=GetImage)
        server.asked.append(("image", "", wanted.index))
        there = wanted.index < KEPT
        header = ImageReply(
            goal_id=wanted.goal_id,
            index=wanted.index,
            width_px=WIDTH_PX if there else 0,
            height_px=HEIGHT_PX if there else 0,
            reason="" if there else "not any more",
        )
        with query:
            pixels = pixels_of(wanted.index) if there else b""
            query.reply(query.key_expr, pixels, attachment=msgspec.json.encode(header))

    key = topics.key("v", topics.GET_IMAGES.image.name)
    callback = zenoh.handlers.Callback(on_query, indirect=False)
    server._queryables.append(server.session.declare_queryable(key, callback, complete=True))
    for session in (server._probe, *server.clients):
        wait_until_served(session, key)


def feedback(taken: int, *images: Image) -> Feedback[ImagesFeedback]:
    content = ImagesFeedback(pos_uav_ned_m=PLACE, taken=taken, planned=3, images=images)
    return Feedback(goal_id="g", t_ns=1, code=6, feedback=content)


def result(*images: Image, outcome: Outcome = "succeeded", reason: str = "") -> Result[ImagesResult]:
    content = ImagesResult(completed=outcome == "succeeded", pos_uav_ned_m=PLACE, images=images)
    return Result(goal_id="g", t_ns=2, outcome=outcome, reason=reason, result=content)


IMAGES = tuple(picture(index).image for index in range(3))


def test_pictures_come_once_each_streamed_or_at_the_end(server: Server, vehicle: Vehicle) -> None:
    told = (feedback(1, IMAGES[0]), feedback(2, IMAGES[1]))
    server.serve(topics.GET_IMAGES.endpoint.name, Accepted(goal_id="g"), *told, result(*IMAGES))
    serve_pictures(server)
    goal = vehicle.get_images((0.0, 0.0, -4.0), 2.0, 3)
    seen: list[int] = []
    pictures = list(goal.pictures(lambda report: seen.append(report.taken)))
    assert [p.image.index for p in pictures] == [0, 1, 2]
    assert [p.pixels for p in pictures] == [pixels_of(0), pixels_of(1), pixels_of(2)]
    assert seen == [1, 2]
    assert goal.result().completed
    sent = next(fields for name, _, fields in server.asked if name == topics.GET_IMAGES.endpoint.name)
    assert msgspec.convert(sent, GetImagesGoal).num_images == 3
    assert [fields for name, _, fields in server.asked if name == "image"] == [0, 1, 2]


def test_an_aborted_goal_has_pictures_too_and_a_lost_one_says_why(server: Server, vehicle: Vehicle) -> None:
    ended = result(IMAGES[0], picture(7).image, outcome="aborted", reason="no pictures: none came")
    server.serve(topics.GET_IMAGES.endpoint.name, Accepted(goal_id="g"), ended)
    serve_pictures(server)
    goal = vehicle.get_images((0.0, 0.0, -4.0), 2.0, 3)
    pictures = goal.pictures()
    assert next(pictures).image.index == 0
    with pytest.raises(JezeroError, match="not any more"):
        next(pictures)
    with pytest.raises(Aborted, match="none came"):
        goal.result()


def test_the_words_of_the_thesis_write_a_dataset(
    server: Server, vehicle: Vehicle, endpoint: str, tmp_path: Path
) -> None:
    server.serve(topics.GET_IMAGES.plan.name, PlanReply(accepted=True, duration_s=42.0))
    server.serve(topics.GET_IMAGES.endpoint.name, Accepted(goal_id="g"), feedback(3, *IMAGES), result(*IMAGES))
    serve_pictures(server)
    words = "getimages -2.0 0 -4 2 4 rover --target-z -0.5 --format png --vehicle v"
    done = CliRunner().invoke(main, [*words.split(), "--router", endpoint, "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "3 of 3 images" in done.output
    assert f"succeeded, 3 images in {tmp_path / 'out'}" in done.output
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"images", "geo.txt"}
    names = {file.name for file in (tmp_path / "out" / "images").iterdir()}
    assert names == {"0000.png", "0001.png", "0002.png", "images.json"}
    sent = next(fields for name, _, fields in server.asked if name == topics.GET_IMAGES.endpoint.name)
    goal = msgspec.convert(sent, GetImagesGoal)
    assert (goal.center_ned_m, goal.radius_m, goal.num_images) == ((-2.0, 0.0, -4.0), 2.0, 4)
    assert (goal.frame, goal.target_z_ned_m, goal.stream_images) == ("rover", -0.5, True)
