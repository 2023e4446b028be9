"""The wheel in an environment of its own: it is complete, and it flies."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from tests.deploy.test_image import copied

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of this tree."""
    return build(ROOT, tmp_path_factory.mktemp("wheel"))


def build(source: Path, folder: Path) -> Path:
    """Build a wheel without the network."""
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`bin` of an environment with the wheel; its dependencies come from the environment of the tests."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    python = folder / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "--disable-pip-version-check"]
    subprocess.run([*pip, "install", "--quiet", "--no-deps", "--no-index", str(wheel)], check=True)
    (site,) = folder.glob("lib/python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "bin"


def run(*words: str | Path, cwd: Path) -> "subprocess.CompletedProcess[str]":
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("JEZERO_", "PYTHON"))}
    return subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True, timeout=200, check=False)


def test_the_wheel_has_every_package_and_data_file(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    files = [path for top in ("jezero", "schemas", "services", "deploy") for path in (ROOT / top).rglob("*")]
    relative = [
        path.relative_to(ROOT).as_posix() for path in files if path.is_file() and "__pycache__" not in path.parts
    ]
    wanted = [name if name.startswith("jezero/") else f"jezero/{name}" for name in relative]
    assert len(wanted) > 50
    assert sorted(set(wanted) - set(names)) == []
    assert not [name for name in names if "__pycache__" in name or name.startswith(("schemas", "services", "deploy"))]


def test_the_files_that_the_image_copies_make_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    context = tmp_path / "context"
    context.mkdir()
    for name in copied():
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, context / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, context)
    image_wheel = build(context, tmp_path)
    assert sorted(zipfile.ZipFile(image_wheel).namelist()) == sorted(zipfile.ZipFile(wheel).namelist())


def test_the_command_and_its_files_come_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    where = run(installed / "python", "-c", "import jezero; print(jezero.__file__)", cwd=tmp_path).stdout
    assert Path(where).is_relative_to(installed.parent)
    assert "takeoff" in run(installed / "jezero", "--help", cwd=tmp_path).stdout
    assert run(installed / "jezero", "--version", cwd=tmp_path).stdout.startswith("jezero")
    refused = run(installed / "jezero", "up", "--profile", "nobody", cwd=tmp_path)
    assert f"{installed.parent}" in refused.stderr and "there are control, estimation, sim" in refused.stderr


def test_the_wheel_flies(installed: Path, tmp_path: Path) -> None:
    done = run(installed / "jezero", "fly", "--fast", "--seed", "1", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    flight = json.loads(done.stdout.splitlines()[-1])
    assert flight["result"] == "succeeded"
    assert flight["touchdown_error_m"] < 1.0
