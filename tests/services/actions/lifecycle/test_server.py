"""The server of an action and the life of its goals, against a bridge with a point mass, on the bus in virtual time."""

from itertools import pairwise
from typing import Any, Literal

import msgspec
import pytest
from msgspec.structs import replace

from jezero.base.codec import decode
from jezero.base.frames import Vec3, ned_from_geodetic
from jezero.runtime.memory_bus import MemoryBus
from jezero.runtime.node import Node
from jezero.schemas import topics
from jezero.schemas.actions import (
    Accepted,
    Cancel,
    Feedback,
    GetDescription,
    GetResult,
    GetRunning,
    Rejected,
    Result,
    RunningGoal,
)
from jezero.schemas.goals import Goal, GoToGoal, LandOnSpotGoal, MoveFeedback, MoveResult, TakeoffGoal
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import ACTIONS
from jezero.services.actions.table import action_server
from tests.services.actions.lifecycle.bench import HOVER, ODOMETRY_HOVERING, Bench, Hovers, published, replies
from tests.services.actions.lifecycle.test_vehicle_view import relative_estimate
from tests.services.actions.rig import CONFIG, FAR, World


def test_a_goal_is_accepted_reports_at_10_hz_and_ends_with_one_result() -> None:
    world = World()
    answers = world.send(GoToGoal(target_ned_m=(4.0, 0.0, -3.0), goal_id="g"))
    seen: list[str] = []
    world.bus.observe(lambda t_ns, name, data: seen.append(name))
    start_ns = world.bus.t_ns
    result = world.end(answers, 30.0)
    flown_s = (world.bus.t_ns - start_ns) / 1e9
    feedback = [r for r in answers.replies if isinstance(r, Feedback)]
    assert isinstance(answers.replies[0], Accepted)
    assert result.outcome == "succeeded"
    assert result.result.completed
    assert abs(result.result.pos_uav_ned_m[0] - 4.0) < 0.15
    assert 9.0 < len(feedback) / flown_s < 10.5
    assert feedback[-1].feedback.distance_m < 0.15
    assert feedback[3].code == StatusCode.GO_TO
    assert seen.count("action/go_to/feedback") == len(feedback)
    assert 45 < seen.count("command/setpoint") / flown_s < 55
    assert world.bridge.code == StatusCode.HOVER
    assert world.bridge.releases[0].hover_pos_ned_m == (4.0, 0.0, -3.0)
    assert [r.outcome for r in world.bridge.releases] == ["succeeded"]


def test_the_first_feedback_comes_with_the_acceptance_10_ms_before_the_first_setpoint() -> None:
    world = World()
    published: list[tuple[str, int]] = []
    world.bus.observe(lambda t_ns, name, data: published.append((name, t_ns)))
    world.flying()
    flown = [(name, t_ns) for name, t_ns in published if name in ("command/setpoint", "action/go_to/feedback")]
    assert [name for name, _ in flown[:2]] == ["action/go_to/feedback", "command/setpoint"]
    assert flown[1][1] - flown[0][1] == 10_000_000
    later = [(one, other) for (one, t_ns), (other, then_ns) in pairwise(flown[2:]) if t_ns == then_ns]
    assert set(later) == {("command/setpoint", "action/go_to/feedback")}


def test_a_first_feedback_that_has_aged_before_control_is_given_is_not_told() -> None:
    world = World()
    published: list[str] = []
    world.bus.observe(lambda _t_ns, name, _data: published.append(name))
    world.send(FAR)
    for _ in range(20):  # something comes between the question for control and its answer
        world.bus.run_for(0.0002)
        world.bus.send_request(topics.RESULT, GetResult(goal_id="another"), "me")
    world.bus.run_for(0.1)
    flown = [name for name in published if name in ("command/setpoint", "action/go_to/feedback")]
    assert flown[:2] == ["command/setpoint", "action/go_to/feedback"]


def test_setpoints_are_numbered_and_carry_the_grant() -> None:
    world = World()
    world.flying()
    setpoints = world.bridge.setpoints
    assert [s.sequence for s in setpoints] == list(range(1, len(setpoints) + 1))
    assert {s.control_id for s in setpoints} == {"c1"}
    assert {s.phase for s in setpoints} == {"go_to"}


def test_an_idle_server_listens_to_status_clock_and_fence_only() -> None:
    world = World()
    port = world.bus._ports["go_to"]
    assert port.subscribed == {"status", "clock", "fence"}
    goal = world.flying()
    assert port.subscribed == {"status", "clock", "fence", "odometry", "sensor/altimeter"}
    world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far"))
    world.end(goal)
    assert port.subscribed == {"status", "clock", "fence"}


