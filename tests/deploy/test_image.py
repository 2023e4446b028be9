"""The container image, as far as it can be checked without a container runtime."""

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import yaml

from jezero.deploy.hashed_requirements import requirements
from jezero.deploy.launcher.compose import parse

pytestmark = pytest.mark.process

ROOT = Path(__file__).resolve().parents[2]
DOCKERFILE = ROOT / "deploy" / "Dockerfile"
COMPOSE = ROOT / "deploy" / "compose.yaml"
HASHES = "image-requirements.txt"
"""File that `make image` writes."""


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
    assert re.fullmatch(r"python:3\.11-slim@sha256:[0-9a-f]{64}", words["FROM"])
    assert int(words["USER"]) > 0
    after_user = [word for word, _ in instructions()]
    assert after_user[after_user.index("USER") :] == ["USER", "CMD"]


def test_the_image_has_mesa_and_the_pinned_packages_from_where_the_tools_look_by_themselves() -> None:
    apt, packages, own = (rest.split(" && ") for word, rest in instructions() if word == "RUN")
    assert {"libegl1", "libgl1", "libgl1-mesa-dri"} <= set(apt[1].split())
    assert {"--require-hashes", "--no-build-isolation", HASHES} <= set(packages[0].split())
    assert {"--no-index", "--no-deps", "--no-build-isolation"} <= set(own[0].split())


def test_everything_that_is_copied_exists_and_reaches_the_build() -> None:
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert kept == set(copied())
    assert all((ROOT / source).exists() for source in copied() if source != HASHES)
    assert HASHES in (ROOT / ".gitignore").read_text().splitlines()


def test_the_compose_file_builds_the_image_that_it_names() -> None:
    for name, service in yaml.safe_load(COMPOSE.read_text())["services"].items():
        context = (COMPOSE.parent / service["build"]["context"]).resolve()
        assert (name, service["image"], context) == (name, "jezero", ROOT)
        assert context / service["build"]["dockerfile"] == DOCKERFILE


def test_no_service_gets_rights_or_writes_outside_its_volume_and_memory() -> None:
    document = yaml.safe_load(COMPOSE.read_text())
    for name, service in document["services"].items():
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"] and service["security_opt"] == ["no-new-privileges:true"], name
        assert "privileged" not in service and "cap_add" not in service and "user" not in service, name
        written = [volume for volume in service["volumes"] if not volume.endswith(":ro")]
        assert written == [f"run:{dict(instructions())['ENV'].partition('=')[2]}"], name
    assert set(document["volumes"]) == {"run", "keys"}


@pytest.mark.parametrize(
    ("variables", "mounted"),
    [({}, "keys:/keys:ro"), ({"JEZERO_KEYS": "/keys/uav1"}, "/keys/uav1:/keys/uav1:ro")],
)
def test_a_bundle_is_mounted_read_only_under_its_own_name(variables: dict[str, str], mounted: str) -> None:
    volumes = yaml.safe_load(COMPOSE.read_text())["services"]["router"]["volumes"]
    keys = volumes[1].replace("${JEZERO_KEYS:-keys}", variables.get("JEZERO_KEYS", "keys"))
    assert keys.replace("${JEZERO_KEYS:-/keys}", variables.get("JEZERO_KEYS", "/keys")) == mounted
    assert parse(COMPOSE.read_text(), variables)["router"].environment["JEZERO_KEYS"] == variables.get(
        "JEZERO_KEYS", ""
    )


def test_make_writes_the_hashes_of_the_packages_and_builds_the_image_with_docker() -> None:
    done = subprocess.run(
        ["make", "--dry-run", "--always-make", "image"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    commands = done.stdout.replace("\\\n", " ")
    assert "-c constraints.txt" in commands and "'.[sim,ground]' hatchling" in commands
    assert f"> {HASHES}.new" in commands
    assert "docker build --tag jezero --file deploy/Dockerfile ." in commands


def make_wheel(folder: Path, text: str) -> Path:
    """A package `probe` 1.0 with one module."""
    folder.mkdir(exist_ok=True)
    path = folder / "probe-1.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr("probe.py", text)
        wheel.writestr("probe-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: Probe\nVersion: 1.0\n")
        wheel.writestr("probe-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        wheel.writestr("probe-1.0.dist-info/RECORD", "")
    return path


def test_pip_installs_the_files_of_the_list_and_refuses_an_exchanged_one(tmp_path: Path) -> None:
    make_wheel(tmp_path / "wheels", "x = 1")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}
    environment["PIP_CONFIG_FILE"] = os.devnull

    def pip(*words: str) -> "subprocess.CompletedProcess[str]":
        words = (
            "install",
            "--disable-pip-version-check",
            "--target",
            str(tmp_path / "fresh"),
            "--no-index",
            "--find-links",
            str(tmp_path / "wheels"),
            *words,
        )
        return subprocess.run(
            [sys.executable, "-m", "pip", *words],
            env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip

    report, hashes = tmp_path / "report.json", tmp_path / HASHES
    assert pip("--dry-run", "--ignore-installed", "--report", str(report), "probe").returncode == 0
    hashes.write_text(requirements(json.loads(report.read_text())))
    assert re.fullmatch(r"probe==1\.0 --hash=sha256:[0-9a-f]{64}\n", hashes.read_text())
    required = ("--require-hashes", "--no-build-isolation", "--requirement", str(hashes))
    assert pip("--dry-run", *required).returncode == 0
    make_wheel(tmp_path / "wheels", "x = 'exchanged'")
    refused = pip(*required)
    assert refused.returncode != 0 and "DO NOT MATCH THE HASHES" in refused.stderr


def test_this_project_has_no_hash_and_a_package_without_one_is_refused() -> None:
    def package(origin: dict[str, object]) -> dict[str, object]:
        return {"metadata": {"name": "Some", "version": "1"}, "download_info": origin}

    assert requirements({"install": [package({"dir_info": {}})]}) == ""
    with pytest.raises(ValueError, match="Some 1 has no sha256"):
        requirements({"install": [package({"vcs_info": {}})]})
