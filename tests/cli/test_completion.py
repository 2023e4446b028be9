"""TAB in bash, as the script that click writes asks for names."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.process

JEZERO = Path(sys.executable).with_name("jezero")


def completed(line: str) -> list[str]:
    """What bash would offer for the last word of a line."""
    words = line.split(" ")
    variables = {"_JEZERO_COMPLETE": "bash_complete", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
    done = subprocess.run([JEZERO], env={**os.environ, **variables}, capture_output=True, text=True, check=True)
    assert not done.stderr
    return done.stdout.split()


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("jezero miss", ["plain,mission"]),
        ("jezero land", ["plain,land_on_spot"]),
        ("jezero action send go", ["plain,go_to"]),
        ("jezero action send go_to tar", ["value,target_ned_m="]),
        ("jezero action send --yes takeoff alt", ["value,altitude_m="]),
        ("jezero action send go_to speed_mps = 2 s", []),
        ("jezero action send goto tar", []),
        ("jezero info actions take", ["plain,takeoff"]),
        ("jezero mission check demo", ["plain,demonstration"]),
        ("jezero mission check my.y", ["file,my.y"]),
        ("jezero fence set my", ["file,my"]),
        ("jezero logs vehicle", ["plain,vehicle_bridge"]),
        ("jezero ps --healthy est", ["plain,estimator"]),
        ("jezero up --profile on", ["plain,onboard"]),
        ("jezero recording export --topic estimate/ro", ["plain,estimate/rover"]),
    ],
)
def test_a_name_is_completed(line: str, offered: list[str]) -> None:
    assert completed(line) == offered


def test_bash_takes_the_script_and_offers_a_name(tmp_path: Path) -> None:
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("there is no bash on this machine")
    script = subprocess.run(
        [JEZERO], env={**os.environ, "_JEZERO_COMPLETE": "bash_source"}, capture_output=True, text=True, check=True
    ).stdout
    (tmp_path / "complete.bash").write_text(script)
    press_tab = (
        f". {tmp_path}/complete.bash; COMP_WORDS=(jezero action send take); COMP_CWORD=3;"
        "_jezero_completion jezero take send; echo ${COMPREPLY[@]}"
    )
    path = f"{JEZERO.parent}:{os.environ['PATH']}"
    done = subprocess.run(
        [bash, "--norc", "-ic", press_tab], env={**os.environ, "PATH": path}, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["takeoff"]
