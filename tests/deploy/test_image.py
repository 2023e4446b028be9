"""The container image, as far as it can be checked without a container runtime."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
DOCKERFILE = ROOT / "deploy" / "Dockerfile"


def instructions() -> list[tuple[str, str]]:
    """Each instruction's word and the rest, on one line, without comments."""
    lines = [line for line in DOCKERFILE.read_text().splitlines() if not line.startswith("#")]
    joined = "\n".join(lines).replace("\\\n", " ")
    return [(word, rest.strip()) for word, _, rest in (line.partition(" ") for line in joined.splitlines() if line)]


def copied() -> list[str]:
    """Files and folders of this repository that the image is built from."""
    return [source for word, rest in instructions() if word == "COPY" for source in rest.split()[:-1]]


def linter() -> str | None:
    return shutil.which("hadolint", path=str(Path(sys.executable).parent)) or shutil.which("hadolint")


@pytest.mark.skipif(linter() is None, reason="hadolint is not installed")
def test_the_linter_of_dockerfiles_finds_nothing() -> None:
    done = subprocess.run([str(linter()), str(DOCKERFILE)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")


def test_the_image_is_a_slim_python_that_runs_as_an_unprivileged_user() -> None:
    words = dict(instructions())
    assert words["FROM"] == "python:3.11-slim"
    assert int(words["USER"]) > 0
    after_user = [word for word, _ in instructions()]
    assert after_user[after_user.index("USER") :] == ["USER", "CMD"]


def test_the_image_has_mesa_and_the_pinned_packages_from_where_the_tools_look_by_themselves() -> None:
    apt, pip = (rest.split(" && ") for word, rest in instructions() if word == "RUN")
    assert {"libegl1", "libgl1", "libgl1-mesa-dri"} <= set(apt[1].split())
    assert pip[0].rstrip() == "pip install --no-cache-dir --constraint constraints.txt '.[sim,ground]'"


def test_everything_that_is_copied_exists_and_reaches_the_build() -> None:
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert kept == set(copied())
    assert all((ROOT / source).exists() for source in copied())


def test_the_compose_file_builds_the_image_that_it_names() -> None:
    file = ROOT / "deploy" / "compose.yaml"
    for name, service in yaml.safe_load(file.read_text())["services"].items():
        context = (file.parent / service["build"]["context"]).resolve()
        assert (name, service["image"], context) == (name, "jezero", ROOT)
        assert context / service["build"]["dockerfile"] == DOCKERFILE
