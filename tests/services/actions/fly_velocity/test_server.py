"""Goals of `fly_velocity` on the bus: whose commands are followed, and what happens to the others."""

from collections.abc import Iterator

import msgspec
import pytest

from jezero.runtime.service import Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.actions import Cancel, Feedback, Pause, Resume
from jezero.schemas.commands import VelocityCommand
from jezero.schemas.goals import FlyVelocityGoal, VelocityFeedback
from jezero.schemas.health import ServiceHealth
from jezero.schemas.state import StatusCode
from tests.services.actions.rig import World

GOAL = FlyVelocityGoal(goal_id="mine", on_client_loss="cancel")


class Stick:
    """A client that publishes a command twenty times a second.

    Attributes:
        command: the next command, without its time; None publishes none.
        late_ns: age of each command.
    """

    spec = Spec(name="stick", outputs=(topics.VELOCITY_COMMAND,), rate_hz=20.0)

    def __init__(self) -> None:
        self.command: VelocityCommand | None = VelocityCommand(t_ns=0, goal_id="mine", forward_mps=1.0)
        self.late_ns = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        if self.command is not None:
            command = msgspec.structs.replace(self.command, t_ns=max(t_ns - self.late_ns, 0))
            yield Publish(topics.VELOCITY_COMMAND, command)


class Steered(World):
    """A bus with a stick.

    Attributes:
        stick: the client that commands.
    """

    def __init__(self) -> None:
        super().__init__()
        self.stick = Stick()
        self.bus.add(self.stick)


@pytest.fixture
def world() -> Steered:
    return Steered()


def newest(answers: object) -> VelocityFeedback:
    replies = [reply for reply in answers.replies if isinstance(reply, Feedback)]  # type: ignore[attr-defined]
    assert isinstance(replies[-1].feedback, VelocityFeedback)
    return replies[-1].feedback


def test_commands_fly_the_vehicle_and_the_last_one_ends_the_goal_with_success(world: Steered) -> None:
    answers = world.flying(GOAL)
    world.bus.run_for(4.0)
    assert newest(answers).follows and world.bridge.pos_ned_m[0] > 2.0
    world.stick.command = VelocityCommand(t_ns=0, goal_id="mine", is_last=True)
    result = world.end(answers)
    assert (result.outcome, result.reason) == ("succeeded", "")
    assert world.bridge.code is StatusCode.HOVER


def test_commands_for_another_goal_move_nothing_and_the_reason_is_in_the_feedback(world: Steered) -> None:
    world.stick.command = VelocityCommand(t_ns=0, goal_id="theirs", forward_mps=1.0)
    answers = world.flying(GOAL)
    world.bus.run_for(3.0)
    assert abs(world.bridge.pos_ned_m[0]) < 0.01
    assert not newest(answers).follows
    assert newest(answers).refused == "a velocity command is for goal theirs, and mine flies"


def test_other_clients_commands_do_not_disturb_those_of_the_goal(world: Steered) -> None:
    other = Stick()
    other.spec = Spec(name="other", outputs=(topics.VELOCITY_COMMAND,), rate_hz=20.0)
    other.command = VelocityCommand(t_ns=0, goal_id="theirs", forward_mps=-1.0)
    world.bus.add(other)
    answers = world.flying(GOAL)
    world.bus.run_for(3.0)
    assert newest(answers).follows and world.bridge.pos_ned_m[0] > 2.0


@pytest.mark.parametrize(
    ("late_ns", "words"), [(800_000_000, "0.8 s old, more than 0.5 s"), (-900_000_000, "0.9 s ahead of vehicle time")]
)
def test_commands_with_a_wrong_time_are_refused(world: Steered, late_ns: int, words: str) -> None:
    world.stick.late_ns = late_ns
    answers = world.flying(GOAL)
    world.bus.run_for(2.0)
    assert words in newest(answers).refused and not newest(answers).follows
    assert abs(world.bridge.pos_ned_m[0]) < 0.01


@pytest.mark.parametrize("wrong", ['"forward_mps":null', '"forward_mps":1e3', '"forward_mps":"fast"', '"speed":1'])
def test_nan_and_absurd_numbers_are_dropped_and_the_health_says_why(world: Steered, wrong: str) -> None:
    world.stick.command = None
    healths: list[ServiceHealth] = []

    def observe(t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.health_of("fly_velocity").name:
            healths.append(msgspec.json.decode(data, type=ServiceHealth))

    world.bus.observe(observe)
    answers = world.flying(GOAL)
    for _ in range(20):
        data = f'{{"t_ns":{world.bus.t_ns},"goal_id":"mine",{wrong}}}'.encode()
        world.bus.publish("anybody", topics.VELOCITY_COMMAND, data)
        world.bus.run_for(0.1)
    assert not newest(answers).follows and abs(world.bridge.pos_ned_m[0]) < 0.01
    assert any("command/velocity" in msgspec.json.encode(health).decode() for health in healths)


def test_a_pause_holds_the_vehicle_whatever_is_commanded_and_then_the_commands_count_again(world: Steered) -> None:
    answers = world.flying(GOAL)
    world.bus.run_for(2.0)
    world.bus.send_request(topics.FLY_VELOCITY.pause, Pause(goal_id="mine"), "me")
    world.bus.run_for(3.0)
    place_m = world.bridge.pos_ned_m[0]
    world.bus.run_for(12.0)  # longer than the silence that ends a goal
    assert abs(world.bridge.pos_ned_m[0] - place_m) < 0.02 and not answers.ended
    world.bus.send_request(topics.FLY_VELOCITY.resume, Resume(goal_id="mine"), "me")
    world.bus.run_for(3.0)
    assert world.bridge.pos_ned_m[0] > place_m + 1.0


def test_a_cancel_and_the_loss_of_the_client_end_the_goal(world: Steered) -> None:
    answers = world.flying(GOAL)
    world.bus.send_request(topics.FLY_VELOCITY.cancel, Cancel(goal_id="mine"), "me")
    assert world.end(answers).outcome == "canceled"
    second = FlyVelocityGoal(goal_id="second", on_client_loss="cancel")
    answers = world.flying(second)
    world.bus.client_departs("me")
    result = world.end(answers)
    assert (result.outcome, result.reason) == ("canceled", "its client vanished")


def test_without_commands_it_holds_its_place_and_ends_after_ten_seconds(world: Steered) -> None:
    answers = world.flying(GOAL)
    world.bus.run_for(2.0)
    world.stick.command = None
    world.bus.run_for(5.0)
    place_m = world.bridge.pos_ned_m
    world.bus.run_for(3.0)
    assert not answers.ended and max(abs(a - b) for a, b in zip(place_m, world.bridge.pos_ned_m, strict=True)) < 0.01
    result = world.end(answers)
    assert result.outcome == "aborted" and "no velocity command for 10 s" in result.reason
