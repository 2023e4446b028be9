"""Services that run again on their recorded inputs, by Python and by `jezero replay --through`."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from jezero.base.config import load_config
from jezero.cli.main import main
from jezero.recording import RecordingError
from jezero.recording.images import ImageFormat
from jezero.recording.mcap_file import McapFile, RawMessage
from jezero.recording.writer import RecordingWriter
from jezero.replay.rebuild import SettingError
from jezero.replay.through import Replay, replay_through
from jezero.schemas.actions import Accepted, Rejected
from jezero.schemas.topics import RELATIVE, journal_of
from jezero.services.estimator.config import EstimatorConfig
from tests.scenario.replay_rig import SEED, STANDING_S, record_standing, record_takeoff

pytestmark = pytest.mark.xdist_group("replay through")
"""One worker makes the recordings, once."""

ESTIMATOR_JOURNAL = journal_of("estimator").name


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("takeoff") / "flight.mcap"
    refused, accepted = record_takeoff(path)
    assert isinstance(refused.replies[0], Rejected) and isinstance(accepted.replies[0], Accepted)
    return path


@pytest.fixture(scope="module")
def whole(recording: Path) -> Replay:
    """The estimator of the whole recording."""
    return replay_through(recording, "estimator")


def copy(source: Path, target: Path, keep: Callable[[int, RawMessage], bool]) -> Path:
    """Copy those messages of a recording that `keep(index, message)` accepts."""
    file = McapFile(source)
    with RecordingWriter(target, {}, schemas=file.schemas) as writer:
        for index, message in enumerate(file.messages()):
            if keep(index, message):
                writer.write(message.logged_ns, message.topic, message.data)
    return target


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


def test_a_replay_ends_where_the_journal_has_a_gap(recording: Path, whole: Replay, tmp_path: Path) -> None:
    parts = [i for i, message in enumerate(McapFile(recording).messages()) if message.topic == ESTIMATOR_JOURNAL]
    missing = parts[len(parts) // 2]
    path = copy(recording, tmp_path / "gap.mcap", lambda index, message: index != missing)
    replay = replay_through(path, "estimator")
    assert replay.identical
    assert replay.gap_s is not None and 0.0 < replay.gap_s < 2 * STANDING_S
    assert 0 < replay.steps < whole.steps


def test_a_recording_without_the_start_of_the_service_is_refused(recording: Path, tmp_path: Path) -> None:
    first = next(i for i, message in enumerate(McapFile(recording).messages()) if message.topic == ESTIMATOR_JOURNAL)
    path = copy(recording, tmp_path / "late.mcap", lambda index, message: index > first)
    with pytest.raises(RecordingError, match=r"begins after the start of 'estimator'.*begins with the stack"):
        replay_through(path, "estimator")


def test_a_service_is_replayed_over_the_files_of_a_recording_that_went_on_in_a_new_file(
    recording: Path, whole: Replay, tmp_path: Path
) -> None:
    middle = sum(1 for _ in McapFile(recording).messages()) // 2
    copy(recording, tmp_path / "2026-01-01_00-00-00.mcap", lambda index, message: index < middle)
    second = copy(recording, tmp_path / "2026-01-01_00-10-00.mcap", lambda index, message: index >= middle)
    replay = replay_through(second, "estimator")
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


def replay(path: Path, *words: str) -> Result:
    return CliRunner().invoke(main, ["replay", str(path), "--through", *words])


def test_a_changed_estimator_shows_its_errors_beside_the_recorded_ones(recording: Path) -> None:
    done = replay(recording, "estimator", "--set", "std_uwb_m=0.05")
    assert done.exit_code == 0
    assert "different: the outputs of " in done.stdout
    assert [line.split()[0] for line in done.stdout.splitlines()[-2:]] == ["recorded", "replayed"]


def test_json_says_whether_the_output_is_identical_and_what_the_errors_are(recording: Path) -> None:
    found = json.loads(replay(recording, "estimator", "--set", "std_uwb_m=0.05", "--json").stdout)
    assert found["identical"] is False and found["first_difference"]["recorded"].startswith("estimate/")
    before, after = found["errors_recorded"], found["errors_replayed"]
    assert before["compared"] == after["compared"] > 100
    assert 0.0 < before["rms_3d_m"] < 1.0 and after["rms_3d_m"] != before["rms_3d_m"]


def test_a_replay_without_changes_is_identical_and_succeeds(recording: Path) -> None:
    """The folder of a run stands for its newest recording."""
    done = replay(recording.parent, "takeoff")
    assert done.exit_code == 0
    assert "identical: all outputs are bit by bit the recorded ones" in done.stdout


def test_a_recording_shows_every_setting_in_force(recording: Path) -> None:
    done = CliRunner().invoke(main, ["recording", "settings", str(recording), "--json"])
    settings = json.loads(done.stdout)
    defaults = load_config(EstimatorConfig, "estimator")
    assert settings["estimator"]["config.tuning.std_uwb_m"] == defaults.tuning.std_uwb_m
    assert settings["simulator"]["seed"] == SEED
    lines = CliRunner().invoke(main, ["recording", "settings", str(recording)]).stdout.splitlines()
    assert f"  config.tuning.std_uwb_m = {defaults.tuning.std_uwb_m}" in lines


@pytest.mark.parametrize(
    ("words", "exit_code", "sentence"),
    [
        (("estimater",), 1, "has no journal of 'estimater'; services with a journal: "),
        (("estimator", "--set", "std_uwb_m"), 2, "give a setting and its value, such as --set std_uwb_m=0.05"),
    ],
)
def test_wrong_usage_is_one_sentence(recording: Path, words: tuple[str, ...], exit_code: int, sentence: str) -> None:
    done = replay(recording, *words)
    assert done.exit_code == exit_code
    assert sentence in done.stderr and "Traceback" not in done.output
