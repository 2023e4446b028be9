"""Services that run again on their recorded inputs."""

from collections.abc import Callable
from pathlib import Path

import pytest

from jezero.recording import RecordingError
from jezero.recording.images import ImageFormat
from jezero.recording.mcap_file import McapFile, RawMessage
from jezero.recording.writer import RecordingWriter
from jezero.replay.errors import relative_errors
from jezero.replay.rebuild import SettingError
from jezero.replay.through import replay_through
from jezero.schemas.actions import Accepted, Rejected
from jezero.schemas.topics import RELATIVE, journal_of
from tests.replay.rig import STANDING_S, record_standing, record_takeoff

pytestmark = pytest.mark.xdist_group("replay through")
"""One worker makes the recordings, once."""

ESTIMATOR_JOURNAL = journal_of("estimator").name


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("takeoff") / "flight.mcap"
    refused, accepted = record_takeoff(path)
    assert isinstance(refused.replies[0], Rejected) and isinstance(accepted.replies[0], Accepted)
    return path


def copy(source: Path, target: Path, keep: Callable[[int, RawMessage], bool]) -> Path:
    """Copy those messages of a recording that `keep(index, message)` accepts."""
    file = McapFile(source)
    with RecordingWriter(target, {}, schemas=file.schemas) as writer:
        for index, message in enumerate(file.messages()):
            if keep(index, message):
                writer.write(message.logged_ns, message.topic, message.data)
    return target


def test_a_changed_setting_changes_the_output_and_the_errors(recording: Path) -> None:
    replay = replay_through(recording, "estimator", {"std_uwb_m": "0.05"})
    assert not replay.identical
    assert replay.first_difference is not None
    assert replay.first_difference.recorded.startswith("estimate/")
    errors = relative_errors(replay.published_before, replay.published, replay.files)
    assert errors is not None
    before, after = errors
    assert before.compared == after.compared > 100
    assert 0.0 < before.rms_3d_m < 1.0 and after.rms_3d_m != before.rms_3d_m


def test_the_first_difference_names_only_the_fields_that_differ(recording: Path) -> None:
    replay = replay_through(recording, "estimator", {"std_uwb_m": "0.05"})
    difference = replay.first_difference
    assert difference is not None and difference.recorded != difference.replayed
    assert "t_ns" not in difference.recorded


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"std_uwb": "0.1"}, "there is no setting 'std_uwb'; did you mean 'std_uwb_m'? Known are "),
        ({"zebra": "0.1"}, "there is no setting 'zebra'; known are "),
        ({"std_uwb_m": "ten"}, "std_uwb_m=ten: 'ten' is no value of TOML"),
        ({"std_uwb_m": "-1.0"}, "estimator: tuning.std_uwb_m: expected a number from 0.001"),
        ({"std_uwb_m": '"a"'}, "estimator: tuning.std_uwb_m: expected a number, not a text"),
        ({"range_max_m": "1.0"}, "range_max_m is the name of several settings: give one of "),
    ],
)
def test_a_wrong_setting_is_named(recording: Path, changes: dict[str, str], sentence: str) -> None:
    with pytest.raises(SettingError) as error:
        replay_through(recording, "estimator", changes)
    assert str(error.value).startswith(sentence)


def test_a_service_without_a_journal_is_refused_with_those_that_have_one(recording: Path) -> None:
    with pytest.raises(RecordingError, match=r"no journal of 'estimater'; services with a journal: area_coverage,.*"):
        replay_through(recording, "estimater")


def test_a_replay_ends_where_the_journal_has_a_gap(recording: Path, tmp_path: Path) -> None:
    parts = [i for i, message in enumerate(McapFile(recording).messages()) if message.topic == ESTIMATOR_JOURNAL]
    missing = parts[len(parts) // 2]
    path = copy(recording, tmp_path / "gap.mcap", lambda index, message: index != missing)
    whole, replay = replay_through(recording, "estimator"), replay_through(path, "estimator")
    assert replay.identical
    assert replay.gap_s is not None and 0.0 < replay.gap_s < 2 * STANDING_S
    assert 0 < replay.steps < whole.steps


def test_a_recording_without_the_start_of_the_service_is_refused(recording: Path, tmp_path: Path) -> None:
    first = next(i for i, message in enumerate(McapFile(recording).messages()) if message.topic == ESTIMATOR_JOURNAL)
    path = copy(recording, tmp_path / "late.mcap", lambda index, message: index > first)
    with pytest.raises(RecordingError, match=r"begins after the start of 'estimator'.*begins with the stack"):
        replay_through(path, "estimator")


def test_a_service_is_replayed_over_the_files_of_a_recording_that_went_on_in_a_new_file(
    recording: Path, tmp_path: Path
) -> None:
    middle = sum(1 for _ in McapFile(recording).messages()) // 2
    copy(recording, tmp_path / "2026-01-01_00-00-00.mcap", lambda index, message: index < middle)
    second = copy(recording, tmp_path / "2026-01-01_00-10-00.mcap", lambda index, message: index >= middle)
    whole, replay = replay_through(recording, "estimator"), replay_through(second, "estimator")
    assert replay.identical and len(replay.files) == 2
    assert (replay.steps, replay.outputs) == (whole.steps, whole.outputs)
    assert sum(topic == RELATIVE.name for topic, _ in replay.published) > 100


def test_images_that_jpeg_has_changed_are_counted(tmp_path: Path) -> None:
    record_standing(tmp_path / "a.mcap", ImageFormat("jpeg"), "rendered")
    assert replay_through(tmp_path / "a.mcap", "tag_detector").lossy_images > 10


def test_a_service_that_read_images_is_not_replayed_without_them(tmp_path: Path) -> None:
    record_standing(tmp_path / "a.mcap", None, "rendered")
    with pytest.raises(RecordingError, match=r"replay a recording with images \(`images` in recorder.toml\)"):
        replay_through(tmp_path / "a.mcap", "tag_detector")
    assert replay_through(tmp_path / "a.mcap", "vehicle_bridge").identical
