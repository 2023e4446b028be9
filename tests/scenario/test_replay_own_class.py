"""Replays and tuning of services of one's own, whose class is named."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.cli.main import main
from jezero.recording.journals import ServiceRun
from jezero.recording.mcap_file import McapFile, RecordingError
from jezero.recording.writer import RecordingWriter
from jezero.replay.rebuild import make_service
from jezero.runtime.service import Inbox, Output, Publish, Service
from jezero.schemas import topics
from jezero.schemas.goals import TakeoffGoal
from jezero.services.estimator.config import EstimatorConfig
from jezero.services.estimator.service import Estimator
from jezero.trials.stack import build_stack
from tests.scenario.replay_rig import SEED, STANDING_S
from tests.scenario.test_own_estimator import program

pytestmark = pytest.mark.xdist_group("own class")
"""One worker makes the recordings, once."""

MODULE = "my_estimator"
MINE = f"{MODULE}:MyEstimator"
TUNABLE = f"{__name__}:Mine"
MORE = """

from jezero.runtime.service import Publish
from jezero.services.estimator.service import Estimator


class Mhe(Estimator):
    pass


class Other(MyEstimator):
    spec = Spec(name="other")


class Fails(MyEstimator):
    def step(self, t_ns, inbox):
        raise ZeroDivisionError("no rover")


class Undeclared(MyEstimator):
    def step(self, t_ns, inbox):
        yield Publish(topics.ODOMETRY, None)


class Needs(MyEstimator):
    def __init__(self, horizon_s):
        super().__init__()


class Imu(MyEstimator):
    spec = Spec(name="estimator", inputs=(*MyEstimator.spec.inputs, topics.IMU), outputs=(topics.RELATIVE,))
"""


class Mine(Estimator):
    """An estimator that is another class than jezero's, and has the same arguments."""

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for output in super().step(t_ns, inbox):
            if not (isinstance(output, Publish) and output.topic is topics.ROVER_ESTIMATE):
                yield output


def record(path: Path, estimator: Service) -> Path:
    """Record a takeoff with an estimator in place of jezero's."""
    with RecordingWriter(path, {}) as writer:
        bus = build_stack(SEED, without=("estimator",), journal_reader=writer.write)
        bus.add(estimator)
        bus.observe(writer.write)
        bus.run_for(STANDING_S)
        bus.send_request(topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=2.0))
        bus.run_for(8.0)
        bus.end_journals()
    return path


def settings() -> tuple[EstimatorConfig, VehicleConfig]:
    return load_config(EstimatorConfig, "estimator"), load_config(VehicleConfig, "vehicle")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the estimator of docs/how-to/write-an-estimator.md, and more classes, in a file."""
    folder = tmp_path_factory.mktemp("own")
    (folder / f"{MODULE}.py").write_text(program() + MORE)
    return folder


@pytest.fixture(autouse=True)
def there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


@pytest.fixture(scope="module")
def flight(folder: Path) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        from importlib import import_module

        return record(folder / "flight.mcap", import_module(MODULE).MyEstimator())


@pytest.fixture(scope="module")
def tunable(folder: Path) -> Path:
    """A flight with an estimator whose class is not jezero's, and that has the same settings."""
    return record(folder / "mine.mcap", Mine(*settings()))


@pytest.fixture(scope="module")
def usual(folder: Path) -> Path:
    return record(
        folder / "usual.mcap",
        Estimator(load_config(EstimatorConfig, "estimator"), load_config(VehicleConfig, "vehicle")),
    )


def jezero(*words: str | Path) -> Result:
    result = CliRunner().invoke(main, list(map(str, words)))
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exc_info
    return result


def replay(path: Path, *words: str) -> Result:
    return jezero("replay", path, "--through", "estimator", *words)


def test_it_is_refused_without_its_class_in_a_sentence_that_names_it(flight: Path) -> None:
    done = replay(flight)
    assert done.exit_code == 1
    assert done.stderr == f"Error: the recorded 'estimator' is not jezero's: name its class with --class {MINE}\n"