@pytest.mark.parametrize(
    ("goal", "reason"),
    [
        (TakeoffGoal(altitude_m=121.0), "altitude 121 m is not within 0.5 to 120 m"),
        (TakeoffGoal(altitude_m=-2.0), "altitude -2 m"),
        (GoToGoal(target_ned_m=(0.0, 0.0, 5.0)), "5 m up is −5"),
        (GoToGoal(target_ned_m=(0.0, 0.0, 0.0)), "5 m up is −5"),
        (GoToGoal(target_ned_m=(0.0, 0.0, -121.0)), "altitude 121 m is beyond the limit of 120 m"),
        (GoToGoal(target_ned_m=(400.0, 400.0, -5.0)), "566 m from the origin, beyond the limit of 500 m"),
        (GoToGoal(target_ned_m=(1.0, 0.0, -5.0), speed_mps=11.0), "speed 11 m/s is not within 0.1 to 10 m/s"),
        (GoToGoal(target_ned_m=(1.0, 0.0, -5.0), speed_mps=0.0), "speed 0 m/s"),
        (GoToGoal(target_ned_m=(1.0, 0.0, -5.0), frame="rover"), "rover's estimate, and the estimator is silent"),
        (LandOnSpotGoal(use_uwb=False), "needs to know roughly where the rover is"),
        (LandOnSpotGoal(use_uwb=False, use_tag=False), "landing_spot_ned_m is missing"),
        (
            LandOnSpotGoal(use_uwb=False, use_tag=False, landing_spot_ned_m=(0.0, 600.0, 0.0)),
            "600 m from the origin",
        ),
        (GoToGoal(target_ned_m=(1.0, 0.0, -5.0), issued_t_ns=10**12), "in the future"),
    ],
)
def test_what_is_beyond_a_limit_is_refused_with_the_number(goal: Any, reason: str) -> None:
    world = World()
    reply = world.fly(goal, 2.0)
    assert isinstance(reply, Rejected)
    assert reason in reply.reason
    assert reply.code == StatusCode.HOVER
    assert world.bridge.grants == 0


def test_the_bridges_refusal_is_passed_on_with_the_status() -> None:
    world = World()
    world.bridge.refuse = "takeoff needs a vehicle on the ground"
    reply = world.fly(TakeoffGoal(), 2.0)
    assert reply == Rejected(goal_id=reply.goal_id, reason="takeoff needs a vehicle on the ground", code=3)
    assert world.is_idle("takeoff")


def test_a_goal_expires_after_30_s() -> None:
    world = World()
    world.bus.run_for(31.0)
    reply = world.fly(GoToGoal(target_ned_m=(1.0, 0.0, -3.0), issued_t_ns=world.bus.t_ns - 30_500_000_000), 2.0)
    assert isinstance(reply, Rejected)
    assert "expired after 30 s" in reply.reason
    fresh = GoToGoal(target_ned_m=(1.0, 0.0, -3.0), issued_t_ns=world.bus.t_ns - 29_000_000_000)
    assert isinstance(world.fly(fresh, 30.0), Result)


def test_without_a_bridge_or_with_a_silent_one_goals_are_refused() -> None:
    bus = MemoryBus()
    bus.add(action_server("go_to", 5, CONFIG))
    bus.run_for(0.1)
    answers = bus.send_request(topics.GO_TO.endpoint, FAR)
    bus.run_for(0.5)
    assert "status is unknown" in answers.replies[0].reason
    world = World()
    world.bridge.mute_status = True
    world.bus.run_for(2.0)
    assert "s old: is vehicle_bridge running" in world.fly(FAR, 2.0).reason


def test_a_dead_bridge_is_told_within_two_seconds() -> None:
    world = World()
    world.bus.remove("vehicle_bridge")
    reply = world.fly(FAR, 2.0)
    assert isinstance(reply, Rejected)
    assert reply.reason.startswith("the vehicle bridge did not reply: "), "with the reason of the connection"
    assert world.is_idle("go_to")


def test_a_second_goal_is_refused_as_busy() -> None:
    world = World()
    world.flying()
    reply = world.fly(GoToGoal(target_ned_m=(1.0, 1.0, -3.0), goal_id="other"), 0.2)
    assert isinstance(reply, Rejected)
    assert "busy: another goal go to is running, and the vehicle flies to a point" in reply.reason


