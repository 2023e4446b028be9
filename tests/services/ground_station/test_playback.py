"""Looking back: the state at a time of a recording does not depend on the way there."""

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jezero.base.codec import encode
from jezero.recording import RecordingError
from jezero.recording.images import ImageFormat
from jezero.recording.writer import RecordingWriter
from jezero.schemas import topics
from jezero.schemas.sensors import Altimeter, CameraFrame
from jezero.schemas.state import StatusCode
from jezero.services.ground_station.playback import KEYFRAME_PERIOD_S, Playback, RecordedFlight, TimedMessage
from jezero.services.ground_station.state import ShownState
from tests.services.ground_station.messages import Flight, health

SECOND_NS = 1_000_000_000
SECONDS = 60
AIRBORNE = range(10, 50)
"""Seconds in which the vehicle is armed."""


def _frame(t_ns: int, brightness: int) -> CameraFrame:
    pixels = np.full((8, 8, 3), brightness, np.uint8).tobytes()
    return CameraFrame(
        t_ns=t_ns, sequence=0, width_px=8, height_px=8, pitch_camera_rad=0.0, exposure_s=0.01, pixels=pixels
    )


def record(path: Path) -> Path:
    """Write a flight to the north: each second 10 statuses, 10 heights and a health; until half of it, a picture."""
    with RecordingWriter(path, {"vehicle": "uav1"}, image_format=ImageFormat("png")) as writer:
        for tenth in range(10 * SECONDS):
            t_ns, second = tenth * SECOND_NS // 10, tenth // 10
            armed = second in AIRBORNE
            code = StatusCode.HOVER if armed else StatusCode.IDLE
            status = Flight((0.1 * tenth, 0.0, -1.0)).status(t_ns=t_ns, armed=armed, code=code, landed=not armed)
            writer.write(t_ns, topics.STATUS.name, encode(status))
            writer.write(t_ns, topics.ALTIMETER.name, encode(Altimeter(t_ns=t_ns, range_m=0.1 * tenth)))
            if tenth % 10 == 0:
                writer.write(t_ns, "health/estimator", encode(health(text=f"second {second}")))
            if tenth % 10 == 0 and second < SECONDS // 2:
                writer.write(t_ns, topics.CAMERA.name, encode(_frame(t_ns, second)))
    return path


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> RecordedFlight:
    """The flight, indexed."""
    indexed = RecordedFlight(record(tmp_path_factory.mktemp("run") / "flight.mcap"))
    indexed.index()
    return indexed


def shown(playback: Playback) -> list[Any]:
    """All that the pages show at the playback's time."""
    state, now_s = playback.state, playback.t_s
    return [
        state.status_line(now_s, ""),
        state.readings(now_s),
        state.services(now_s),
        state.event_rows(now_s),
        state.scene(now_s),
        state.trail(),
        playback.picture,
    ]


def test_the_index_knows_the_length_the_events_and_a_keyframe_every_few_seconds(flight: RecordedFlight) -> None:
    assert flight.duration_s == pytest.approx(SECONDS - 0.1)
    assert [event.text for event in flight.events if event.text.startswith("Motors")] == ["Motors on", "Motors off"]
    assert [event.t_s for event in flight.events if event.text == "Motors on"] == [pytest.approx(10.0)]
    times_s = [keyframe.t_s for keyframe in flight.keyframes]
    assert times_s[0] == 0.0
    assert max(np.diff(times_s)) <= KEYFRAME_PERIOD_S + 1.1  # a chunk lasts a second
    assert flight.problem == ""


def test_the_state_after_any_jumps_is_the_state_after_playing_from_the_start(flight: RecordedFlight) -> None:
    played, expected = Playback(flight), {}
    for tenth in range(10 * SECONDS):
        played.move_to(tenth / 10)
        expected[tenth] = shown(played)
    jumping, rng = Playback(flight), random.Random(1)
    for tenth in (599, 0, 300, 299, 100, 99, *(rng.randrange(600) for _ in range(40))):
        jumping.move_to(tenth / 10)
        assert shown(jumping) == expected[tenth], tenth / 10


def test_the_picture_is_that_of_the_time_and_none_when_there_was_none_for_long(flight: RecordedFlight) -> None:
    playback = Playback(flight)
    for t_s, second in ((20.5, 20), (3.0, 3), (31.0, 29)):
        playback.move_to(t_s)
        assert playback.picture is not None
        assert playback.picture.t_s == second
        found = playback.picture.decoded()
        assert found is not None and found[0] == "png" and found[1].startswith(b"\x89PNG")
    playback.move_to(31.5)
    assert playback.picture is None


def test_a_jump_reads_a_bounded_part_of_the_file(flight: RecordedFlight, monkeypatch: pytest.MonkeyPatch) -> None:
    playback = Playback(flight)
    counted: list[TimedMessage] = []
    plain = RecordedFlight.update

    def update(self: RecordedFlight, state: ShownState, timed: TimedMessage) -> None:
        counted.append(timed)
        plain(self, state, timed)

    monkeypatch.setattr(RecordedFlight, "update", update)
    for t_s in (55.0, 5.0, 59.0):
        counted.clear()
        playback.move_to(t_s)
        assert len(counted) <= 22 * (KEYFRAME_PERIOD_S + 4.0)  # of 22 messages a second


def test_times_outside_the_recording_are_its_start_and_its_end(flight: RecordedFlight) -> None:
    playback = Playback(flight)
    playback.move_to(1e9)
    assert playback.t_s == flight.duration_s
    playback.move_to(-5.0)
    assert playback.t_s == 0.0
    assert "On the ground" in playback.state.status_line(0.0, "")["words"]


def test_a_file_that_is_cut_is_shown_to_its_end_with_a_sentence(flight: RecordedFlight, tmp_path: Path) -> None:
    file = tmp_path / "cut.mcap"
    data = flight.path.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    cut = RecordedFlight(file)
    cut.index()
    assert "not finished" in cut.problem
    playback = Playback(cut)
    playback.move_to(cut.duration_s)
    assert 5.0 < playback.t_s < SECONDS - 5.0


def test_what_is_no_recording_gets_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "notes.mcap").write_text("no recording")
    with pytest.raises(RecordingError, match="is no recording"):
        RecordedFlight(tmp_path / "notes.mcap").index()


def test_messages_of_another_version_are_left_out_and_counted(tmp_path: Path) -> None:
    file = tmp_path / "old.mcap"
    with RecordingWriter(file, {}) as writer:
        writer.write(0, topics.STATUS.name, b'{"of_another": "version"}')
        writer.write(1, topics.ALTIMETER.name, encode(Altimeter(t_ns=1, range_m=2.0)))
    old = RecordedFlight(file)
    old.index()
    assert old.problem.startswith("1 messages of another version")
    assert "No vehicle" in Playback(old).state.status_line(0.0, "")["words"]
