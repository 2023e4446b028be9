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

from tests.deploy.test_image import HASHES, copied

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
    for name in set(copied()) - {HASHES}:  # `make image` writes it, and pip reads it before it builds the wheel
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
    assert (
        f"{installed.parent}" in refused.stderr
        and "there are control, estimation, ground, onboard, rover, sim" in refused.stderr
    )


@pytest.mark.long
def test_the_wheel_flies(installed: Path, tmp_path: Path) -> None:
    done = run(installed / "jezero", "fly", "--fast", "--seed", "1", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    flight = json.loads(done.stdout.splitlines()[-1])
    assert flight["result"] == "succeeded"
    assert flight["touchdown_error_m"] < 1.0


CLIENT = """
import jezero, jezero.aio, jezero.client.dataset
from jezero import Vehicle, Unreachable
try:
    Vehicle.connect("uav1", router="tcp/127.0.0.1:1", timeout_s=0.5)
except Unreachable as error:
    print(error)
try:
    import jezero.recording
except ModuleNotFoundError as error:
    print(error)
"""


def interpreter(version: str) -> Path | None:
    """An interpreter that works: a shim of pyenv may be on the path for a version that is not chosen."""
    found = [*Path.home().glob(f".pyenv/versions/{version}.*/bin/python{version}")]
    if named := shutil.which(f"python{version}"):
        found.insert(0, Path(named))
    works = (path for path in found if subprocess.run([path, "-V"], capture_output=True, check=False).returncode == 0)
    return next(works, None)


@pytest.mark.parametrize("version", ["3.12", "3.13"])
def test_the_client_alone_works_with_later_versions_of_python(wheel: Path, tmp_path: Path, version: str) -> None:
    python = interpreter(version)
    if python is None:
        pytest.skip(f"there is no python{version} on this machine")
    subprocess.run([python, "-m", "venv", str(tmp_path / "venv")], check=True)
    new = tmp_path / "venv" / "bin" / "python"
    installed = run(new, "-m", "pip", "--disable-pip-version-check", "install", "--quiet", str(wheel), cwd=tmp_path)
    if installed.returncode != 0:
        pytest.skip(f"the client's dependencies can't be had for python{version}: {installed.stderr[-300:]}")
    done = run(new, "-c", CLIENT, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    unreachable, extra = done.stdout.splitlines()
    assert "no router at tcp/127.0.0.1:1" in unreachable
    assert extra == "jezero.recording needs mcap and numpy, which are not installed: pip install 'jezero[cli]'"


def test_only_the_extra_with_the_simulator_is_bound_to_one_version_of_python(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
    text = zipfile.ZipFile(wheel).read(metadata).decode()
    assert "Requires-Python: >=3.11\n" in text
    assert [line for line in text.splitlines() if "pybullet" in line and line.startswith("Requires-Dist")] == [
        "Requires-Dist: pybullet>=3.2.7; extra == 'sim'"
    ]
    assert "python_version" not in text


TYPED = """
import asyncio
from jezero import Aborted, Vehicle, aio
from jezero.client.images import Picture
from jezero.schemas import topics
from jezero.schemas.goals import MoveResult
from jezero.schemas.state import Odometry


def fly(uav: Vehicle) -> tuple[float, float, float]:
    goal = uav.go_to(0.0, -2.0, -4.0, frame="world", do_takeoff=True)
    distances_m: list[float] = [feedback.distance_m for feedback in goal.feedback()]
    try:
        result: MoveResult = goal.result()
    except Aborted as error:
        print(error.reason, distances_m)
        raise
    return result.pos_uav_ned_m


def photograph(uav: Vehicle) -> list[Picture]:
    return list(uav.get_images((0.0, 0.0, -4.0), radius_m=2.0, num_images=4).pictures())


def speed_mps(odometry: Odometry) -> float:
    return abs(odometry.vel_uav_ned_mps[0])


async def fly_and_watch(uav: aio.Vehicle) -> MoveResult:
    async with uav.subscribe(topics.ODOMETRY) as stream:
        print(speed_mps(await stream.next()), (await uav.odometry()).pos_uav_ned_m)
    goal = await uav.takeoff(altitude_m=2.0)
    async for feedback in goal:
        print(feedback.distance_m)
    return await goal.result()


async def main() -> None:
    async with await aio.Vehicle.connect("uav1") as uav:
        await fly_and_watch(uav)


with Vehicle.connect("uav1") as uav:
    north_m, east_m, down_m = fly(uav)
    uav.subscribe(topics.ODOMETRY, speed_mps)
    print(len(photograph(uav)[0].pixels), uav.latest(topics.UWB).t_ns)
asyncio.run(main())
"""
MISTAKES = {
    'uav.takeoff(altitude="2")\n': "altitude_m",
    "uav.go_to(0.0, 0.0, -3.0).result().position\n": 'has no attribute "position"',
    "asyncio.run(main()).pos_uav_ned_m\n": 'has no attribute "pos_uav_ned_m"',
    "uav.camera.snap(3)\n": 'expected "Path | str"',
    "uav.subscribe(topics.UWB, speed_mps)\n": "subscribe",
}
"""Lines that are wrong, each with a part of the error that names it."""


def test_a_users_script_is_checked_strictly_against_the_wheels_types(installed: Path, tmp_path: Path) -> None:
    script, wrong = tmp_path / "script.py", tmp_path / "wrong.py"
    script.write_text(TYPED)
    wrong.write_text(TYPED + "".join(MISTAKES))
    mypy: list[str | Path] = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--python-executable",
        installed / "python",
        "--cache-dir",
        "cache",
    ]
    done = run(*mypy, script, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "Success: no issues found in 1 source file\n"), done.stderr
    errors = [line for line in run(*mypy, wrong, cwd=tmp_path).stdout.splitlines() if ": error: " in line]
    assert len(errors) == len(MISTAKES), errors
    for error, part in zip(errors, MISTAKES.values(), strict=True):
        assert part in error