def test_of_two_servers_goals_the_bridge_grants_one() -> None:
    world = World()
    world.flying()
    reply = world.fly(LandOnSpotGoal(use_uwb=False, use_tag=False, landing_spot_ned_m=(0.0, 0.0, 0.0)), 0.2)
    assert isinstance(reply, Rejected)
    assert reply.reason == "another goal is in charge"


def test_a_goal_sent_twice_runs_once_and_both_get_the_result() -> None:
    world = World()
    goal = GoToGoal(target_ned_m=(2.0, 0.0, -3.0), goal_id="twice")
    first, second = world.send(goal, "a"), world.send(goal, "b")
    world.bus.run_for(1.0)
    third = world.send(goal, "c")
    result = world.end(first, 30.0)
    world.bus.run_for(0.1)
    for answers in (second, third):
        assert isinstance(answers.replies[0], Accepted)
        assert answers.replies[-1] == result
        assert answers.ended
    assert world.bridge.grants == 1
    again = world.send(goal)
    world.bus.run_for(0.1)
    assert [type(r) for r in again.replies] == [Accepted, Result]
    assert again.replies[-1] == result
    assert world.bridge.grants == 1


def test_a_server_names_goals_that_have_no_id() -> None:
    world = World()
    first = world.fly(GoToGoal(target_ned_m=(1.0, 0.0, -3.0)))
    second = world.fly(GoToGoal(target_ned_m=(0.0, 0.0, -3.0)))
    assert (first.goal_id, second.goal_id) == ("go_to-5-1", "go_to-5-2")


def test_results_stay_readable_and_only_the_knowing_server_answers() -> None:
    world = World()
    goal = world.flying()
    running = world.bus.send_request(topics.RESULT, GetResult(goal_id="far"))
    world.bus.run_for(0.1)
    assert [r.running for r in running.replies] == [True]
    world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far"))
    result = world.end(goal)
    stored = world.bus.send_request(topics.RESULT, GetResult(goal_id="far"))
    unknown = world.bus.send_request(topics.RESULT, GetResult(goal_id="nobody"))
    world.bus.run_for(0.1)
    assert len(stored.replies) == 1
    assert stored.replies[0].action == "go_to"
    assert msgspec.json.decode(stored.replies[0].result, type=Result[MoveResult]) == result
    assert unknown.ended
    assert unknown.replies == []


def test_the_last_hundred_results_are_kept() -> None:
    server = action_server("go_to", 5, CONFIG)
    for number in range(105):
        done = MoveResult(completed=True, pos_uav_ned_m=(0.0, 0.0, 0.0))
        server._keep(Result(goal_id=f"g{number}", t_ns=0, outcome="succeeded", result=done))
    assert len(server._results) == 100
    assert server._result_reply("g4") is None
    assert server._result_reply("g5") is not None


@pytest.mark.parametrize(
    ("outcome", "sentence"),
    [
        ("succeeded", "the goal has already succeeded"),
        ("canceled", "the goal was already canceled"),
        ("aborted", "the goal was already aborted"),
    ],
)
def test_a_request_about_a_goal_that_has_ended_is_refused_with_its_outcome(
    outcome: Literal["succeeded", "canceled", "aborted"], sentence: str
) -> None:
    server = action_server("go_to", 5, CONFIG)
    done = MoveResult(completed=False, pos_uav_ned_m=(0.0, 0.0, 0.0))
    server._keep(Result(goal_id="g", t_ns=0, outcome=outcome, result=done))
    assert server._not_running_refusal("g") == sentence


def test_a_result_has_the_place_in_degrees_once_the_origin_is_known() -> None:
    world = World()
    assert world.fly(GoToGoal(target_ned_m=(1.0, 0.0, -3.0))).position_deg is None
    world.bridge.origin_deg = (47.0, 8.0, 400.0)
    result = world.fly(GoToGoal(target_ned_m=(3.0, 0.0, -3.0)))
    place_ned_m = ned_from_geodetic(result.position_deg, world.bridge.origin_deg)
    assert place_ned_m == pytest.approx(result.result.pos_uav_ned_m, abs=1e-3)


