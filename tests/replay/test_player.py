"""Which messages of a recording are published again, and when."""

from collections.abc import Iterator
from itertools import repeat
from pathlib import Path

import pytest

from jezero.base.codec import encode
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording import RecordingError, open_recording
from jezero.recording.images import HEADERS, ImageFormat
from jezero.recording.viewer_scene import ViewerScene
from jezero.recording.writer import RecordingWriter
from jezero.replay.player import COMMANDS, STEP_NS, Player, ReplayMessage, choose_topics, is_published, replay_messages
from jezero.schemas import topics
from jezero.schemas.health import ServiceHealth
from jezero.schemas.journal import JournalPart
from jezero.schemas.rows import CLIENTS, GOAL_IN_CHARGE
from jezero.schemas.sensors import CameraFrame
from tests.client.rig import ODOMETRY
from tests.recording.rig import SECOND_NS, record

START_NS = 77 * SECOND_NS
"""The clock's time at the start of a replay."""


def at(*times_s: float) -> list[ReplayMessage]:
    """Messages at these times of a flight."""
    return [ReplayMessage(int(time_s * SECOND_NS), "odometry", b"{}") for time_s in times_s]


def player_of(
    messages: list[ReplayMessage], start_s: float = 0.0, end_s: float = 10.0, *, speed: float = 1.0, loop: bool = False
) -> Player:
    start_ns, end_ns = int(start_s * SECOND_NS), int(end_s * SECOND_NS)
    return Player(lambda: iter(messages), start_ns, end_ns, START_NS, speed=speed, loop=loop)


def now(seconds: float) -> int:
    """The clock's time some seconds after the start."""
    return START_NS + int(seconds * SECOND_NS)


def taken_s(player: Player, seconds: float) -> list[float]:
    """Times in the flight of all messages that are due some seconds after the start."""
    due = (player.take(now(seconds)) for _ in repeat(None))
    return [message.at_ns / SECOND_NS for message in iter(lambda: next(due), None)]


def test_a_message_is_due_as_long_after_the_start_as_it_was_recorded() -> None:
    player = player_of(at(0.0, 1.0, 2.5))
    assert taken_s(player, 0.0) == [0.0]
    assert taken_s(player, 0.99) == []
    assert player.wait_s(now(0.5)) == pytest.approx(0.5)
    assert taken_s(player, 1.0) == [1.0] and not player.ended
    assert taken_s(player, 2.5) == [2.5] and player.ended


def test_at_double_speed_a_message_is_due_in_half_the_time() -> None:
    player = player_of(at(0.0, 1.0), speed=2.0)
    assert taken_s(player, 0.49) == [0.0]
    assert player.wait_s(now(0.25)) == pytest.approx(0.25)
    assert taken_s(player, 0.5) == [1.0]
    assert player.position_ns(now(0.5)) == SECOND_NS


def test_a_part_of_a_flight_starts_at_once() -> None:
    player = player_of(at(4.0, 5.0), 4.0, 6.0)
    assert taken_s(player, 0.0) == [4.0]
    assert player.position_ns(now(0.5)) == int(4.5 * SECOND_NS)
    assert taken_s(player, 1.0) == [5.0] and player.ended
    assert player.position_ns(now(99.0)) == 6 * SECOND_NS


def test_a_loop_begins_again_when_the_part_is_over() -> None:
    player = player_of(at(4.0, 5.0), 4.0, 6.0, loop=True)
    assert [*taken_s(player, 0.0), *taken_s(player, 1.0), *taken_s(player, 1.9)] == [4.0, 5.0]
    assert player.position_ns(now(1.9)) == int(5.9 * SECOND_NS)
    assert taken_s(player, 2.0) == [4.0]
    assert player.position_ns(now(2.5)) == int(4.5 * SECOND_NS)
    assert taken_s(player, 3.0) == [5.0] and not player.ended


def test_a_loop_of_one_message_repeats_it_no_faster_than_the_clock_is_published() -> None:
    player = player_of(at(4.0), 4.0, 4.0, loop=True)
    assert taken_s(player, 0.0) == [4.0]
    assert player.wait_s(now(0.0)) == pytest.approx(STEP_NS / SECOND_NS)


def test_a_part_without_messages_ends_at_once_also_in_a_loop() -> None:
    assert player_of([], loop=True).ended
    assert player_of([]).take(now(5.0)) is None


def test_nothing_is_due_in_a_pause_and_the_rest_follows_after_it() -> None:
    player = player_of(at(0.0, 1.0, 2.0))
    assert taken_s(player, 0.5) == [0.0]
    player.pause(now(0.5))
    assert player.wait_s(now(3.0)) is None
    assert taken_s(player, 60.0) == []
    assert player.position_ns(now(60.0)) == SECOND_NS // 2
    player.resume(now(60.0))
    assert taken_s(player, 60.4) == []
    assert taken_s(player, 60.5) == [1.0]


def test_a_step_plays_a_tenth_of_a_second_and_pauses() -> None:
    player = player_of(at(0.0, 0.02, 0.1, 0.12, 0.2))
    assert taken_s(player, 0.0) == [0.0]
    player.step(now(0.0))
    assert player.paused and taken_s(player, 0.0) == [0.02, 0.1]
    player.step(now(5.0))
    assert taken_s(player, 5.0) == [0.12, 0.2] and player.ended


