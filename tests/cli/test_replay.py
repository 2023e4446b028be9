"""`jezero replay` used wrongly, and files that can't be replayed."""

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from jezero.base.router_address import is_loopback
from jezero.cli.main import main
from jezero.cli.terminal import FAILED, UNREACHABLE, USAGE
from tests.client.rig import free_endpoint
from tests.recording.rig import record


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["replay", *map(str, words), "--router", free_endpoint()])


@pytest.fixture(autouse=True)
def run_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Each replay that is the router has a socket of its own."""
    monkeypatch.setenv("JEZERO_RUN_DIR", str(tmp_path / "run"))


def assert_refused(result: Result, exit_code: int, *parts: str) -> None:
    """One sentence with these parts, and nothing else but click's usage."""
    assert result.exit_code == exit_code, result.output
    assert "Traceback" not in result.output
    *usage, sentence = result.stderr.strip().splitlines()
    assert sentence.startswith("Error: ") and all(part in sentence for part in parts), sentence
    assert len(usage) == (3 if exit_code == USAGE else 0)


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """Three seconds; the last message is that of 2.9 s."""
    return record(tmp_path / "flight.mcap")


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("--speed", "0"), "from 0.001 to 1000"),
        (("--speed", "-1"), "from 0.001 to 1000"),
        (("--speed", "nan"), "not a finite number"),
        (("--from", "-1"), "0 or more"),
        (("--from", "2", "--to", "2"), "is not after"),
        (("--to", "inf"), "not a finite number"),
        (("--vehicle", "*"), "letters, digits"),
        (("--set", "std_uwb_m=0.1"), "--set needs --through"),
        (("--json",), "--json needs --through"),
        (("--router", "here"), "is no address of a router"),
    ],
)
def test_wrong_usage_is_refused_with_a_sentence(flight: Path, words: tuple[str, ...], part: str) -> None:
    result = CliRunner().invoke(main, ["replay", str(flight), *words])
    assert_refused(result, USAGE, part)


@pytest.mark.parametrize(
    "words", [("--speed", "2"), ("--from", "1"), ("--to", "2"), ("--loop",), ("--topic", "odometry"), ("--force",)]
)
def test_options_of_a_replay_onto_a_bus_are_refused_with_through(flight: Path, words: tuple[str, ...]) -> None:
    result = CliRunner().invoke(main, ["replay", str(flight), "--through", "estimator", *words])
    assert_refused(result, USAGE, words[0], "--through")


def test_the_environment_of_a_stack_does_not_disturb_through(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_VEHICLE", "v")
    monkeypatch.setenv("JEZERO_ROUTER", "tcp/127.0.0.1:7000")
    result = CliRunner().invoke(main, ["replay", str(flight), "--through", "estimator"])
    assert_refused(result, FAILED, "no journal of 'estimator'")


def test_a_time_or_topic_that_the_recording_does_not_have_is_named(flight: Path) -> None:
    assert_refused(run(flight, "--from", "9"), FAILED, "lasts 2.9 s", "--from 9")
    assert_refused(run(flight, "--topic", "truth"), FAILED, "'truth'", "clock, odometry, sensor/altimeter, status")
    assert_refused(run(flight, "--topic", "clock", "--from", "2.6"), FAILED, "no message of these topics")


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    assert_refused(run(tmp_path / "missing.mcap"), FAILED, "missing.mcap")
    assert_refused(run(tmp_path), FAILED, str(tmp_path))
    (tmp_path / "text.mcap").write_text("t_ns,range_m\n")
    assert_refused(run(tmp_path / "text.mcap"), FAILED, "no recording")


def test_without_a_router_on_another_machine_the_address_is_named(flight: Path) -> None:
    assert not is_loopback("192.0.2.1")
    result = CliRunner().invoke(main, ["replay", str(flight), "--router", "tcp/192.0.2.1:7447", "--insecure"])
    assert result.exit_code == UNREACHABLE and "no router at tcp/192.0.2.1:7447" in result.stderr


def test_a_recording_is_replayed_to_its_end_without_a_terminal(flight: Path) -> None:
    result = run(flight, "--speed", "50", "--topic", "odometry", "--topic", "clock")
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[-1].endswith(" s of 2.9 s, 50 times as fast: 6 messages published")


def test_a_recording_that_was_cut_is_replayed_as_far_as_it_goes(flight: Path) -> None:
    flight.write_bytes(flight.read_bytes()[:-60])
    result = run(flight, "--speed", "50")
    assert result.exit_code == 0, result.output
    assert "it was not finished" in result.stderr and "messages published" in result.stdout