def test_a_position_reset_moves_the_target_along() -> None:
    world = World()
    answers = world.send(GoToGoal(target_ned_m=(4.0, 0.0, -3.0), goal_id="g"))
    world.bus.run_for(1.5)
    before = world.bridge.setpoints[-1]
    world.bridge.step_position((0.5, -0.8, 0.2))
    world.bus.run_for(0.1)
    after = world.bridge.setpoints[-1]
    assert before.pos_ned_m is not None
    assert after.pos_ned_m is not None
    assert (before.reset_counter, after.reset_counter) == (0, 1)
    assert after.pos_ned_m[1:] == pytest.approx((-0.8, -2.8))
    assert abs(after.pos_ned_m[0] - before.pos_ned_m[0] - 0.5) < 0.3
    result = world.end(answers, 30.0)
    assert result.result.pos_uav_ned_m == pytest.approx((4.5, -0.8, -2.8), abs=0.15)
    assert world.bridge.releases[0].hover_pos_ned_m == pytest.approx((4.5, -0.8, -2.8))
    assert world.bridge.releases[0].reset_counter == 1


def test_steps_of_the_position_by_more_than_a_metre_in_sum_end_the_goal_with_the_sizes() -> None:
    world = World()
    answers = world.send(GoToGoal(target_ned_m=(8.0, 0.0, -3.0), goal_id="g"))
    for step_ned_m in ((0.6, 0.0, 0.0), (-0.6, 0.0, 3.0)):  # back again: the sum counts
        world.bus.run_for(1.0)
        world.bridge.step_position(step_ned_m)
    result = world.end(answers, 1.0)
    assert result.outcome == "aborted"
    assert "the autopilot corrected its position by 1.2 m in 2 steps during the goal" in result.reason


def test_a_goal_whose_point_is_beyond_the_limits_after_a_position_reset_is_aborted() -> None:
    world = World()
    answers = world.send(GoToGoal(target_ned_m=(4.0, 0.0, -3.0), goal_id="g"))
    world.bus.run_for(1.5)
    world.bridge.step_position((0.0, 0.0, -200.0))
    result = world.end(answers, 1.0)
    assert result.outcome == "aborted"
    assert "beyond the limit of 120 m" in result.reason


def test_feedback_on_the_topic_is_the_clients_feedback() -> None:
    world = World()
    heard: list[Any] = []
    kind = topics.feedback_of(topics.GO_TO).type

    def note(t_ns: int, name: str, data: bytes) -> None:
        if name == "action/go_to/feedback":
            heard.append(msgspec.json.decode(data, type=kind))

    world.bus.observe(note)
    answers = world.flying()
    replies = [r for r in answers.replies if isinstance(r, Feedback)]
    assert isinstance(heard[0].feedback, MoveFeedback)
    assert [h.feedback for h in heard][: len(replies)] == [r.feedback for r in replies]
    assert heard[0].goal_id == "far"


def test_the_health_tells_what_the_server_does() -> None:
    world = World()
    node = world.bus._ports["go_to"].node
    assert node.health(0, 0.0, 0).text == "ready for a goal"
    world.flying()
    assert node.health(0, 0.0, 0).text == "flying a goal"
    world.bridge.mute_status = True
    world.bus.run_for(1.5)
    assert node.health(0, 0.0, 0).state == "degraded"


def test_the_same_seed_gives_the_same_bytes() -> None:
    def fly() -> list[tuple[int, str, bytes]]:
        world = World((0.0, 0.0, 0.0))
        log: list[tuple[int, str, bytes]] = []
        world.bus.observe(lambda t_ns, name, data: log.append((t_ns, name, data)))
        world.fly(TakeoffGoal(altitude_m=1.0))
        return log

    assert fly() == fly()


def test_a_server_replies_which_goal_it_flies_and_whose_it_is() -> None:
    world = World()
    assert running(world).goal_id == ""
    answers = world.flying(FAR, client="me")
    flown = running(world)
    assert (flown.goal_id, flown.clients) == ("far", ("me",))
    assert flown.goal["target_ned_m"] == [20.0, 0.0, -3.0]
    assert flown.coverage is None
    world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far"))
    world.end(answers)
    assert running(world).goal_id == ""


def running(world: World) -> RunningGoal:
    request = world.bus.send_request(topics.GO_TO.running, GetRunning())
    assert world.bus.run_for(1.0, lambda: request.ended)
    (reply,) = request.replies
    assert isinstance(reply, RunningGoal)
    return reply


# -- what a server says about its action --


