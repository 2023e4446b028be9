"""`jezero replay --through`."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from jezero.base.config import load_config
from jezero.cli.main import main
from jezero.services.estimator.config import EstimatorConfig
from tests.replay.rig import SEED, record_takeoff

pytestmark = pytest.mark.xdist_group("replay through")
"""One worker makes the recordings, once."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("takeoff") / "flight.mcap"
    record_takeoff(path)
    return path


def replay(path: Path, *words: str) -> Result:
    return CliRunner().invoke(main, ["replay", str(path), "--through", *words])


@pytest.mark.long
def test_a_replay_without_changes_is_identical_and_succeeds(recording: Path) -> None:
    done = replay(recording, "vehicle_bridge")
    assert done.exit_code == 0
    assert "identical: all outputs are bit by bit the recorded ones" in done.stdout


def test_a_changed_estimator_shows_its_errors_beside_the_recorded_ones(recording: Path) -> None:
    done = replay(recording, "estimator", "--set", "std_uwb_m=0.05")
    assert done.exit_code == 0
    assert "different: the outputs of " in done.stdout
    assert [line.split()[0] for line in done.stdout.splitlines()[-2:]] == ["recorded", "replayed"]


def test_json_says_whether_the_output_is_identical_and_what_the_errors_are(recording: Path) -> None:
    found = json.loads(replay(recording, "estimator", "--set", "std_uwb_m=0.05", "--json").stdout)
    assert found["identical"] is False and found["first_difference"]["recorded"].startswith("estimate/")
    assert 0.0 < found["errors_recorded"]["rms_3d_m"] < 1.0
    assert 0.0 < found["errors_replayed"]["rms_3d_m"] < 1.0


def test_a_folder_of_a_run_stands_for_its_newest_recording(recording: Path) -> None:
    assert replay(recording.parent, "takeoff").exit_code == 0


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
        (("estimator", "--set", "std_uwb=0.1"), 1, "there is no setting 'std_uwb'; did you mean 'std_uwb_m'?"),
        (("estimator", "--set", "std_uwb_m=-1"), 1, "std_uwb_m: expected a number from 0.001"),
        (("estimator", "--set", "std_uwb_m"), 2, "give a setting and its value, such as --set std_uwb_m=0.05"),
    ],
)
def test_wrong_usage_is_one_sentence(recording: Path, words: tuple[str, ...], exit_code: int, sentence: str) -> None:
    done = replay(recording, *words)
    assert done.exit_code == exit_code
    assert sentence in done.stderr and "Traceback" not in done.output
