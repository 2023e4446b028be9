"""A package outside the tree, as `jezero new action` writes it, flies over real processes and is judged."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system.conftest import JEZERO, Stack, new_stack
from tests.system.test_plain_zenoh import PLAIN_CLIENT, zenoh_get

NAME = "survey_spiral"
BROKEN = """

class BrokenPlanner:
    def __init__(self, settings, config):
        pass

    def plan(self, goal, status):
        raise ZeroDivisionError("no plan")

BROKEN = replace(ACTION, action=replace(ACTION.action, name="broken"), planner=BrokenPlanner)


class Camera(SurveySpiral):
    def step(self, t_ns, state):
        return msgspec.structs.replace(super().step(t_ns, state), pitch_camera_rad=-0.5)


class CameraPlanner(SurveySpiralPlanner):
    def plan(self, goal, status):
        return Plan(partial(Camera, goal, self._settings, self._config))

UNDECLARED = replace(ACTION, action=replace(ACTION.action, name="undeclared"), planner=CameraPlanner)
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a package that `jezero new action` wrote, with two more actions.

    The planner of the one raises, and the other points the camera, which it does not declare.
    """
    into = tmp_path_factory.mktemp("package")
    subprocess.run([*JEZERO, "new", "action", NAME, "--into", str(into)], check=True, capture_output=True)
    folder = into / NAME
    module = folder / "src" / f"{NAME}.py"
    module.write_text("from dataclasses import replace\n\nimport msgspec\n" + module.read_text() + BROKEN)
    pyproject = folder / "pyproject.toml"
    entry = f'{NAME} = "{NAME}:ACTION"\n'
    pyproject.write_text(
        pyproject.read_text().replace(entry, f'{entry}broken = "{NAME}:BROKEN"\nundeclared = "{NAME}:UNDECLARED"\n')
    )
    return folder


@pytest.fixture(scope="module")
def environment(package: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Environment in which the package is installed, beside jezero."""
    site = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", str(site), str(package)], check=True, capture_output=True)
    paths = [str(site), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


@pytest.fixture(scope="module")
def hovering(environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A stack whose launcher found the package; the vehicle hovers 3 m up."""
    with new_stack(tmp_path_factory.mktemp("stack")) as stack:
        stack.environment["PYTHONPATH"] = environment["PYTHONPATH"]
        stack.up()
        stack.jezero("takeoff", "3")
        yield stack


@pytest.mark.long
def test_its_own_tests_pass(package: Path, environment: dict[str, str]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(package / "tests")],
        env=environment,
        cwd=package,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 passed" in done.stdout


@pytest.mark.long
def test_the_command_line_lists_and_flies_it(hovering: Stack) -> None:
    listed = [json.loads(line) for line in hovering.jezero("action", "list", "--json").stdout.splitlines()]
    assert {"action": NAME, "from": "package", "goal": {"side_m": "1.0", "on_client_loss": '"continue"'}} in listed
    lines = hovering.jezero("action", "send", NAME, "side_m=2", "--json").stdout.splitlines()
    replies = [json.loads(line) for line in lines]
    assert replies[-1]["outcome"] == "succeeded"
    assert len([reply for reply in replies if reply["type"] == "feedback"]) > 20


def test_wrong_words_are_explained(hovering: Stack) -> None:
    unknown = hovering.jezero("action", "send", NAME, "edge_m=2", check=False)
    assert unknown.returncode == 2
    assert "there is no field 'edge_m'; did you mean 'side_m'? Known are side_m" in unknown.stderr
    too_long = hovering.jezero("action", "send", NAME, "side_m=51", check=False)
    assert too_long.returncode == 2
    assert "side_m" in too_long.stderr


@pytest.mark.long
def test_the_sdk_and_the_status_know_it_by_name(hovering: Stack) -> None:
    script = f"""
from jezero import Vehicle
with Vehicle.connect({hovering.instance.vehicle!r}, router={hovering.instance.router!r}) as uav:
    goal = uav.send({NAME!r}, side_m=1.0)
    statuses = [uav.status() for _ in goal.feedback()]
    assert goal.result().completed
    assert (14, {NAME!r}) in [(status.code, status.action) for status in statuses]
"""
    done = subprocess.run(
        [sys.executable, "-c", script], env=hovering.environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_plain_zenoh_gets_its_description(hovering: Stack) -> None:
    (description,) = zenoh_get(hovering, f"action/{NAME}/description")
    assert description["endpoint"] == f"@action/{NAME}"
    assert '"side_m"' in json.dumps(description["goal"])
    (refusal,) = zenoh_get(hovering, f"@action/{NAME}s?side_m=2")
    assert f"{NAME}, broken" in refusal["reason"] or f"broken, {NAME}" in refusal["reason"]
    assert f"did you mean '{NAME}'?" in refusal["reason"]
    endpoints = [json.loads(line) for line in hovering.jezero("info", "endpoints", "--json").stdout.splitlines()]
    assert f"action/{NAME}/description" in [row["endpoint"] for row in endpoints]


@pytest.mark.long
def test_a_plain_zenoh_session_flies_it(hovering: Stack) -> None:
    selector = f"jezero/{hovering.instance.vehicle}/@action/{NAME}?side_m=1;_time=[..]"
    command = [sys.executable, "-c", PLAIN_CLIENT, hovering.instance.router, selector]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    replies = [json.loads(line) for line in done.stdout.splitlines()]
    assert [replies[0]["type"], replies[-1].get("outcome")] == ["accepted", "succeeded"]


def test_a_planner_that_raises_refuses_its_goal_and_its_server_lives(hovering: Stack) -> None:
    before = hovering.processes()["broken"]
    for _ in range(2):
        refused = hovering.jezero("action", "send", "broken", check=False)
        assert refused.returncode == 3
        assert "broken failed in plan: ZeroDivisionError: no plan" in refused.stderr
    assert hovering.processes()["broken"] == before
    assert "ZeroDivisionError" in hovering.jezero("logs", "broken").stdout


@pytest.mark.long
def test_a_camera_that_is_not_declared_ends_its_goal_and_its_server_lives(hovering: Stack) -> None:
    before = hovering.processes()["undeclared"]
    for _ in range(2):
        sent = hovering.jezero("action", "send", "undeclared", "side_m=2", check=False)
        assert sent.returncode != 0
        assert "undeclared failed in step: Move.pitch_camera_rad points the camera: declare the Action" in sent.stderr
    assert hovering.processes()["undeclared"] == before
    assert json.loads(hovering.jezero("status", "--json").stdout)["name"] == "HOVER"


@pytest.mark.slow
def test_the_campaign_flies_and_judges_it(environment: dict[str, str]) -> None:
    done = subprocess.run(
        [*JEZERO, "campaign", "--model", "point-mass", "--seeds", "0..5", "-v"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"sends {NAME}" in done.stdout
