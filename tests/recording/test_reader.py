"""Reading recordings: messages, tables, parts, and files that are damaged in every way."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from jezero.base.codec import encode
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording import RecordingError, open_recording
from jezero.recording.editing import cut, repair
from jezero.recording.export import write_csv
from jezero.recording.viewer_scene import ViewerScene
from jezero.recording.writer import RecordingWriter
from jezero.schemas import topics
from jezero.schemas.sensors import Altimeter
from tests.client.rig import ODOMETRY
from tests.recording.rig import SECOND_NS, record


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("run") / "flight.mcap")


def test_messages_are_typed_and_can_be_chosen_by_topic_and_time(path: Path) -> None:
    with open_recording(path.parent) as recording:
        ranges = [entry.message for entry in recording.messages(topics.ALTIMETER, start_s=0.95, end_s=1.2)]
        assert [entry.topic for entry in recording.messages("clock", "status")] == ["clock", "status"] * 3
    assert all(isinstance(message, Altimeter) for message in ranges)
    assert [message.t_ns for message in ranges] == [1_000_000_000, 1_100_000_000, 1_200_000_000]


def test_a_summary_counts_messages_and_says_where_the_flight_is_from(path: Path) -> None:
    summary = open_recording(path).summary()
    assert summary.counts == {"clock": 3, "odometry": 3, "sensor/altimeter": 30, "status": 3}
    assert summary.about["vehicle"] == "uav1"
    assert summary.duration_s == pytest.approx(2.9)
    assert summary.problem == ""


def test_a_table_has_an_array_for_each_field_and_nan_for_what_is_missing(path: Path) -> None:
    recording = open_recording(path)
    range_m = recording.table(topics.ALTIMETER)["range_m"]
    assert np.isnan(range_m[0]) and range_m[1:4] == pytest.approx([0.1, 0.2, 0.3])
    odometry = recording.table("odometry")
    assert odometry["pos_uav_ned_m"].tolist() == [[1.0, 2.0, -2.0]] * 3
    flat = dict(odometry.flat())
    assert flat["pos_uav_ned_m.d"].tolist() == [-2.0] * 3
    assert flat["q_ned_from_frd.w"].tolist() == [1.0] * 3
    assert recording.table("status")["odometry.pos_uav_ned_m"].shape == (3, 3)


def test_a_table_is_a_data_frame_where_pandas_is_installed(path: Path) -> None:
    frame = open_recording(path).table("odometry").to_pandas()
    assert frame["pos_uav_ned_m.d"].tolist() == [-2.0] * 3
    assert len(open_recording(path).table("status").to_pandas()) == 3


def test_a_topic_that_was_not_recorded_is_named_with_those_that_were(path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no message of 'truth' .*sensor/altimeter"):
        open_recording(path).table("truth")


def test_a_csv_file_for_each_topic(path: Path, tmp_path: Path) -> None:
    written = dict(write_csv(open_recording(path), tmp_path / "tables"))
    assert written[tmp_path / "tables" / "sensor-altimeter.csv"] == 30
    head, first, *_ = (tmp_path / "tables" / "odometry.csv").read_text().splitlines()
    row = dict(zip(head.split(","), first.split(","), strict=True))
    assert row["pos_uav_ned_m.e"] == "2.0" and row["t_ns"] == "9"


def test_a_part_keeps_times_topics_and_origin(path: Path, tmp_path: Path) -> None:
    target = tmp_path / "part.mcap"
    assert cut(path, target, 1.0, 2.0, ["sensor/altimeter"]) == 11
    summary = open_recording(target).summary()
    assert summary.counts == {"sensor/altimeter": 11}
    assert (summary.start_ns, summary.about["vehicle"]) == (1_000_000_000, "uav1")
    with pytest.raises(RecordingError, match="is the recording itself"):
        cut(path, path, 0.0, None, ())


def test_a_part_has_the_scene_for_viewers_that_the_recording_had(tmp_path: Path) -> None:
    flight, part = tmp_path / "flight.mcap", tmp_path / "part.mcap"
    with RecordingWriter(flight, {}, scene=ViewerScene(VehicleConfig())) as writer:
        for tenth in range(30):
            writer.write(tenth * SECOND_NS // 10, topics.ODOMETRY.name, encode(ODOMETRY))
    assert cut(flight, part, 1.0, 2.0, ()) > 0
    assert open_recording(part).summary().counts == {"odometry": 11, "viewer/scene": 2, "viewer/transforms": 11}
    assert open_recording(part).summary().schemas["viewer/scene"] == "foxglove.SceneUpdate"


def test_a_killed_process_loses_the_open_chunk_only_and_repair_finishes_the_file(path: Path, tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    writer = RecordingWriter(torn, {"vehicle": "uav7"})
    for entry in open_recording(path).messages(topics.ALTIMETER):
        writer.write(entry.logged_ns, entry.topic, b'{"t_ns":%d,"range_m":1.0}' % entry.message.t_ns)
    summary = open_recording(torn).summary()
    assert summary.counts == {"sensor/altimeter": 20}
    assert summary.problem == "it was not finished"
    assert repair(torn) == (20, "it was not finished")
    assert open_recording(torn).summary().problem == ""
    assert open_recording(torn).summary().about == {"vehicle": "uav7"}
    assert (tmp_path / "torn.mcap.damaged").exists()
    assert repair(torn) == (20, "")
    writer.close()


@pytest.mark.parametrize("behind", [bytes(4096), bytes(1), b"x" * 100, b"\x89MCAP0\r\n"])
def test_repair_takes_away_what_stands_after_the_end_so_that_mcap_readers_open_the_file(
    behind: bytes, path: Path, tmp_path: Path
) -> None:
    whole = path.read_bytes()
    file = tmp_path / "flight.mcap"
    file.write_bytes(whole + behind)
    count = sum(open_recording(path).summary().counts.values())
    assert open_recording(file).summary().problem == "it has bytes after its end"
    assert repair(file) == (count, "it has bytes after its end")
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None and summary.statistics is not None and summary.statistics.message_count == count
    assert repair(file) == (count, "")
    assert (tmp_path / "flight.mcap.damaged").read_bytes() == whole + behind


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
def test_a_file_that_was_cut_and_filled_with_zeros_is_finished(share: float, path: Path, tmp_path: Path) -> None:
    whole = path.read_bytes()
    file = tmp_path / "flight.mcap"
    file.write_bytes(whole[: int(share * len(whole))] + bytes(len(whole)))
    count, problem = repair(file)
    assert problem and repair(file) == (count, "")
    with file.open("rb") as stream:
        assert make_reader(stream).get_summary() is not None


def test_a_recording_of_an_older_version_gets_the_defaults_of_new_fields(tmp_path: Path) -> None:
    path = tmp_path / "old.mcap"
    with RecordingWriter(path, {}) as writer:
        writer.write(1, "sensor/altimeter", b'{"t_ns":1,"range_m":2.5}')
        writer.write(2, "removed/topic", b'{"t_ns":1}')
    (entry,) = open_recording(path).messages()
    assert entry.message == Altimeter(t_ns=1, range_m=2.5)


def test_a_message_that_this_version_does_not_know_is_named(tmp_path: Path) -> None:
    path = tmp_path / "new.mcap"
    with RecordingWriter(path, {}) as writer:
        writer.write(1, "sensor/altimeter", b'{"t_ns":1,"range_m":2.5,"colour":"red"}')
    with pytest.raises(RecordingError, match=r"sensor/altimeter does not fit this version .*`colour`"):
        list(open_recording(path).messages())


def test_files_that_are_no_recordings_are_refused_with_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "text.mcap").write_text("t_ns,range_m\n1,2\n")
    (tmp_path / "folder.mcap").mkdir()
    for name in ("empty.mcap", "text.mcap"):
        with pytest.raises(RecordingError, match=rf"{name} is no recording"):
            open_recording(tmp_path / name)
    with pytest.raises(
        RecordingError, match=r"folder\.mcap has no recording: a run's folder has flight\.mcap, or recordings/\*\.mcap"
    ):
        open_recording(tmp_path / "folder.mcap")
    with pytest.raises(RecordingError, match=r"nothing\.mcap: No such file"):
        open_recording(tmp_path / "nothing.mcap")


def test_a_recording_of_another_program_has_no_messages_of_ours(tmp_path: Path) -> None:
    path = tmp_path / "ros.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        channel = writer.register_channel(
            "/tf", "cdr", writer.register_schema("tf2_msgs/msg/TFMessage", "ros2msg", b"")
        )
        writer.add_message(channel, 1, b"\x00\x01\x02", 1)
        writer.finish()  # type: ignore[no-untyped-call]
    recording = open_recording(path)
    assert list(recording.messages()) == []
    assert recording.summary().counts == {"/tf": 1}


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_file_that_is_cut_or_has_wrong_bytes_is_read_to_there_or_refused(
    path: Path, tmp_path: Path, data: st.DataObject
) -> None:
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(0, 3), "number of wrong bytes")):
        content[data.draw(st.integers(0, len(content) - 1), "place")] ^= data.draw(st.integers(1, 255), "bits")
    length = data.draw(st.one_of(st.just(len(content)), st.integers(0, len(content))), "length")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content[:length])
    try:
        recording = open_recording(damaged)
        summary = recording.summary()
        assert sum(summary.counts.values()) <= 39
        assert len(list(recording.messages())) <= 39
        repair(damaged)
        assert open_recording(damaged).summary().problem == ""
    except RecordingError as error:
        assert "damaged.mcap" in str(error)
