"""`jezero tune` on a flight in virtual time, and its refusals."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result

from jezero.cli.main import main
from jezero.recording import open_recording
from jezero.recording.writer import RECORDING
from jezero.trials.landing.flight import fly_landing
from jezero.trials.landing.trial import Conditions
from tests.recording.rig import record

pytestmark = [pytest.mark.long, pytest.mark.xdist_group("tune")]

TRUE_TOPICS = ("truth", "simulator/scene")


def tune(*words: str | Path) -> Result:
    result = CliRunner().invoke(main, ["tune", *map(str, words)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exc_info
    return result


def cut(source: Path, target: Path, *words: str) -> Path:
    result = CliRunner().invoke(main, ["recording", "cut", str(source), str(target), *words])
    assert result.exit_code == 0, result.output
    return target


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("landing")
    assert not fly_landing(2, Conditions(case="uwb+tag"), folder).failure
    (recording,) = folder.glob("*/*.mcap")
    return recording


def test_it_shows_each_sensor_and_settings_that_replay_takes(flight: Path, found: Any, tmp_path: Path) -> None:
    result = tune(flight, "--figure", tmp_path / "innovations.svg")
    assert result.exit_code == 0, result.output
    for label in ("UWB ranges", "tag, position", "altimeter", "rover, yaw", "autopilot, position"):
        assert label in result.stdout
    _, _, settings = result.stdout.partition("settings for deploy/config/estimator.toml:\n")
    toml, _, rest = settings.partition("to check them on a flight:\n")
    tuning = msgspec.toml.decode(toml)["tuning"]
    assert tuning and tuning == pytest.approx(found["recommended"])
    words = rest.partition("\nwrote ")[0].replace("\\\n", " ").split()
    replayed = CliRunner().invoke(main, words[1:])
    assert replayed.exit_code == 0, replayed.output
    for name, value in tuning.items():
        assert f"{name}={value:g}" in words
    assert "UWB ranges" in (tmp_path / "innovations.svg").read_text()


@pytest.fixture(scope="module")
def found(flight: Path) -> Any:
    """The JSON of a flight, which is given twice: by its file, and by its folder."""
    return json.loads(tune(flight, flight.parent, "--json").stdout)


def test_json_has_the_figures_of_each_sensor(flight: Path, found: Any) -> None:
    sensors = {each["sensor"]: each for each in found["sensors"]}
    altimeter = sensors["altimeter"]
    low, high = altimeter["in_use"]["nis_band"]
    assert low < 1.0 < high and altimeter["in_use"]["nis"] < low  # the shipped noise is larger than the simulator's
    assert low < altimeter["suggested"]["nis"] < high
    assert altimeter["suggestion"]["in_use"] == 0.035
    assert altimeter["suggestion"]["value"] == pytest.approx(0.025, rel=0.3)
    assert sensors["autopilot_position"]["suggestion"] is None
    assert found["settings"]["std_altimeter_m"] == altimeter["suggestion"]["value"]
    assert found["accuracy"]["rms_suggested_m"] > 0.0 and found["converged"]
    assert Path(found["figure"]) == flight.parent / "tuning.png"
    assert Path(found["figure"]).read_bytes().startswith(b"\x89PNG")


def test_it_recommends_what_has_the_least_error_of_all_that_it_has_tried(found: Any) -> None:
    alone = {each["suggestion"]["setting"]: each["suggestion"]["rms_alone_m"]
             for each in found["sensors"] if each["suggestion"] is not None}  # fmt: skip
    known = [rms_m for rms_m in alone.values() if rms_m is not None]
    assert known and set(found["recommended"]) <= set(found["settings"])
    assert found["rms_recommended_m"] < found["accuracy"]["rms_in_use_m"]
    assert found["rms_recommended_m"] <= min(*known, found["accuracy"]["rms_suggested_m"])


def test_the_same_recording_counts_once(flight: Path, found: Any) -> None:
    assert found["files"] == [str(flight)]


def test_a_recording_without_truth_gives_the_same_settings_without_errors(
    flight: Path, found: Any, tmp_path: Path
) -> None:
    kept = [topic for topic in open_recording(flight).summary().counts if topic not in TRUE_TOPICS]
    blind = cut(flight, tmp_path / RECORDING, *(word for topic in kept for word in ("--topic", topic)))
    result = tune(blind)
    assert result.exit_code == 0, result.output
    assert "no errors: the recordings have no truth" in result.stdout and "error alone" not in result.stdout
    for name, value in found["settings"].items():
        assert f"\n{name} = {value:g}\n" in result.stdout


def test_what_is_no_flight_is_refused_with_a_sentence(flight: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no recording")
    without_estimator = record(tmp_path / "hand.mcap")
    short = cut(flight, tmp_path / "short.mcap", "--to", "0.9")
    for file, text in (
        (tmp_path / "missing.mcap", "No such file"),
        (tmp_path / "notes.txt", "is no recording"),
        (without_estimator, "has no journal of 'estimator'"),
        (short, "give a longer recording"),
    ):
        result = tune(file)
        assert result.exit_code == 1
        assert text in result.stderr and len(result.stderr.strip().splitlines()) == 1
    assert tune().exit_code == 2


def test_a_figure_that_can_not_be_written_is_refused_before_the_flights_are_replayed(
    flight: Path, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    for figure, code, text in (
        (tmp_path / "innovations.txt", 2, "give a file that ends in .png, .pdf, .svg"),
        (tmp_path / "file" / "innovations.png", 1, "file"),
    ):
        result = tune(flight, "--figure", figure)
        assert result.exit_code == code and text in result.stderr and not result.stdout


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("std_uwb=0.1", "did you mean 'std_uwb_m'?"),
        ("std_uwb_m=-1", "std_uwb_m"),
        ("std_uwb_m", "give a setting and its value"),
    ],
)
def test_a_wrong_setting_is_refused_with_a_sentence(setting: str, text: str, flight: Path) -> None:
    result = tune(flight, "--set", setting)
    assert result.exit_code in (1, 2) and text in result.stderr
