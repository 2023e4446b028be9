"""The ground station on the command line."""

from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("argon2", reason="the extra jezero[ground] is not installed")

from jezero.cli import stack
from jezero.cli.ground import ground
from jezero.cli.main import main
from jezero.cli.stack import GROUND_STATION, _read_services
from jezero.deploy.launcher.compose import shipped_compose_file
from jezero.services.ground_station.access import matches, read_password


def test_a_stack_without_the_extra_starts_without_the_ground_station_and_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("JEZERO_GROUND", raising=False)
    monkeypatch.setattr(stack, "find_spec", lambda name: None if name == "nicegui" else object())
    services = _read_services(shipped_compose_file(), (), linked=False)
    assert GROUND_STATION not in services
    assert "vehicle_bridge" in services
    expected = "no ground station in the browser, which is an extra: pip install 'jezero[ground]'\n"
    assert capsys.readouterr().err == expected


def test_a_stack_with_the_extra_has_the_ground_station(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JEZERO_GROUND", raising=False)
    monkeypatch.setattr(stack, "find_spec", lambda name: object())
    assert GROUND_STATION in _read_services(shipped_compose_file(), (), linked=False)
    assert GROUND_STATION not in _read_services(shipped_compose_file(), ("control",), linked=False)


def test_a_password_is_read_from_standard_input_and_only_its_hash_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    file = tmp_path / "jezero" / "ground_station.password"
    assert CliRunner().invoke(ground, ["--set-password"], input="short\n").exit_code == 1
    assert not file.exists()
    done = CliRunner().invoke(ground, ["--set-password"], input="correct horse\n")
    assert done.exit_code == 0
    assert str(file) in done.output
    assert file.stat().st_mode & 0o777 == 0o600
    assert matches("correct horse", read_password(file))


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--listen", "192.0.2.7"], "--set-password"),
        (["--listen", "the roof"], "is no IP address"),
        (["--recording", "nothing.mcap"], "No such file"),
        (["--port", "0"], "is not in the range"),
        (["--connect", "nowhere"], "tcp/127.0.0.1:7447"),
    ],
)
def test_wrong_words_get_a_sentence(
    words: list[str], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    done = CliRunner().invoke(main, ["ground", *words])
    assert done.exit_code in (1, 2)
    assert sentence in done.output
    assert "Traceback" not in done.output
