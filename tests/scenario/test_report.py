"""The figures of a flight in virtual time, and the data that they show."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from jezero.cli.main import main
from jezero.recording import open_recording
from jezero.recording.folder import RECORDINGS
from jezero.recording.writer import RECORDING, RecordingWriter
from jezero.report.landings import RecordedLanding, Series, landings
from jezero.trials.flight import FlightResult, fly_virtually
from jezero.trials.missions import FLIGHT

pytestmark = pytest.mark.xdist_group("report")

TRUE_TOPICS = ("truth", "simulator/scene")
BENCHMARK = {"case": "tag", "rover": "turn", "n": 3, "landed": 2, "touchdowns_m": [[0.01, -0.02], [0.0, 0.03]]}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FlightResult]:
    folder = tmp_path_factory.mktemp("run")
    return folder, fly_virtually(FLIGHT, 3, folder / RECORDING)


@pytest.fixture(scope="module")
def landing(flown: tuple[Path, FlightResult]) -> RecordedLanding:
    (landing,) = landings(list(open_recording(flown[0]).messages()))
    return landing


def report(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["report", *map(str, words)])


def rms_m(landing: RecordedLanding, measured: Series) -> float:
    error_m = measured.values - landing.true_relative.at(measured.t_s)
    return float(np.sqrt(np.mean(np.sum(error_m**2, axis=1))))


@pytest.mark.long
def test_the_demonstration_lands_on_the_rover_and_a_report_draws_it(flown: tuple[Path, FlightResult]) -> None:
    folder, flight = flown
    assert flight.result == "succeeded", flight.reason
    assert flight.touchdown_error_m is not None and flight.touchdown_error_m < 0.1
    result = report(folder)
    assert result.exit_code == 0, result.output
    assert {path.stem for path in folder.glob("*.png")} == {
        "position", "status", "relative_position", "relative_error", "rover_position", "uwb_tag", "touchdown",
    }  # fmt: skip


@pytest.mark.long
def test_a_landing_is_read_from_its_log(flown: tuple[Path, FlightResult], landing: RecordedLanding) -> None:
    assert [name for name, _, _ in landing.phases] == ["approach", "descent", "contact"]
    assert landing.phases[0][1] == 0.0
    assert landing.phases[-1][2] == landing.disarmed_s
    assert landing.by_estimate and landing.valid.mean() > 0.9
    assert landing.touchdown_rover_body_m is not None
    assert np.hypot(*landing.touchdown_rover_body_m) == pytest.approx(flown[1].touchdown_error_m, abs=1e-3)


def test_estimate_ranges_and_tag_measure_the_same_point_as_the_truth(landing: RecordedLanding) -> None:
    low = landing.true_relative.at(landing.tag.t_s)[:, 2] > -2.0
    assert rms_m(landing, landing.tag.where(low)) < 0.03
    low = landing.true_relative.at(landing.uwb.t_s)[:, 2] > -2.0
    assert rms_m(landing, landing.uwb.where(low)) < 0.08
    low = landing.true_relative.at(landing.relative.t_s)[:, 2] > -2.0
    assert rms_m(landing, landing.relative.where(low)) < 0.03


def test_the_touchdowns_of_a_benchmark_are_drawn_beside_its_file(tmp_path: Path) -> None:
    file = tmp_path / "landings.jsonl"
    file.write_text(f"{json.dumps(BENCHMARK)}\n{json.dumps({**BENCHMARK, 'case': 'none', 'touchdowns_m': []})}\n")
    result = report(file)
    assert result.exit_code == 0, result.output
    assert (tmp_path / "touchdowns.png").read_bytes().startswith(b"\x89PNG")


def test_a_folder_or_file_without_a_flight_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert (
        "empty has no recording: a run's folder has flight.mcap, or recordings/*.mcap"
        in report(tmp_path / "empty").output
    )
    RecordingWriter(tmp_path / "empty" / RECORDING, {}).close()
    assert "it has no status or no odometry" in report(tmp_path / "empty").output
    (tmp_path / "other.json").write_text('{"case": 3}')
    result = report(tmp_path / "other.json")
    assert result.exit_code == 1
    assert "neither the folder of a run nor a file of `jezero bench landing --json`" in result.output


@pytest.mark.long
def test_a_recording_without_truth_has_the_same_figures_of_a_landing(
    flown: tuple[Path, FlightResult], landing: RecordedLanding, tmp_path: Path
) -> None:
    recording = tmp_path / RECORDING
    kept = [topic for topic in open_recording(flown[0]).summary().counts if topic not in TRUE_TOPICS]
    words = [word for topic in kept for word in ("--topic", topic)]
    cut = CliRunner().invoke(main, ["recording", "cut", str(flown[0]), str(recording), *words])
    assert cut.exit_code == 0, cut.output
    result = report(recording)
    assert result.exit_code == 0, result.output
    assert {path.stem for path in tmp_path.glob("*.png")} == {
        "position", "status", "relative_position", "relative_error", "rover_position", "uwb_tag", "touchdown",
    }  # fmt: skip
    (blind,) = landings(list(open_recording(recording).messages()))
    assert not blind.has_truth and landing.has_truth and landing.std_touchdown_m is None
    assert blind.touchdown_rover_body_m is not None and landing.touchdown_rover_body_m is not None
    assert blind.std_touchdown_m is not None and 0.0 < 3.0 * blind.std_touchdown_m < 0.1
    off_m = np.hypot(*np.subtract(blind.touchdown_rover_body_m, landing.touchdown_rover_body_m))
    assert off_m < 5.0 * blind.std_touchdown_m


@pytest.mark.long
def test_every_recording_of_a_stack_is_drawn_into_a_folder_of_its_own(
    flown: tuple[Path, FlightResult], tmp_path: Path
) -> None:
    recordings = tmp_path / RECORDINGS
    recordings.mkdir()
    for name in ("2026-01-01_10-00-00", "2026-01-01_11-00-00"):
        shutil.copy(flown[0] / RECORDING, recordings / f"{name}.mcap")
    (recordings / "2026-01-01_12-00-00.mcap").write_text("no recording")
    result = report(tmp_path)
    assert result.exit_code == 0, result.output
    assert "2026-01-01_12-00-00.mcap is no recording" in result.stderr
    assert (recordings / "2026-01-01_10-00-00" / "relative_error.png").exists()
    assert (recordings / "2026-01-01_11-00-00" / "relative_error.png").exists()
    assert (tmp_path / "touchdowns.png").exists()
