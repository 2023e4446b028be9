"""Which commands of a joystick steer a goal."""

from collections.abc import Sequence
from typing import Any

import pytest

from jezero.schemas.commands import VelocityCommand
from jezero.schemas.topics import FLY_VELOCITY, GO_TO
from jezero.services.actions.lifecycle.steering import Steering

S = 1_000_000_000
T_NS = 100 * S


class Box:
    """The commands that have come since the last step."""

    def __init__(self, commands: Sequence[VelocityCommand]) -> None:
        self.commands = commands

    def new(self, topic: Any) -> Sequence[VelocityCommand]:
        return self.commands


def command(age_s: float = 0.0, forward_mps: float = 1.0, goal_id: str = "g") -> VelocityCommand:
    return VelocityCommand(t_ns=T_NS - int(age_s * S), goal_id=goal_id, forward_mps=forward_mps)


def steered(*commands: VelocityCommand) -> Steering:
    steering = Steering.of("g", FLY_VELOCITY)
    assert steering is not None
    for each in commands:
        steering.update(T_NS, Box([each]))  # type: ignore[arg-type]
    return steering


@pytest.mark.parametrize(
    ("given", "refusal"),
    [
        (command(0.49), ""),
        (command(0.51), "a velocity command is 0.5 s old, more than 0.5 s: stamp it with vehicle time"),
        (command(-0.29), ""),
        (command(-0.4), "a velocity command is 0.4 s ahead of vehicle time: stamp it with vehicle time"),
        (command(goal_id="old"), "a velocity command is for goal old, and g flies"),
    ],
)
def test_a_young_command_for_the_goal_that_flies_steers_it(given: VelocityCommand, refusal: str) -> None:
    steering = steered(given)
    assert steering.refusal == refusal
    assert steering.command(0) == (None if refusal else given)


def test_a_command_that_was_overtaken_or_refused_leaves_the_newest_one_in_force() -> None:
    newest = command(0.1, 2.0)
    steering = steered(newest, command(0.2, 3.0), command(9.0))
    assert steering.command(0) == newest
    assert "9.0 s old" in steering.refusal
    assert steered(newest, command(0.1, 3.0)).command(0) == command(0.1, 3.0), "of the same time the later one counts"
    assert steered(command(9.0), newest).refusal == ""


def test_the_time_of_a_command_is_in_the_goals_own_time() -> None:
    steering = steered(command())
    for behind_s, t_s in ((3, 97), (200, 0)):
        found = steering.command(behind_s * S)
        assert found is not None and found.t_ns == t_s * S
    assert Steering.of("g", GO_TO) is None
