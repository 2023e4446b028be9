"""Whoever lacks an optional package reads which extra has it."""

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from jezero.base.extras import EXTRAS

ROOT = Path(__file__).parents[2]
OPTIONAL = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
NEEDED_ALWAYS = {"zenoh", "msgspec", "cryptography", "jezero"}
INSTALLED_BY_THE_USER = {"pandas"}
OF_ROS = {"launch", "rcl_interfaces", "rclpy"}
"""They come with ROS 2; `jezero ros2` says so."""


def imported_packages() -> set[str]:
    """Packages that a module of jezero imports, wherever in it."""
    found: set[str] = set()
    for top in ("jezero", "schemas", "services", "deploy"):
        for file in (ROOT / top).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.Import):
                    found.update(alias.name.partition(".")[0] for alias in node.names)
                elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                    found.add(node.module.partition(".")[0])
    return found


def test_every_optional_package_that_is_imported_has_its_extra() -> None:
    known = sys.stdlib_module_names | NEEDED_ALWAYS | INSTALLED_BY_THE_USER | OF_ROS
    assert imported_packages() - known <= set(EXTRAS)


def test_every_extra_that_is_named_exists() -> None:
    assert set(EXTRAS.values()) <= set(OPTIONAL)


def without(packages: str, code: str) -> str:
    """The last line of the error of a program that runs where some packages are missing; "" without an error."""
    blocked = f"import sys; sys.modules.update(dict.fromkeys({packages.split()!r})); {code}"
    done = subprocess.run([sys.executable, "-c", blocked], capture_output=True, text=True, timeout=60, check=False)
    return done.stderr.strip().rpartition("\n")[2]


@pytest.mark.parametrize(
    ("packages", "code", "sentence"),
    [
        ("mcap", "import jezero.recording", "jezero.recording needs mcap, which is not installed: ...[cli]"),
        ("yaml", "import jezero.mission_files", "jezero.mission_files needs yaml, which is not installed: ...[cli]"),
        ("matplotlib", "import jezero.report", "jezero.report needs matplotlib, which is not installed: ...[report]"),
        ("cv2", "import jezero.mapping", "jezero.mapping needs cv2, which is not installed: ...[services]"),
        ("scipy", "import jezero.tuning", "jezero.tuning needs scipy, which is not installed: ...[services]"),
        ("mcap", "import jezero.replay", "jezero.replay needs mcap, which is not installed: ...[cli]"),
        (
            "PIL",
            "from jezero.client.dataset import Dataset; Dataset('nowhere')",
            "a dataset of images needs PIL, which is not installed: ...[cli]",
        ),
        ("click", "import jezero.cli.main", "jezero's command line is an extra: ...[cli]"),
    ],
)
def test_a_missing_package_is_named_with_its_extra(packages: str, code: str, sentence: str) -> None:
    expected = re.sub(r"\.\.\.(\[[\w,]+\])", r"pip install 'jezero\1'", sentence)
    assert without(packages, code).endswith(expected)


@pytest.mark.parametrize(
    ("packages", "words", "sentence"),
    [
        (
            "matplotlib",
            "report .",
            "Error: this command needs matplotlib, which is not installed: ...[report,services]",
        ),
        ("mcap", "recording info .", "Error: this command needs mcap, which is not installed: ...[cli]"),
        ("cv2", "map .", "Error: this command needs cv2, which is not installed: ...[services]"),
        ("pybullet", "up -d", "Error: this command needs pybullet, which is not installed: ...[sim]"),
        ("foxglove", "watch --foxglove", "Error: Foxglove's library is an extra: ...[foxglove]"),
        ("nicegui", "ground", "Error: the ground station is an extra: ...[ground]"),
        ("pybullet", "fly --fast", "Error: this command needs pybullet, which is not installed: ...[sim]"),
    ],
)
def test_a_command_without_its_package_is_one_sentence(packages: str, words: str, sentence: str) -> None:
    expected = re.sub(r"\.\.\.(\[[\w,]+\])", r"pip install 'jezero\1'", sentence)
    code = f"from jezero.cli.main import main; main({words.split()!r}, prog_name='jezero')"
    assert without(packages, code) == expected


@pytest.mark.parametrize(
    ("words", "extras"),
    [
        ("up", "sim"),
        ("up --profile onboard", "services"),
        ("report .", "report,services"),
        ("fly", "cli"),
        ("fly --fast", "sim"),
        ("mission run demonstration", "cli"),
        ("nonsense", "cli"),
    ],
)
def test_the_client_alone_is_told_all_extras_of_a_command_at_once(words: str, extras: str) -> None:
    code = f"sys.argv[1:] = {words.split()!r}; import jezero.cli.main"
    expected = f"jezero's command line is an extra: pip install 'jezero[{extras}]'"
    assert without(" ".join(EXTRAS), code) == expected


def test_a_stack_without_several_packages_names_them_all() -> None:
    code = "from jezero.cli.main import main; main(['up', '-d'], prog_name='jezero')"
    sentence = "Error: this command needs pybullet and pymavlink, which are not installed: pip install 'jezero[sim]'"
    assert without("pybullet pymavlink", code) == sentence
