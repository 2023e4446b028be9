"""The life of a goal on the command line: its plan, which is confirmed if it is long, and the keys that pause it."""

import json
from collections.abc import Iterator
from typing import Any

import pytest
from click.testing import CliRunner

from jezero import Vehicle
from jezero.cli.goals import GoalKeys, minutes
from jezero.cli.main import main
from jezero.cli.terminal import Printer
from jezero.client import Refused
from jezero.schemas.actions import PlanReply, Result
from jezero.schemas.goals import GoToGoal, LandOnSpotGoal, LandResult
from jezero.schemas.topics import GO_TO, LAND_ON_SPOT
from tests.client.rig import ACCEPTED, Server, a_feedback, a_result, endpoint, server, vehicle

__all__ = ["endpoint", "server", "vehicle"]

LONG = PlanReply(
    accepted=True,
    duration_s=312.0,
    distance_m=318.0,
    battery_used=0.27,
    battery_remaining=0.8,
    battery_critical=0.07,
)


@pytest.fixture
def far(server: Server, vehicle: Vehicle, endpoint: str) -> list[str]:
    """Words of a command whose flight takes five minutes."""
    server.serve("@action/go_to/plan", LONG)
    server.serve("@action/go_to", ACCEPTED, a_feedback(2.0), a_result())
    return ["target", "300", "0", "-9", "--vehicle", "v", "--router", endpoint]


def goals(server: Server) -> list[Any]:
    return [goal for name, _, goal in server.asked if name == "@action/go_to"]


def run(words: list[str], typed: str | None = None) -> Any:
    return CliRunner().invoke(main, words, input=typed)


def test_a_script_that_does_not_say_yes_gets_the_plan_and_flies_nothing(far: list[str], server: Server) -> None:
    done = run(far)
    assert done.exit_code == 2
    assert "go_to: 5 min 12 s, 318 m, 27 % of the battery (80 % left, 7 % must be left)" in done.stdout
    assert "add --yes" in done.stderr
    assert goals(server) == []


def test_a_script_that_says_yes_flies(far: list[str], server: Server) -> None:
    done = run([*far, "--yes"])
    assert done.exit_code == 0, done.output
    assert "5 min 12 s" in done.stdout
    assert len(goals(server)) == 1


def test_json_has_the_numbers_and_never_asks(far: list[str], server: Server) -> None:
    done = run([*far, "--json"])
    plan, last = map(json.loads, done.stdout.splitlines())
    assert (plan["type"], plan["duration_s"], plan["battery_used"]) == ("plan", 312.0, 0.27)
    assert (done.exit_code, last["type"]) == (2, "unconfirmed")
    assert goals(server) == []


@pytest.mark.parametrize(("typed", "flown", "exit_code"), [("\n", 1, 0), ("y\n", 1, 0), ("n\n", 0, 1)])
def test_on_a_terminal_the_user_is_asked(
    far: list[str], server: Server, monkeypatch: pytest.MonkeyPatch, typed: str, flown: int, exit_code: int
) -> None:
    monkeypatch.setattr("jezero.cli.goals._is_terminal", lambda: True)
    done = run(far, typed)
    assert "Fly it? [Y/n]" in done.stderr
    assert (len(goals(server)), done.exit_code) == (flown, exit_code), done.output


def test_a_short_flight_starts_without_a_word(server: Server, vehicle: Vehicle, endpoint: str) -> None:
    server.serve("@action/takeoff/plan", PlanReply(accepted=True, duration_s=59.0, distance_m=2.0))
    server.serve("@action/takeoff", ACCEPTED, a_result())
    done = run(["takeoff", "--vehicle", "v", "--router", endpoint])
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("takeoff: accepted")


def test_a_goal_that_would_be_refused_is_refused_by_its_plan(server: Server, vehicle: Vehicle, endpoint: str) -> None:
    server.serve("@action/takeoff/plan", PlanReply(accepted=False, reason="it flies already", code=3))
    done = run(["takeoff", "--vehicle", "v", "--router", endpoint, "--json"])
    assert done.exit_code == 3
    assert json.loads(done.stdout) == {"type": "rejected", "reason": "it flies already", "code": 3}


def test_a_mission_shows_the_plan_of_each_goal_and_asks_nothing(
    server: Server, vehicle: Vehicle, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    far = GoToGoal(target_ned_m=(300.0, 0.0, -9.0))
    monkeypatch.setattr("jezero.trials.missions.FLIGHT", ((GO_TO, far, 0.0), (LAND_ON_SPOT, LandOnSpotGoal(), 0.0)))
    server.serve("@action/go_to/plan", LONG)
    server.serve("@action/go_to", ACCEPTED, a_result())
    server.serve("@action/land_on_spot/plan", PlanReply(accepted=True))
    landed = LandResult(completed=True, touchdown_ned_m=(1.0, 2.0, 0.0))
    server.serve("@action/land_on_spot", ACCEPTED, Result(goal_id="g", t_ns=2, outcome="succeeded", result=landed))
    done = run(["fly", "--vehicle", "v", "--router", endpoint])
    assert done.exit_code == 0, done.output
    kinds = [line.split(" (goal")[0] for line in done.stdout.splitlines()]
    assert kinds == [
        "go_to: 5 min 12 s, 318 m, 27 % of the battery (80 % left, 7 % must be left)",
        "go_to: accepted",
        "go_to: succeeded at (0.00, 0.00, -2.00)",
        "land_on_spot: duration unknown",
        "land_on_spot: accepted",
        "land_on_spot: succeeded at (1.00, 2.00, 0.00)",
    ]


@pytest.mark.parametrize(("duration_s", "said"), [(42.4, "42 s"), (59.6, "1 min 0 s"), (312.0, "5 min 12 s")])
def test_durations_are_said_in_minutes(duration_s: float, said: str) -> None:
    assert minutes(duration_s) == said


class FakeGoal:
    """Notes what it is asked for; can't be resumed."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def pause(self, *, wait: bool) -> None:
        self.asked.append("pause")

    def resume(self) -> None:
        self.asked.append("resume")
        raise Refused("goal g is not paused")


class FakeKeyboard:
    """Gives one key, or several at once, at each reading."""

    attached = True

    def __init__(self, pressed: list[str]) -> None:
        self._pressed: Iterator[str] = iter(pressed)

    def read(self, timeout_s: float) -> str:
        return next(self._pressed)


def polled(pressed: list[str], *, as_json: bool = False) -> list[str]:
    """What a goal is asked for while these keys are pressed."""
    goal: Any = FakeGoal()
    keys = GoalKeys(Printer(as_json), goal)
    keyboard: Any = FakeKeyboard(pressed)
    keys._keyboard = keyboard
    for _ in pressed:
        keys.poll()
    asked: list[str] = goal.asked
    return asked


def test_p_pauses_r_resumes_and_other_keys_do_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert polled(["p", "", "x", "R", "\x1b[C", "xp"]) == ["pause", "resume", "pause"]
    assert "warning: goal g is not paused" in capsys.readouterr().err


def test_with_json_there_are_no_keys() -> None:
    assert polled(["p"], as_json=True) == []
