"""`jezero install-service`: the unit that it writes, and what it refuses."""

import os
import pwd
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import click.testing
import pytest
from click.testing import CliRunner

from jezero.cli.main import main

USER = next(account for account in pwd.getpwall() if account.pw_uid != 0 and os.path.isdir(account.pw_dir))


def install(*words: str) -> click.testing.Result:
    return CliRunner().invoke(main, ["install-service", *words])


def written(tmp_path: Path, *words: str) -> str:
    done = install("--profile", "onboard", "--user", USER.pw_name, "--out", str(tmp_path), *words)
    assert done.exit_code == 0, done.output
    return (tmp_path / "jezero-onboard.service").read_text()


@pytest.fixture(autouse=True)
def no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("JEZERO_")]:
        monkeypatch.delenv(name)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_finds_nothing_wrong_with_the_unit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_CONFIG_DIR", str(tmp_path / 'a "folder" of 100 %'))
    written(tmp_path)
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(tmp_path / "jezero-onboard.service")],
        capture_output=True,
        text=True,
        check=False,
    )
    complaints = [line for line in done.stderr.splitlines() if "jezero" in line and "Special user" not in line]
    assert (done.returncode, complaints) == (0, [])


def test_the_unit_runs_the_launcher_as_the_user_with_the_variables_of_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JEZERO_CONFIG_DIR", "my 50 % config")
    monkeypatch.setenv("JEZERO_RUN_DIR", "/of/another/stack")
    lines = written(tmp_path).splitlines()
    assert f"User={USER.pw_name}" in lines and "Type=notify" in lines and "Restart=on-failure" in lines
    assert f'Environment="JEZERO_CONFIG_DIR={tmp_path}/my 50 %% config"' in lines
    assert "Environment=JEZERO_RUN_DIR=/var/lib/jezero-onboard" in lines and "StateDirectory=jezero-onboard" in lines
    assert any(line.startswith("ExecStart=") and line.endswith("up --profile onboard") for line in lines)


def test_a_run_folder_of_the_users_own_is_the_only_place_that_the_unit_may_write(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    run.chmod(0o777)
    lines = written(tmp_path, "--run-folder", str(run)).splitlines()
    assert f"ReadWritePaths={run}" in lines and f"Environment=JEZERO_RUN_DIR={run}" in lines
    assert "ProtectSystem=strict" in lines and not any(line.startswith("StateDirectory") for line in lines)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--profile bord --out {out}", "there is no profile 'bord'; there are control,"),
        ("--profile onboard --out {out} --user root", "the services don't run as root"),
        ("--profile onboard --out {out} --user nobody-of-this-name", "there is no user 'nobody-of-this-name'"),
        ("--profile onboard --out {out} --user {user} --run-folder {out}/none", "there is no run folder"),
        ("--profile onboard --out {out} --user {user} --run-folder {out}/closed", "can't write into the run folder"),
        ("--profile onboard --out {out} --user {user} --run-folder {out}/" + 90 * "x", "too long for the path"),
    ],
)
def test_what_could_not_run_is_refused_in_one_sentence(tmp_path: Path, words: str, sentence: str) -> None:
    (tmp_path / "closed").mkdir(mode=0o500)
    (tmp_path / (90 * "x")).mkdir()
    (tmp_path / (90 * "x")).chmod(0o777)
    done = install(*words.format(out=tmp_path, user=USER.pw_name).split())
    assert done.exit_code in (2, 3)
    assert sentence in done.stderr
    assert not list(tmp_path.glob("*.service"))


def test_without_systemd_or_on_another_system_nothing_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jezero.cli.install_service.SYSTEMD", tmp_path / "none")
    done = install("--profile", "onboard", "--user", USER.pw_name)
    assert done.exit_code == 3 and "systemd does not run this computer" in done.stderr
    monkeypatch.setattr("sys.platform", "darwin")
    done = install("--profile", "onboard", "--user", USER.pw_name)
    assert done.exit_code == 3 and "systemd runs on Linux only" in done.stderr


def test_who_may_not_write_is_told_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jezero.cli.install_service.SYSTEMD", tmp_path)
    monkeypatch.setattr("jezero.cli.install_service.os.access", lambda path, mode: False)
    monkeypatch.setattr("sys.argv", ["jezero", "install-service", "--profile", "onboard"])
    monkeypatch.setenv("JEZERO_CONFIG_DIR", "/opt/my config")
    done = install("--profile", "onboard", "--user", USER.pw_name)
    assert done.exit_code == 3 and "only root may write into /etc/systemd/system" in done.stderr
    command = done.stderr.splitlines()[-1].strip()
    assert command.startswith("sudo 'JEZERO_CONFIG_DIR=/opt/my config' ")
    assert command.endswith(f"install-service --profile onboard --user {USER.pw_name}")


@pytest.fixture
def systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[str, ...]]]:
    """A computer that systemd runs, whose units are in `units`; gives the calls of systemctl."""
    calls: list[tuple[str, ...]] = []
    (tmp_path / "units").mkdir()
    monkeypatch.setattr("jezero.cli.install_service.SYSTEMD", tmp_path)
    monkeypatch.setattr("jezero.cli.install_service.UNITS", tmp_path / "units")
    monkeypatch.setattr("jezero.cli.install_service._systemctl", lambda *words: calls.append(words))
    yield calls


def test_a_user_who_can_not_reach_the_interpreter_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, systemd: list[tuple[str, ...]]
) -> None:
    (tmp_path / "closed").mkdir(mode=0o700)
    monkeypatch.setattr("sys.executable", str(tmp_path / "closed" / "python"))
    done = install("--profile", "onboard", "--user", USER.pw_name)
    assert done.exit_code == 3
    assert "is closed to others" in done.stderr
    assert not list((tmp_path / "units").iterdir()) and systemd == []


def test_an_installed_unit_is_read_by_systemd_and_stopped_before_it_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, systemd: list[tuple[str, ...]]
) -> None:
    monkeypatch.setattr("jezero.cli.install_service._closed_folder", lambda program, account: None)
    done = install("--profile", "onboard", "--profile", "rover", "--user", USER.pw_name)
    assert done.exit_code == 0, done.output
    unit = tmp_path / "units" / "jezero-onboard-rover.service"
    assert "up --profile onboard --profile rover\n" in unit.read_text()
    assert unit.stat().st_mode & 0o777 == 0o644
    assert "sudo systemctl enable --now jezero-onboard-rover.service" in done.output
    assert systemd == [("daemon-reload",)]
    done = install("--profile", "onboard", "--profile", "rover", "--remove")
    assert done.exit_code == 0 and not unit.exists()
    assert systemd[1:] == [("disable", "--now", unit.name), ("daemon-reload",)]


def test_remove_takes_the_unit_away_and_leaves_the_run_folder(tmp_path: Path) -> None:
    written(tmp_path)
    done = install("--profile", "onboard", "--out", str(tmp_path), "--remove")
    assert done.exit_code == 0 and "the run folder stays" in done.output
    assert not list(tmp_path.iterdir())
    done = install("--profile", "onboard", "--out", str(tmp_path), "--remove")
    assert done.exit_code == 0 and "there is no" in done.output