def test_a_step_over_a_gap_plays_the_next_messages() -> None:
    player = player_of(at(0.0, 3.0, 3.0, 3.5))
    assert taken_s(player, 0.0) == [0.0]
    player.step(now(1.0))
    assert taken_s(player, 1.0) == [3.0, 3.0]
    assert player.position_ns(now(9.0)) == 3 * SECOND_NS


def test_a_step_at_the_end_does_nothing() -> None:
    player = player_of(at(0.0))
    assert taken_s(player, 0.0) == [0.0]
    player.step(now(0.0))
    assert player.ended and taken_s(player, 1.0) == []


def test_a_player_that_was_stopped_does_not_catch_up() -> None:
    player = player_of(at(0.0, 1.0, 2.0, 3.0))
    assert taken_s(player, 0.0) == [0.0]
    assert taken_s(player, 9.0) == [1.0]
    assert taken_s(player, 9.9) == []
    assert taken_s(player, 10.0) == [2.0]


def test_a_player_that_is_a_little_late_catches_up() -> None:
    player = player_of(at(0.0, 0.1, 0.2, 0.3))
    assert taken_s(player, 0.25) == [0.0, 0.1, 0.2]
    assert taken_s(player, 0.3) == [0.3]


def test_what_the_recorder_made_or_the_bus_has_itself_is_not_published() -> None:
    for channel in ("journal/go_to", "viewer/scene", HEADERS, "health/router", "/tf"):
        assert not is_published(channel), channel
    for channel in ("odometry", "clock", "sensor/camera", "health/estimator", "action/go_to/feedback"):
        assert is_published(channel), channel


def test_no_channel_of_a_request_is_published() -> None:
    for endpoint in topics.ENDPOINTS:
        assert not is_published(endpoint.name), endpoint.name


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Two seconds of odometry with the scene for viewers, images, a journal, and the router's health."""
    path = tmp_path / "flight.mcap"
    health = ServiceHealth(t_ns=0, service="router", boot_id=1, state="ok", text="")
    part = JournalPart(t_ns=0, service="go_to", boot_id=1, number=0)
    scene = ViewerScene(VehicleConfig())
    with RecordingWriter(path, {}, image_format=ImageFormat("png"), scene=scene) as writer:
        for tenth in range(20):
            t_ns = tenth * SECOND_NS // 10
            writer.write(t_ns, topics.ODOMETRY.name, encode(ODOMETRY))
            writer.write(t_ns, topics.CAMERA.name, encode(an_image(tenth)))
            writer.write(t_ns, topics.journal_of("go_to").name, encode(part))
            writer.write(t_ns, topics.health_of("router").name, encode(health))
    return path


def an_image(sequence: int) -> CameraFrame:
    return CameraFrame(
        t_ns=sequence,
        sequence=sequence,
        width_px=2,
        height_px=1,
        pitch_camera_rad=0.0,
        exposure_s=0.0,
        pixels=bytes(range(sequence, sequence + 6)),
    )


def chosen(path: Path, *wanted: str) -> frozenset[str]:
    return choose_topics(path, open_recording(path).summary().counts, wanted)


def test_a_recording_gives_the_topics_that_were_on_the_bus(recording: Path) -> None:
    assert chosen(recording) == {"odometry", "sensor/camera"}
    assert chosen(recording, "odometry") == {"odometry"}


@pytest.mark.parametrize("wanted", ["truth", "journal/go_to", "viewer/scene", "sensor/camera/header", ""])
def test_a_topic_that_cannot_be_replayed_is_named_with_those_that_can(recording: Path, wanted: str) -> None:
    with pytest.raises(RecordingError, match=rf"no topic '{wanted}' .*; its topics: odometry, sensor/camera"):
        chosen(recording, "odometry", wanted)


def test_a_recording_without_any_topic_is_refused(recording: Path) -> None:
    with pytest.raises(RecordingError, match="no messages of jezero's topics"):
        choose_topics(recording, ["/tf", "journal/go_to"], [])


def test_messages_are_read_byte_by_byte_and_with_their_times(tmp_path: Path) -> None:
    path = record(tmp_path / "flight.mcap")
    read = list(replay_messages(path, {"odometry", "clock"}))
    assert [message.data for message in read if message.topic == "odometry"] == [encode(ODOMETRY)] * 3
    assert [message.at_ns for message in read if message.topic == "odometry"] == [
        SECOND_NS // 2 * halves for halves in (1, 3, 5)
    ]
    assert {message.topic for message in read} == {"odometry", "clock"}


def test_the_ends_of_a_part_belong_to_it(tmp_path: Path) -> None:
    path = record(tmp_path / "flight.mcap")
    part = list(replay_messages(path, {"sensor/altimeter"}, SECOND_NS, 2 * SECOND_NS))
    assert [message.at_ns for message in part] == [SECOND_NS + tenth * SECOND_NS // 10 for tenth in range(11)]


def test_an_image_is_read_with_its_own_header(recording: Path) -> None:
    images: Iterator[ReplayMessage] = replay_messages(recording, {"sensor/camera"}, SECOND_NS)
    for sequence, image in enumerate(images, 10):
        assert f'"sequence":{sequence},'.encode() in image.data and b"png" in image.image


def test_what_clients_and_goals_publish_counts_as_commands() -> None:
    assert {topic.name for topic in topics.TOPICS if topic.writer in (CLIENTS, GOAL_IN_CHARGE)} <= COMMANDS
