"""How pytest runs these tests: with the settings of the project and its conftest files, in a folder of small tests."""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TIMEOUT_S = 240.0
FIRST_TIME = """
from pathlib import Path
import pytest

def first_time(name):
    path = Path(name)
    seen = path.exists()
    path.touch()
    return not seen

def note(text):
    with open("notes", "a") as file:
        file.write(text + "\\n")
"""
SHARED = """
@pytest.fixture(scope="module")
def broken_once():
    if first_time("broken"):
        raise OSError("no port is free")
    note("start broken_once")
    yield
    note("stop broken_once")

@pytest.fixture(scope="module")
def steady():
    note("start steady")
    yield
    note("stop steady")

def test_fixture(broken_once, steady): pass
def test_neighbour(steady): note("neighbour")
def test_call(steady):
    if first_time("call"):
        raise ValueError("the machine is busy")
"""
FOUR = """
@pytest.mark.parametrize("number", range(4))
def test_fails_once(number):
    assert not first_time(f"failed {number}"), "a busy machine"
"""
HANGS = """
@pytest.mark.timeout(3)
def test_hangs():
    while True:
        pass
"""
CHILD = """
import signal, subprocess, sys
def test_child():
    program = "import signal; print(signal.getsignal(signal.SIGINT) == signal.default_int_handler)"
    assert subprocess.check_output([sys.executable, "-c", program]) == b"True\\n"
"""
pytestmark = pytest.mark.long
PARALLEL = ("-n", "2", "--dist", "loadgroup")


def ignore_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def run(folder: Path, text: str, words: tuple[str, ...], where: str = "system") -> "subprocess.CompletedProcess[str]":
    """Run one file of tests as `make test` would, in the background of a script.

    Args:
        where: folder of the file.
    """
    # Not "tests": the conftest file imports from the real folder of this name.
    checks = folder / "checks"
    (checks / "system").mkdir(parents=True)
    (checks / where).mkdir(exist_ok=True)
    shutil.copy(ROOT / "pyproject.toml", folder)
    shutil.copy(ROOT / "tests" / "conftest.py", checks)
    shutil.copy(ROOT / "tests" / "system" / "conftest.py", checks / "system")
    (checks / where / "test_small.py").write_text(FIRST_TIME + text)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTEST_ADDOPTS", None)
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "checks", *words],
        cwd=folder,
        env=environment,
        preexec_fn=ignore_interrupts,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )


@pytest.mark.parametrize("words", [(), PARALLEL], ids=["one process", "workers"])
def test_a_failure_of_real_processes_is_run_again_with_new_fixtures_and_printed_with_its_reason(
    tmp_path: Path, words: tuple[str, ...]
) -> None:
    done = run(tmp_path, SHARED, words)
    assert done.returncode == 0, done.stdout
    summary = done.stdout.partition("rerun test summary info")[2]
    assert re.findall(r"^(RERUN|PASSED) .*::(\w+)", summary, re.MULTILINE) == [
        (word, test) for test in ("test_fixture", "test_call") for word in ("RERUN", "PASSED")
    ]
    assert "no port is free" in summary and "the machine is busy" in summary
    assert "3 passed, 2 rerun" in summary
    assert (tmp_path / "notes").read_text().splitlines() == [
        *("start broken_once", "start steady", "neighbour", "stop steady", "stop broken_once"),
        *("start steady", "stop steady"),
    ]


def test_a_fourth_failure_is_not_run_again_and_fails_the_run(tmp_path: Path) -> None:
    done = run(tmp_path, FOUR, PARALLEL)
    assert done.returncode == 1 and "1 failed, 3 passed, 3 rerun" in done.stdout, done.stdout


def test_a_second_run_has_the_whole_timeout_and_no_more(tmp_path: Path) -> None:
    done = run(tmp_path, HANGS, ())
    assert done.returncode == 1 and "1 failed, 1 rerun" in done.stdout, done.stdout


def test_outside_of_system_nothing_is_run_again_and_programs_can_be_interrupted_in_the_background(
    tmp_path: Path,
) -> None:
    done = run(tmp_path, FOUR + CHILD, PARALLEL, where="scenario")
    assert done.returncode == 1 and "4 failed, 1 passed in" in done.stdout, done.stdout