@pytest.mark.parametrize("name", ACTIONS)
def test_a_server_describes_the_goal_the_feedback_and_the_result_of_its_action(name: str) -> None:
    action, world = ACTIONS[name], World()
    request = world.bus.send_request(action.describe, GetDescription())
    assert world.bus.run_for(1.0, lambda: request.ended)
    (description,) = request.replies
    assert (description.name, description.endpoint) == (name, f"@action/{name}")
    for schema, struct in (
        (description.goal, action.goal_type),
        (description.feedback, action.feedback_type),
        (description.result, action.result_type),
    ):
        described = schema["$defs"][schema["$ref"].rsplit("/", 1)[1]]
        assert set(struct.__struct_fields__) <= set(described["properties"])


# -- a query without fields may be no more than a look at the key --


class Replies:
    """Transport of a node that keeps the replies."""

    def __init__(self) -> None:
        self.replies: list[bytes | None] = []

    def reply(self, request_id: int, data: bytes | None, *, final: bool) -> None:
        self.replies.append(data)


def replies_to(name: str, data: bytes, parameters: dict[str, str]) -> list[Any]:
    """What an action's server replies at once to a request for a goal."""
    action, transport = ACTIONS[name], Replies()
    node = Node(action_server(name, boot_id=1), transport, strict=True, boot_id=1)  # type: ignore[arg-type]
    node.deliver_request(action.endpoint.name, 7, "", data, parameters)
    return [None if reply is None else decode(action.endpoint.reply_type, reply) for reply in transport.replies]


@pytest.mark.parametrize("name", ACTIONS)
@pytest.mark.parametrize(
    ("data", "parameters"),
    [(b"", {}), (b"", {"_time": "[..]"}), (b"{}", {}), (b" {\n}\r\n", {}), (b"\t{ }", {"_target": "ALL"})],
)
def test_a_goal_that_names_no_field_is_refused_with_what_to_write(
    name: str, data: bytes, parameters: dict[str, str]
) -> None:
    (refusal,) = replies_to(name, data, parameters)
    assert isinstance(refusal, Rejected)
    own_fields = set(ACTIONS[name].goal_type.__struct_fields__) - set(Goal.__struct_fields__)
    assert "names no field" in refusal.reason and "or a goal_id" in refusal.reason
    assert any(f"such as {field}" in refusal.reason for field in own_fields)


@pytest.mark.parametrize("name", ["takeoff", "land_on_spot", "return_home"])
@pytest.mark.parametrize(("data", "parameters"), [(b"", {"goal_id": "g"}), (b'{"goal_id": "g"}', {})])
def test_a_goal_id_is_enough_of_a_field(name: str, data: bytes, parameters: dict[str, str]) -> None:
    assert replies_to(name, data, parameters) == []


# -- flying: which state gives a setpoint --


def test_each_new_estimate_of_the_rover_gives_a_setpoint_and_a_request_alone_gives_none() -> None:
    bench = Bench(topics.LAND_ON_SPOT)
    spot = LandOnSpotGoal(use_uwb=False, use_tag=False, landing_spot_ned_m=(6.0, 0.0, 0.0), goal_id="down")
    assert len(published(bench.fly(spot), topics.SETPOINT)) == 1
    bench.request(GetRunning())
    assert not published(bench.step_alone(0.015), topics.SETPOINT)
    bench.inbox.add_message(topics.RELATIVE.name, replace(relative_estimate(), t_ns=bench.t_ns))
    assert len(published(bench.step_alone(0.001), topics.SETPOINT)) == 1
    assert len(published(bench.step_alone(0.025), topics.SETPOINT)) == 1, "without a new state after 20 ms"


@pytest.mark.parametrize(("rate_hz", "setpoints"), [(None, 0), (200.0, 1)])
def test_a_plan_may_ask_for_more_setpoints_than_there_are_states(rate_hz: float | None, setpoints: int) -> None:
    bench = Bench(HOVER, Hovers({"rate_hz": rate_hz}))
    bench.fly(FAR)
    assert len(published(bench.step_alone(0.006), topics.SETPOINT)) == setpoints
    assert len(published(bench.step(0.02), topics.SETPOINT)) == 1


@pytest.mark.parametrize(
    ("frame", "pos_ned_m"), [("world", ODOMETRY_HOVERING.pos_uav_ned_m), ("rover", (1.0, 2.0, -3.0))]
)
def test_feedback_in_the_world_has_the_autopilots_position_and_that_relative_to_the_rover_is_left_as_it_is(
    frame: str, pos_ned_m: Vec3
) -> None:
    bench = Bench(HOVER, Hovers(frame=frame))
    (feedback,) = replies(bench.fly(FAR) + bench.step(0.1), Feedback)
    assert feedback.feedback.pos_uav_ned_m == pos_ned_m
