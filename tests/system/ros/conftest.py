"""A ROS 2 environment from PyPI, in a venv of its own: for tests only, as nobody signs these packages."""

import os
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

import pytest

PACKAGES = (
    "ros-kilted-rclpy==9.1.2",
    "ros-kilted-common-interfaces==5.5.1",
    "ros-kilted-rmw-fastrtps-cpp==9.3.3",
    "ros-kilted-rmw-dds-common==4.0.0",
    "ros-kilted-fastdds==3.2.3",
)
ROOT = Path(__file__).resolve().parents[3]
INSTALL_TIMEOUT_S = 240.0
DOMAIN_ID_MAX = 100
"""Each process of pytest has a domain of ROS, so that tests that run at the same time don't hear each other."""


@dataclass(frozen=True)
class Ros:
    """A ROS 2 environment.

    Attributes:
        python: its interpreter, which also finds jezero and what jezero needs.
    """

    python: str

    def environment(self, base: dict[str, str]) -> dict[str, str]:
        """Environment variables of a process in it."""
        left_out = ("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH")
        kept = {name: value for name, value in base.items() if name not in left_out}
        own = {
            "ROS_DOMAIN_ID": str(1 + os.getpid() % DOMAIN_ID_MAX),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_PYTHON_CHECK_FIELDS": "1",
            "PYTHONUNBUFFERED": "1",
        }
        return kept | own


@pytest.fixture(scope="session")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Ros:
    """A ROS 2 environment; the tests are skipped where it can't be had."""
    folder = tmp_path_factory.mktemp("ros") / "venv"
    subprocess.run([sys.executable, "-m", "venv", folder], check=True, timeout=INSTALL_TIMEOUT_S)
    python = str(folder / "bin" / "python")
    words = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PACKAGES]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=INSTALL_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip("rclpy can't be had from PyPI: pip takes too long")
    if done.returncode != 0:
        pytest.skip(f"rclpy can't be had from PyPI: {done.stderr.strip().splitlines()[-1]}")
    packages = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        capture_output=True,
        text=True,
        check=True,
    )
    # Behind its own packages, so that ROS gets the versions that it came with.
    here = (str(ROOT), sysconfig.get_path("purelib"))
    (Path(packages.stdout.strip()) / "jezero-of-the-tests.pth").write_text("\n".join(here) + "\n")
    return Ros(python)