def test_with_its_class_it_is_replayed_bit_by_bit(flight: Path) -> None:
    done = replay(flight, "--class", MINE, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["identical"] and found["steps"] > 100 and found["outputs"] > 100
    assert found["errors_replayed"]["compared"] > 100 and found["not_received"] == []


def test_a_class_with_recorded_settings_is_replayed_with_others(tunable: Path) -> None:
    own = ("--class", TUNABLE)
    assert json.loads(replay(tunable, *own, "--json").stdout)["identical"]
    assert not json.loads(replay(tunable, *own, "--json", "--set", "std_uwb_m=0.05").stdout)["identical"]
    assert "did you mean 'std_uwb_m'?" in replay(tunable, *own, "--set", "std_uwb=0.05").stderr


def test_a_class_runs_on_what_another_estimator_has_read(tunable: Path) -> None:
    found = json.loads(replay(tunable, "--class", MINE, "--json").stdout)
    assert not found["identical"] and found["errors_replayed"]["valid"] > 100


def test_an_input_that_the_recorded_one_did_not_read_is_named(flight: Path) -> None:
    assert "never received: sensor/imu." in replay(flight, "--class", f"{MODULE}:Imu").stdout


@pytest.mark.parametrize(
    ("own", "sentence"),
    [
        ("my_estimator", "'my_estimator' is no class: give module:class, such as "),
        ("missing:Mhe", "there is no module 'missing': give one of an installed package, or of a file in this folder"),
        (f"{MODULE}:Missing", f"{MODULE} has no class 'Missing' with a method `step`"),
        (f"{MODULE}:STD_RANGE_M", f"{MODULE} has no class 'STD_RANGE_M' with a method `step`"),
        (f"{MODULE}:Other", f"{MODULE}:Other is the service 'other' by its Spec, not 'estimator'"),
        (f"{MODULE}:Needs", f"{MODULE}:Needs needs horizon_s, which the recording doesn't have"),
        (f"{MODULE}:Fails", f"{MODULE}:Fails failed in a step: ZeroDivisionError: no rover"),
        (
            f"{MODULE}:Undeclared",
            f"{MODULE}:Undeclared failed in a step: UndeclaredError: service 'estimator'",
        ),
    ],
)
def test_a_class_that_can_not_be_replayed_is_refused_in_a_sentence(flight: Path, own: str, sentence: str) -> None:
    done = replay(flight, "--class", own)
    assert done.exit_code == 1
    assert done.stderr.splitlines()[-1].startswith(f"Error: {sentence}")


def test_the_class_of_a_program_is_named_with_the_programs_file() -> None:
    """As it was recorded from `python my_estimator.py`."""
    with pytest.raises(RecordingError, match=r"--class module:MyEstimator, where the module is the program's file"):
        make_service(ServiceRun("estimator", 1, {}, "__main__:MyEstimator"), {})


def test_a_class_needs_a_service() -> None:
    done = jezero("replay", "flight.mcap", "--class", MINE)
    assert done.exit_code == 2 and "--class needs --through SERVICE" in done.stderr


def test_a_recording_without_the_name_of_the_class_is_refused_too(flight: Path, tmp_path: Path) -> None:
    """As those of versions that didn't record it."""
    old, name = tmp_path / "old.mcap", f'"{MINE}"'.encode()
    file = McapFile(flight)
    with RecordingWriter(old, {}, schemas=file.schemas) as writer:
        for message in file.messages():
            writer.write(message.logged_ns, message.topic, message.data.replace(name, b'""'))
    assert "is not jezero's: name its class with --class module:class" in replay(old).stderr
    assert replay(old, "--class", MINE).exit_code == 0


def test_tune_says_that_it_needs_the_class_and_what_the_class_needs(flight: Path) -> None:
    done = jezero("tune", flight)
    assert done.exit_code == 1 and f"name its class with --class {MINE}" in done.stderr
    done = jezero("tune", flight, "--class", MINE)
    assert done.exit_code == 1
    assert f"{MINE} can't be tuned: it has no method observe_innovations(observer)" in done.stderr


@pytest.mark.long
def test_tune_leaves_out_a_flight_of_another_estimator_and_goes_on_with_the_others(flight: Path, usual: Path) -> None:
    done = jezero("tune", flight, usual)
    assert done.exit_code == 0, done.output
    assert f"left out: {flight}: the recorded 'estimator' is not jezero's" in done.stderr
    assert done.stdout.startswith("1 flight; innovations with the settings in use:")


@pytest.mark.long
def test_tune_takes_an_estimator_of_ones_own_that_shows_its_innovations(tunable: Path) -> None:
    done = jezero("tune", tunable, "--class", TUNABLE)
    assert done.exit_code == 0, done.output
    assert "UWB ranges" in done.stdout and "std_uwb_m" in done.stdout
    assert f"--class {TUNABLE}" in done.stdout or "no settings are recommended" in done.stdout
