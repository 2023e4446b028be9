"""Commands that read recordings, also damaged and foreign ones, and `jezero watch` without a stack."""

import json
import sys
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from jezero.base.codec import encode
from jezero.base.router_address import is_loopback
from jezero.cli.main import main
from jezero.cli.terminal import UNREACHABLE, USAGE
from jezero.recording import open_recording
from jezero.recording.writer import RecordingWriter
from jezero.schemas import topics
from jezero.schemas.actions import Rejected
from jezero.schemas.state import Clock
from tests.recording.goals_rig import Flight, accepted, ended, replied, requested, step, succeeded
from tests.recording.rig import record

COMMANDS: dict[str, Callable[[Path], list[str]]] = {
    "info": lambda file: ["recording", "info", str(file)],
    "info --json": lambda file: ["recording", "info", str(file), "--json"],
    "export": lambda file: ["recording", "export", str(file), "--csv", str(file.parent / "tables")],
    "cut": lambda file: ["recording", "cut", str(file), str(file.parent / "part.mcap")],
    "repair": lambda file: ["recording", "repair", str(file)],
    "settings": lambda file: ["recording", "settings", str(file)],
    "report": lambda file: ["report", str(file)],
    "replay": lambda file: ["replay", str(file), "--through", "estimator"],
    "tune": lambda file: ["tune", str(file)],
}
NEED_A_FLIGHT = ("settings", "report", "replay", "tune")
"""Commands that refuse a recording without a flight."""


def run(command: str, file: Path) -> Result:
    result = CliRunner().invoke(main, COMMANDS[command](file))
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exc_info
    return result


def assert_refused(result: Result, file: Path) -> None:
    assert result.exit_code == 1, result.output
    assert result.stderr.startswith("Error: ") and file.name in result.stderr
    assert "Traceback" not in result.output
    assert len(result.stderr.strip().splitlines()) == 1


def empty(file: Path) -> None:
    file.write_bytes(b"")


def text(file: Path) -> None:
    file.write_text("t_ns,range_m\n1,2\n")


def folder(file: Path) -> None:
    file.mkdir()


def nothing_but_the_start(file: Path) -> None:
    file.write_bytes(b"\x89MCAP")


def of_a_newer_format(file: Path) -> None:
    content = record(file).read_bytes()
    file.write_bytes(content[:5] + b"1" + content[6:])


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("make", [empty, text, folder, nothing_but_the_start, of_a_newer_format])
def test_what_is_no_recording_is_refused_with_a_sentence(
    command: str, make: Callable[[Path], None], tmp_path: Path
) -> None:
    file = tmp_path / "flight.mcap"
    make(file)
    assert_refused(run(command, file), file)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_without_a_recording_is_named_with_the_files_that_it_would_have(command: str, tmp_path: Path) -> None:
    result = run(command, tmp_path)
    assert_refused(result, tmp_path)
    assert f"{tmp_path} has no recording: a run's folder has flight.mcap, or recordings/*.mcap" in result.stderr


