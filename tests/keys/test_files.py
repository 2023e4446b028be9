"""The files of a bundle: plain ones of a bounded size, which nobody but their owner can read or change."""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from jezero.keys.bundle import check_private, mavlink_key, secured
from jezero.keys.diagnosis import bundle_problem, connection_problem
from jezero.keys.files import BYTES_MAX
from jezero.keys.members import KeysError, read_members
from jezero.keys.team import Team
from tests.keys.rig import make_team

FILES = ("ca.pem", "certificate.pem", "key.pem", "mavlink.key", "members.json")
ADDRESS = "tls/127.0.0.1:1"
LATEST_S = 60.0


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Team:
    return make_team(tmp_path_factory.mktemp("a") / "team")


@pytest.fixture
def bundle(team: Team, tmp_path: Path) -> Path:
    return Path(shutil.copytree(team.bundle("pilot-ana"), tmp_path / "pilot-ana"))


def refusal(use: Callable[[], object]) -> str:
    with pytest.raises(KeysError) as caught:
        use()
    return str(caught.value)


@pytest.mark.parametrize("mode", [0o750, 0o705, 0o720, 0o702, 0o755, 0o777])
def test_a_folder_that_others_can_read_or_write_is_refused_with_the_command_to_type(bundle: Path, mode: int) -> None:
    bundle.chmod(mode)
    said = refusal(lambda: secured(ADDRESS, bundle))
    assert f"{bundle}, and could pretend to be its owner: type `chmod -R go= {bundle}`" in said
    subprocess.run(said.split("`")[1], shell=True, check=True)
    assert secured(ADDRESS, bundle)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602])
def test_keys_are_nobody_elses_and_the_other_files_may_only_be_read(bundle: Path, name: str, mode: int) -> None:
    (bundle / name).chmod(mode)
    if mode & 0o022 or name in ("key.pem", "mavlink.key"):
        assert f"{bundle / name}, and could pretend to be its owner" in refusal(lambda: check_private(bundle))
    else:
        check_private(bundle)


def test_a_folder_with_a_blank_in_its_name_has_a_command_that_can_be_typed(bundle: Path, tmp_path: Path) -> None:
    moved = bundle.rename(tmp_path / "my keys")
    (moved / "key.pem").chmod(0o644)
    subprocess.run(refusal(lambda: check_private(moved)).split("`")[1], shell=True, check=True)
    check_private(moved)


def test_changed_keys_that_others_can_read_are_not_used_by_a_router_that_runs(bundle: Path) -> None:
    endpoint = secured(ADDRESS, bundle)
    assert bundle_problem(endpoint) == ""
    (bundle / "key.pem").chmod(0o644)
    assert "could pretend to be its owner" in bundle_problem(endpoint)


def test_the_key_of_mavlink_and_that_of_the_authority_are_refused_too(bundle: Path, tmp_path: Path) -> None:
    (bundle / "mavlink.key").chmod(0o604)
    assert "mavlink.key, and could pretend to be its owner" in refusal(lambda: mavlink_key(str(bundle)))
    team = make_team(tmp_path / "team")
    (team.folder / "ca" / "key.pem").chmod(0o644)
    assert "chmod -R go=" in refusal(lambda: team.add("pilot", "cy"))


def test_a_team_is_made_in_a_folder_that_becomes_private(tmp_path: Path) -> None:
    (tmp_path / "team").mkdir(mode=0o755)
    team = make_team(tmp_path / "team")
    assert all(path.stat().st_mode & 0o077 == 0 for path in (team.folder, team.folder / "ca"))


def make_zero(path: Path) -> None:
    path.symlink_to("/dev/zero")


def make_fifo(path: Path) -> None:
    os.mkfifo(path, 0o600)


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        before = os.getcwd()
        os.chdir(path.parent)  # an address has 108 characters at most
        server.bind(path.name)
        os.chdir(before)


def make_folder(path: Path) -> None:
    path.mkdir(mode=0o700)


def make_large(path: Path) -> None:
    path.write_bytes(bytes(BYTES_MAX + 1))
    path.chmod(0o600)


STRANGE = (make_zero, make_fifo, make_socket, make_folder, make_large)


@pytest.mark.parametrize("name", ["ca.pem", "certificate.pem", "key.pem"])
@pytest.mark.parametrize("make", STRANGE)
def test_what_is_no_plain_file_or_too_large_is_refused_at_once(
    bundle: Path, name: str, make: Callable[[Path], None]
) -> None:
    endpoint = secured(ADDRESS, bundle)
    (bundle / name).unlink()
    make(bundle / name)
    began_s = time.thread_time()
    for said in (refusal(lambda: secured(ADDRESS, bundle)), connection_problem(endpoint), bundle_problem(endpoint)):
        assert name in said, said
    assert time.thread_time() - began_s < 1.0


@pytest.mark.parametrize("make", STRANGE)
def test_a_list_of_members_or_a_key_of_mavlink_that_is_no_plain_file_is_refused(
    bundle: Path, make: Callable[[Path], None]
) -> None:
    for name in ("members.json", "mavlink.key"):
        (bundle / name).unlink()
        make(bundle / name)
    assert "members.json" in refusal(lambda: read_members(bundle))
    assert "mavlink.key" in refusal(lambda: mavlink_key(str(bundle)))


def test_a_list_of_brackets_is_a_damaged_list(bundle: Path) -> None:
    (bundle / "members.json").write_text('{"members":' + "[" * 100_000)
    assert "members.json is damaged" in refusal(lambda: read_members(bundle))
    (bundle / "members.json").write_text('{"more":' + "[" * 100_000)
    assert "members.json is damaged" in refusal(lambda: read_members(bundle))


@pytest.mark.parametrize("make", [make_zero, make_fifo])
def test_a_client_process_ends_with_a_sentence_where_it_hung(bundle: Path, make: Callable[[Path], None]) -> None:
    (bundle / "key.pem").unlink()
    make(bundle / "key.pem")
    done = subprocess.run(
        [sys.executable, "-m", "jezero.cli.main", "status", "--router", ADDRESS, "--keys", str(bundle)],
        capture_output=True, text=True, timeout=LATEST_S, check=False,
    )  # fmt: skip
    assert done.returncode == 2 and "key.pem is no plain file" in " ".join(done.stderr.split())
