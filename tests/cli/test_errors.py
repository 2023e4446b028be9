"""Errors that are not the program's: one sentence, without a traceback, in every command."""

import re
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from jezero.base.config import ConfigError, load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.cli.main import main


@pytest.mark.parametrize(
    "words",
    ["fly --fast", "demo --fast --runs {runs}", "bench landing --n 1", "campaign --seeds 1", "info services",
     "camera orthophoto {runs}.png"],
)  # fmt: skip
@pytest.mark.parametrize("folder", ["", "missing"])
def test_wrong_settings_are_named_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, folder: str
) -> None:
    settings = tmp_path / folder
    if not folder:
        for name in ("vehicle", "simulator", "actions", "camera"):
            (settings / f"{name}.toml").write_text("no_such_setting = 1\n")
    monkeypatch.setenv("JEZERO_CONFIG_DIR", str(settings))
    done = CliRunner().invoke(main, words.format(runs=tmp_path / "runs").split())
    assert done.exit_code == 1
    assert done.stderr.startswith(f"Error: {settings}/") and len(done.stderr.splitlines()) == 1
    assert ("is missing" if folder else "no_such_setting") in done.stderr
    assert "missions" not in done.stdout


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (OSError(28, "No space left on device", "a.png"), "a.png: No space left on device (make room on the disk"),
        (OSError(24, "Too many open files"), "Too many open files (`ulimit -n` limits"),
        (PermissionError(13, "Permission denied", "a"), "a: Permission denied\n"),
        (OSError("a sentence"), "a sentence\n"),
    ],
)
def test_what_the_operating_system_refuses_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, error: OSError, sentence: str
) -> None:
    @click.command()
    def broken() -> None:
        raise error

    monkeypatch.setattr("jezero.cli.flight.status", broken)
    done = CliRunner().invoke(main, ["status"])
    assert done.exit_code == 1
    assert done.stderr.startswith(f"Error: {sentence}") and len(done.stderr.splitlines()) == 1


def test_errors_of_the_program_keep_their_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    @click.command()
    def broken() -> None:
        raise ValueError("a programming error")

    monkeypatch.setattr("jezero.cli.flight.status", broken)
    assert isinstance(CliRunner().invoke(main, ["status"]).exception, ValueError)


@pytest.mark.parametrize("words", [("map", "."), ("camera", "orthophoto", "out.png")], ids=["map", "orthophoto"])
def test_a_resolution_that_is_no_number_is_refused(words: tuple[str, ...]) -> None:
    done = CliRunner().invoke(main, [*words, "--resolution", "nan"])
    assert done.exit_code == 2, done.output
    assert "Invalid value for '--resolution': nan is not a finite number" in done.output


@pytest.mark.parametrize("name", ["new*", "*", "**", "", "a/b", "é", "v" * 33])
@pytest.mark.parametrize(
    "words",
    ["status", "takeoff", "replay .", "ground", "recording export . --rosbag2 bag", "recording import . a.mcap"],
)
def test_a_name_that_no_vehicle_can_have_is_refused(words: str, name: str) -> None:
    done = CliRunner().invoke(main, [*words.split(), "--vehicle", name])
    assert done.exit_code == 2, done.output
    sentence = f"the vehicle's name is {name!r}: expected 1 to 32 letters, digits, '-' and '_'"
    assert f"Error: Invalid value for '--vehicle': {sentence}" in done.stderr


KNOWN_ANCHORS = "--known 0 --known 1 --known 2"


@pytest.mark.parametrize(
    "words",
    [
        "up -f {file}",
        "bench landing --n 1 --world {file}",
        "camera intrinsics {file}",
        "rover follow {file}",
        f"uwb survey --between {{file}} {KNOWN_ANCHORS}",
        "mission check {file}",
        "fence set {file}",
    ],
)
def test_a_file_that_is_no_text_is_named_with_what_helps(words: str, tmp_path: Path) -> None:
    file = tmp_path / ("file.toml" if "--world" in words else "file.yaml")
    file.write_bytes(b"\xff\xfe\x00")
    done = CliRunner().invoke(main, words.format(file=file).split(), env={"JEZERO_RUN_DIR": str(tmp_path / "run")})
    assert isinstance(done.exception, SystemExit), done.exception
    assert str(file) in done.output and "is no text in UTF-8: save it as UTF-8" in done.output


def test_settings_that_are_no_text_are_named_with_what_helps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from jezero.recording.about import about

    file = tmp_path / "vehicle.toml"
    file.write_bytes(b"\xff\xfe\x00")
    monkeypatch.setenv("JEZERO_CONFIG_DIR", str(tmp_path))
    sentence = re.escape(f"{file} is no text in UTF-8: save it as UTF-8")
    with pytest.raises(ConfigError, match=sentence):
        load_config(VehicleConfig, "vehicle")
    with pytest.raises(ConfigError, match=sentence):
        about()