@pytest.mark.parametrize("command", COMMANDS)
def test_a_recording_that_may_not_be_read_is_refused_with_a_sentence(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = record(tmp_path / "flight.mcap")

    def refuse(path: Path, *args: object) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", refuse)
    result = run(command, file)
    assert_refused(result, file)
    assert "Permission denied" in result.stderr


@pytest.mark.parametrize("command", ["export", "report"])
@pytest.mark.parametrize(
    ("topic", "data"),
    [
        ("status", b'{"t_ns":1,"colour":"red"}'),
        ("odometry", b'{"t_ns":"one"}'),
        ("status", b"\x00\x01\xff"),
        ("odometry", b"[" * 100_000),
    ],
)
def test_a_message_of_another_schema_is_named_by_a_command_that_decodes_it(
    command: str, topic: str, data: bytes, tmp_path: Path
) -> None:
    file = tmp_path / "flight.mcap"
    with RecordingWriter(file, {}) as writer:
        writer.write(1, topics.CLOCK.name, encode(Clock(t_ns=1, epoch_id=1, wall_ns=1)))
        writer.write(2, topic, data)
    result = run(command, file)
    assert_refused(result, file)
    assert topic in result.stderr


@pytest.mark.parametrize("command", COMMANDS)
def test_a_recording_of_another_program_makes_no_command_crash(command: str, tmp_path: Path) -> None:
    file = tmp_path / "flight.mcap"
    with file.open("wb") as opened:
        writer = Writer(opened)
        writer.start(profile="ros2")
        schema = writer.register_schema("tf2_msgs/msg/TFMessage", "ros2msg", b"")
        writer.add_message(writer.register_channel("/tf", "cdr", schema), 1, b"\x00\x01\x02", 1)
        writer.finish()  # type: ignore[no-untyped-call]
    result = run(command, file)
    if command in NEED_A_FLIGHT:
        assert_refused(result, file)
    else:
        assert result.exit_code == 0, result.output


@pytest.mark.long
@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_recording_ends_no_command_with_a_traceback(
    tmp_path_factory: pytest.TempPathFactory, whole: bytes, data: st.DataObject
) -> None:
    content = bytearray(whole)
    for _ in range(data.draw(st.integers(0, 4), "number of wrong bytes")):
        content[data.draw(st.integers(0, len(content) - 1), "place")] ^= data.draw(st.integers(1, 255), "bits")
    length = data.draw(st.one_of(st.just(len(content)), st.integers(0, len(content))), "length")
    command = data.draw(st.sampled_from([name for name in COMMANDS if name != "report"]), "command")
    file = tmp_path_factory.mktemp("damaged") / "flight.mcap"
    file.write_bytes(content[:length])
    result = run(command, file)
    if result.exit_code:
        assert_refused(result, file)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return record(tmp_path_factory.mktemp("run") / "flight.mcap").read_bytes()


@pytest.mark.long
def test_a_report_of_a_recording_that_is_cut_at_any_place_draws_it_or_says_why_not(
    whole: bytes, tmp_path: Path
) -> None:
    file = tmp_path / "flight.mcap"
    for length in range(0, len(whole), max(1, len(whole) // 12)):
        file.write_bytes(whole[:length])
        result = run("report", file)
        if result.exit_code:
            assert_refused(result, file)


def test_info_shows_origin_times_and_the_messages_of_each_topic(tmp_path: Path) -> None:
    shown = run("info", record(tmp_path / "flight.mcap")).output
    lines = [line.split() for line in shown.splitlines()]
    assert ["duration", "2.9", "s"] in lines and ["messages", "39"] in lines and ["vehicle", "uav1"] in lines
    assert ["start", "0.000", "s", "of", "virtual", "time"] in lines
    assert ["sensor/altimeter", "30", "10.3", "Hz", "jezero.Altimeter"] in lines


def test_info_shows_the_date_of_a_flight_in_real_time(tmp_path: Path) -> None:
    file = tmp_path / "flight.mcap"
    t_ns = int(datetime(2026, 3, 4, 5, 6, 7, 500_000).astimezone().timestamp() * 1000) * 1_000_000
    with RecordingWriter(file, {}) as writer:
        writer.write(t_ns, topics.CLOCK.name, encode(Clock(t_ns=1, epoch_id=1, wall_ns=1)))
    assert "start      2026-03-04 05:06:07.500" in run("info", file).output


def test_info_lists_the_goals_with_their_ends(tmp_path: Path) -> None:
    flight = Flight(tmp_path / "flight.mcap")
    flight.journal(3.0, requested(1), step(2.0), accepted(1), step(2.5), succeeded(2.5))
    flight.journal(5.0, requested(2), step(4.0), accepted(2, "b"), ended(4.5, "aborted", "much wind", 2, "b"))
    flight.journal(6.0, requested(3), step(6.0), replied(3, Rejected(goal_id="c", reason="busy: wait")))
    flight.journal(8.0, requested(4), step(8.0), accepted(4, "d"))
    flight.close()
    file = flight.path
    lines = run("info", file).output.splitlines()
    shown = [line.strip() for line in lines[lines.index("goals, by seconds from the start") + 1 :]]
    assert shown[:4] == [
        "2.0 s  go_to  succeeded after 0.5 s",
        "4.0 s  go_to  aborted after 0.5 s: much wind",
        "6.0 s  go_to  rejected: busy: wait",
        "8.0 s  go_to  runs for 0.0 s; its end is not recorded",
    ]
    fields = json.loads(CliRunner().invoke(main, ["recording", "info", "--json", str(file)]).output)
    assert [goal["outcome"] for goal in fields["goals"]] == ["succeeded", "aborted", "rejected", "unknown"]


def test_info_of_goals_of_another_version_shows_the_rest(tmp_path: Path) -> None:
    file = tmp_path / "flight.mcap"
    with RecordingWriter(file, {}) as writer:
        writer.write(0, topics.CLOCK.name, encode(Clock(t_ns=1, epoch_id=1, wall_ns=1)))
        writer.write(1, "journal/takeoff", b'{"t_ns":1,"colour":"red"}')
    shown = run("info", file).output
    assert "goals      not shown:" in shown and "clock" in shown


def test_a_viewer_must_be_chosen() -> None:
    result = CliRunner().invoke(main, ["watch"])
    assert result.exit_code == USAGE and "--foxglove" in result.output


def test_a_missing_library_is_named_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    result = CliRunner().invoke(main, ["watch", "--foxglove"])
    assert result.exit_code == 1
    assert "pip install 'jezero[foxglove]'" in result.output


def test_without_a_router_it_ends_with_a_sentence() -> None:
    result = CliRunner().invoke(main, ["watch", "--foxglove", "--port", "0", "--router", "tcp/127.0.0.1:1"])
    assert result.exit_code == UNREACHABLE
    assert "is the stack up?" in result.output


@pytest.mark.parametrize(
    ("host", "loopback"), [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("pi", False)]
)
def test_only_loopback_needs_no_warning(host: str, loopback: bool) -> None:
    assert is_loopback(host) == loopback


@pytest.mark.parametrize(
    ("words", "exit_code", "sentence"),
    [
        (["--from", "50", "--to", "60"], 1, "flight.mcap lasts 2.9 s: a part from 50 s on is after its end"),
        (["--from", "20", "--to", "10"], USAGE, "--to 10 is not after --from 20: the new recording would be empty"),
        (["--from", "-5"], USAGE, "--from -5: give seconds from the start of FILE, 0 or more"),
        (["--topic", "foo"], 1, "has no message of 'foo'; its topics: clock, odometry, sensor/altimeter, status"),
        (["--topic", "status", "--to", "0.1"], 1, "has no message of these topics in this time"),
    ],
)
def test_a_cut_that_would_be_empty_is_refused_and_changes_no_file(
    words: list[str], exit_code: int, sentence: str, tmp_path: Path
) -> None:
    file, target = record(tmp_path / "flight.mcap"), tmp_path / "part.mcap"
    target.write_text("what was there")
    result = CliRunner().invoke(main, ["recording", "cut", str(file), str(target), "--force", *words])
    assert result.exit_code == exit_code, result.output
    assert sentence in result.stderr
    assert target.read_text() == "what was there"


def test_a_cut_is_written_over_a_file_only_with_force(tmp_path: Path) -> None:
    file, target = record(tmp_path / "flight.mcap"), tmp_path / "part.mcap"
    target.write_text("what was there")
    words = ["recording", "cut", str(file), str(target), "--to", "1"]
    refused = CliRunner().invoke(main, words)
    assert refused.exit_code == 1
    assert refused.stderr == f"Error: {target} exists: choose another name, or add --force\n"
    assert target.read_text() == "what was there"
    assert CliRunner().invoke(main, [*words, "--force"]).exit_code == 0
    assert open_recording(target).summary().duration_s == pytest.approx(1.0)
