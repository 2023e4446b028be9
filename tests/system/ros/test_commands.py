"""Clients of ROS fly the vehicle: actions, services, parameters and goal poses through the bridge."""

import json
import queue
import signal
import subprocess
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import hypot
from pathlib import Path
from typing import Any

import pytest

from jezero import Vehicle
from jezero.base.frames import enu_from_ned, yaw_from_quat
from jezero.schemas.state import StatusCode
from tests.system.conftest import Stack
from tests.system.ros.conftest import Ros
from tests.system.ros.test_bridge import running_bridge

pytestmark = [pytest.mark.slow, pytest.mark.whole, pytest.mark.timeout(1200)]
ACTOR = Path(__file__).with_name("actor.py")
TIMEOUT_S = 180.0
SILENCE_S = 1.0
"""A stream on `cmd_vel` is over after this time without a message."""
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""Status of a goal, of action_msgs/GoalStatus."""


class Actor:
    """A client in ROS, see actor.py."""

    def __init__(self, process: "subprocess.Popen[str]", namespace: str) -> None:
        self._process, self.namespace = process, namespace
        self.bridge: subprocess.Popen[str] | None = None
        """The bridge beside it, if that is the module's."""
        self._events: queue.Queue[dict[str, Any]] = queue.Queue()
        self.seen: list[dict[str, Any]] = []
        """Events since the last goal was sent."""
        self._counts: dict[str, int] = defaultdict(int)
        """How many of `seen` were looked at, by the event that was waited for."""
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._events.put(json.loads(line))

    def do(self, verb: str, **words: Any) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"do": verb, **words}) + "\n")
        self._process.stdin.flush()

    def wait(
        self, event: str, condition: Callable[[dict[str, Any]], bool] = lambda found: True, timeout_s: float = TIMEOUT_S
    ) -> dict[str, Any]:
        """The next event of a kind, since the last goal was sent; others wait until they are asked for."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            for found in self.seen[self._counts[event] :]:
                self._counts[event] += 1
                if found["event"] == event and condition(found):
                    return found
            try:
                self.seen.append(self._events.get(timeout=max(deadline_s - time.monotonic(), 0.0)))
            except queue.Empty:
                raise AssertionError(f"no {event} in {timeout_s:g} s, but {self.seen}") from None

    def clear(self) -> None:
        self.seen.clear()
        self._counts.clear()

    def name(self, name: str) -> str:
        return f"/{self.namespace}/{name}"

    def send(self, kind: str, name: str, **goal: Any) -> bool:
        """Send a goal; returns whether it was accepted."""
        self.clear()
        self.do("send", type=f"jezero_interfaces/action/{kind}", name=self.name(name), goal=goal)
        return bool(self.wait("accepted")["accepted"])

    def result(self) -> tuple[int, dict[str, Any]]:
        found = self.wait("result")
        return found["status"], found["result"]

    def fly(self, kind: str, name: str, **goal: Any) -> dict[str, Any]:
        """Fly a goal to its success."""
        assert self.send(kind, name, **goal), f"{name} was not accepted: {self.seen}"
        status, result = self.result()
        assert status == SUCCEEDED, result
        assert (result["outcome"], result["outcome_reason"]) == ("succeeded", "")
        return result

    def call(self, kind: str, name: str, **request: Any) -> dict[str, Any]:
        self.do("call", type=kind, name=self.name(name), request=request)
        response: dict[str, Any] = self.wait("response")["response"]
        return response


def wait_for(condition: Callable[[], bool], sentence: str, again: Callable[[], None] = lambda: None) -> None:
    """Wait for a state; `again` is called before each look at it."""
    deadline_s = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline_s, sentence
        again()
        time.sleep(0.5)


@pytest.fixture(scope="module")
def uav(shared_stack: Stack) -> Iterator[Vehicle]:
    with shared_stack.connect() as uav:
        uav.wait_ready(TIMEOUT_S)
        yield uav


@contextmanager
def an_actor(stack: Stack, ros: Ros) -> Iterator[Actor]:
    with subprocess.Popen(
        [ros.python, str(ACTOR)],
        env=ros.environment(stack.environment),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        actor = Actor(process, stack.instance.vehicle)
        try:
            actor.wait("ready")
            yield actor
        finally:
            process.kill()  # the handler of rclpy for SIGTERM does not end a process
            actor.reader.join()


@pytest.fixture(scope="module")
def actor(shared_stack: Stack, ros_with_interfaces: Ros) -> Iterator[Actor]:
    with (
        running_bridge(shared_stack, ros_with_interfaces, "--commands") as bridge,
        an_actor(shared_stack, ros_with_interfaces) as actor,
    ):
        actor.bridge = bridge
        actor.do("subscribe", type="std_msgs/msg/String", name=actor.name("refusals"))
        yield actor


@pytest.fixture
def flying(uav: Vehicle) -> Iterator[None]:
    """The vehicle hovers before the test, and has no goal after it."""
    if uav.status().code != StatusCode.HOVER:
        uav.takeoff(altitude_m=3.0).result(TIMEOUT_S)
    yield
    if uav.status().goal_id:
        uav.hover()


def test_a_flight_by_actions(actor: Actor, uav: Vehicle) -> None:
    # A goal that the vehicle refuses is rejected, with the reason beside it.
    assert not actor.send("GoTo", "go_to", target_m={"x": 1.0, "y": 2.0, "z": 3.0})
    reason = actor.wait(actor.name("refusals"))["message"]["data"]
    assert reason.startswith("go_to: ") and "take" in reason
    assert not actor.send("GoTo", "go_to", target_m={"x": 1.0, "y": 2.0, "z": 3.0}, frame="moon")
    assert "frame" in actor.wait(actor.name("refusals"))["message"]["data"]

    actor.fly("Takeoff", "takeoff", altitude_m=3.0)
    result = actor.fly("GoTo", "go_to", target_m={"x": 4.0, "y": 2.0, "z": 3.0}, yaw_rad=[0.0], speed_mps=[1.0])
    feedback = [event["feedback"] for event in actor.seen if event["event"] == "feedback"]
    assert len(feedback) > 5
    assert feedback[-1]["distance_m"] < feedback[0]["distance_m"]
    at = result["pos_uav_m"]
    odometry = uav.odometry()
    assert (at["x"], at["y"], at["z"]) == pytest.approx((4.0, 2.0, 3.0), abs=0.7)
    assert odometry.pos_uav_ned_m == pytest.approx((2.0, 4.0, -3.0), abs=0.7)

    images = actor.fly("GetImages", "get_images", center_m={"x": 4.0, "y": 2.0, "z": 3.0}, radius_m=1.5, num_images=3)
    assert len(json.loads(images["images_json"])) == 3

    # A goal that is canceled from ROS ends as canceled, and the vehicle hovers.
    assert actor.send("GoTo", "go_to", target_m={"x": -10.0, "y": -10.0, "z": 3.0}, speed_mps=[0.5])
    actor.wait("feedback")
    actor.do("cancel")
    status, result = actor.result()
    assert (status, result["outcome"], result["completed"]) == (CANCELED, "canceled", False)
    assert uav.status().code == StatusCode.HOVER

    # One that another client ends is aborted in ROS.
    assert actor.send("GoTo", "go_to", target_m={"x": -10.0, "y": -10.0, "z": 3.0}, speed_mps=[0.5])
    actor.wait("feedback")
    uav.hover()
    status, result = actor.result()
    assert status == ABORTED and result["outcome_reason"]

    actor.fly("FlyAction", "fly_action", action="go_to", goal_json='{"target_ned_m": [1, 1, -2]}')
    assert uav.odometry().pos_uav_ned_m == pytest.approx((1.0, 1.0, -2.0), abs=0.7)
    landed = actor.fly("LandOnSpot", "land_on_spot", landing_spot_m=[{"x": 1.0, "y": 1.0, "z": 0.0}],
                       use_uwb=False, use_tag=False)  # fmt: skip
    assert hypot(landed["touchdown_m"][0]["x"] - 1.0, landed["touchdown_m"][0]["y"] - 1.0) < 1.0


def test_any_action_with_a_mistake_is_refused_in_words(actor: Actor, uav: Vehicle) -> None:
    assert not actor.send("FlyAction", "fly_action", action="go_too", goal_json="{}")
    assert "go_too" in actor.wait(actor.name("refusals"))["message"]["data"]
    assert not actor.send("FlyAction", "fly_action", action="go_to", goal_json="[1")
    assert "goal_json is not a JSON object" in actor.wait(actor.name("refusals"))["message"]["data"]


def test_services_hover_and_tell_why_they_fail(actor: Actor, uav: Vehicle, flying: None) -> None:
    assert actor.send("GoTo", "go_to", target_m={"x": 20.0, "y": 0.0, "z": 3.0}, speed_mps=[0.5])
    actor.wait("feedback")
    response = actor.call("std_srvs/srv/Trigger", "hover")
    assert response["success"], response["message"]
    assert uav.status().code == StatusCode.HOVER
    for request in ({"confirm": False, "vehicle": ""}, {"confirm": True, "vehicle": ""}):
        response = actor.call("jezero_interfaces/srv/Kill", "kill", **request)
        assert not response["success"] and response["message"]
    assert uav.status().code == StatusCode.HOVER, "it still flies"


def test_a_goal_pose_is_flown_to_and_another_one_changes_the_way(actor: Actor, uav: Vehicle, flying: None) -> None:
    frame = f"{actor.namespace}/map"

    def publish(east_m: float, north_m: float, up_m: float, frame_id: str = frame) -> None:
        position = {"x": east_m, "y": north_m, "z": up_m}
        # Half a turn about z: west.
        pose = {"position": position, "orientation": {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}}
        message = {"header": {"frame_id": frame_id}, "pose": pose}
        actor.do("publish", type="geometry_msgs/msg/PoseStamped", name=actor.name("goal_pose"), message=message)

    def is_near(north_m: float, east_m: float) -> bool:
        at = uav.odometry().pos_uav_ned_m
        return hypot(at[0] - north_m, at[1] - east_m) < 0.7

    # Until bridge and actor know each other, a message is lost.
    wait_for(lambda: uav.status().action == "go_to", "no goal_pose arrived", lambda: publish(30.0, 0.0, 0.0))
    before = uav.status().goal_id
    height_m = -uav.odometry().pos_uav_ned_m[2]
    publish(2.0, -1.0, 0.0)
    wait_for(lambda: uav.status().code == StatusCode.GO_TO_DONE or uav.status().goal_id != before, "it still flies")
    wait_for(lambda: is_near(-1.0, 2.0), "it is not where the second pose is")
    assert -uav.odometry().pos_uav_ned_m[2] == pytest.approx(height_m, abs=0.7), "a pose without a height keeps it"
    publish(0.0, 0.0, 3.0, "somewhere")
    assert f"expected {frame}" in actor.wait(actor.name("refusals"))["message"]["data"]


@pytest.fixture(params=["Twist", "TwistStamped"])
def stick(request: pytest.FixtureRequest, shared_stack: Stack, ros_with_interfaces: Ros) -> Iterator[tuple[Actor, str]]:
    """A client that publishes on cmd_vel, and the type; in a process a topic has one type, so each has its own."""
    with an_actor(shared_stack, ros_with_interfaces) as stick:
        yield stick, request.param


def test_cmd_vel_flies_the_vehicle_along_the_axes_of_rep_103(
    stick: tuple[Actor, str], actor: Actor, uav: Vehicle, flying: None
) -> None:
    pilot, kind = stick

    def stream(forward_mps: float = 0.0, left_mps: float = 0.0, turn_rps: float = 0.0) -> None:
        twist = {"linear": {"x": forward_mps, "y": left_mps}, "angular": {"z": turn_rps}}
        message = twist if kind == "Twist" else {"header": {"frame_id": "base_link"}, "twist": twist}
        pilot.do("stream", type=f"geometry_msgs/msg/{kind}", name=actor.name("cmd_vel"), message=message)

    def release() -> None:
        pilot.do("release")
        pilot.wait("released")
        wait_for(lambda: uav.status().code == StatusCode.HOVER, "the goal goes on without commands")
        time.sleep(2.0 * SILENCE_S)  # the next stream is another one

    def is_north_west() -> bool:
        north_m, east_m, _ = uav.odometry().pos_uav_ned_m
        return north_m > 1.0 and east_m < -1.0

    uav.go_to(0.0, 0.0, -3.0, yaw_rad=0.0).result(TIMEOUT_S)
    stream(forward_mps=0.7, left_mps=0.7)
    wait_for(lambda: uav.status().action == "fly_velocity", "no cmd_vel arrived")
    wait_for(is_north_west, "forward is north, and left is west")
    release()
    stream(turn_rps=0.5)
    wait_for(lambda: uav.status().action == "fly_velocity", "no turn arrived")
    wait_for(lambda: -2.5 < yaw_from_quat(uav.odometry().q_ned_from_frd) < -0.5, "it does not turn anticlockwise")
    release()

    # It takes no goal's control away, and a hover ends it although the stick is still held.
    goal = uav.go_to(20.0, 0.0, -3.0, speed_mps=0.3)
    actor.clear()
    stream(forward_mps=1.0)
    assert "is in charge" in actor.wait(actor.name("refusals"))["message"]["data"]
    assert uav.status().goal_id == goal.goal_id
    uav.hover()
    release()
    actor.clear()
    stream(forward_mps=0.3)
    wait_for(lambda: uav.status().action == "fly_velocity", "no cmd_vel arrived")
    uav.hover()
    assert "hover was requested" in actor.wait(actor.name("refusals"))["message"]["data"]
    time.sleep(2.0)
    assert uav.status().code == StatusCode.HOVER, "the stick that is still held has no effect"
    release()


def test_the_estimators_parameters_are_parameters_of_the_node(actor: Actor, uav: Vehicle) -> None:
    node = actor.name("jezero_bridge")
    actor.do("parameters", node=node, values={"estimator.std_uwb_m": 0.25, "estimator.pos_rover_m": [1.0, 2.0, 0.0]})
    assert [each["successful"] for each in actor.wait("set")["results"]] == [True, True]
    parameters = uav.estimator_parameters()
    assert parameters.std_uwb_m == 0.25
    assert parameters.pos_rover_ned_m == (2.0, 1.0, 0.0)
    actor.do("get", node=node, name="estimator.std_uwb_m")
    assert actor.wait("value")["values"][0]["double_value"] == 0.25
    uav.set_estimator_parameters(std_uwb_m=0.31)

    def follows() -> bool:
        actor.do("get", node=node, name="estimator.std_uwb_m")
        return bool(actor.wait("value")["values"][0]["double_value"] == 0.31)

    wait_for(follows, "the node's parameter does not follow what another client has changed")
    uav.set_estimator_parameters(std_uwb_m=0.25)
    actor.do("parameters", node=node, values={"estimator.std_uwb_m": 1e9})
    (refused,) = actor.wait("set")["results"]
    assert not refused["successful"] and "std_uwb_m" in refused["reason"]
    actor.do("parameters", node=node, values={"estimator.pos_rover_m": [1.0]})
    assert "expected east, north and up" in actor.wait("set")["results"][0]["reason"]
    assert uav.estimator_parameters().std_uwb_m == 0.25


def test_the_chain_of_transforms_is_the_odometry(actor: Actor, uav: Vehicle, shared_stack: Stack) -> None:
    name = actor.namespace
    actor.do("subscribe", type="tf2_msgs/msg/TFMessage", name="/tf_static", latched=True)
    static = actor.wait("/tf_static")["message"]["transforms"]
    assert {f"{name}/imu", f"{name}/altimeter"} <= {each["child_frame_id"] for each in static}
    actor.do("subscribe", type="tf2_msgs/msg/TFMessage", name="/tf")
    actor.do("subscribe", type="nav_msgs/msg/Odometry", name=actor.name("odometry"))

    for _ in range(100):
        actor.wait(actor.name("odometry"))
    chains: dict[str, dict[str, Any]] = {}
    for event in actor.seen:
        if event["event"] == "/tf":
            by_child = {each["child_frame_id"]: each for each in event["message"]["transforms"]}
            if f"{name}/base_link" in by_child:
                chains[json.dumps(by_child[f"{name}/base_link"]["header"]["stamp"])] = by_child
    at: dict[str, float] = {}
    offset: dict[str, float] = {}
    compared = 0
    for event in actor.seen:
        if event["event"] != actor.name("odometry"):
            continue
        odometry = event["message"]
        chain = chains.get(json.dumps(odometry["header"]["stamp"]))
        if chain is None:
            continue
        transform = chain[f"{name}/base_link"]
        assert transform["header"]["frame_id"] == odometry["header"]["frame_id"] == f"{name}/odom"
        assert transform["transform"]["translation"] == odometry["pose"]["pose"]["position"]
        assert transform["transform"]["rotation"] == odometry["pose"]["pose"]["orientation"]
        assert chain[f"{name}/odom"]["header"]["frame_id"] == f"{name}/map"
        at, offset = transform["transform"]["translation"], chain[f"{name}/odom"]["transform"]["translation"]
        compared += 1
    assert compared > 20, f"{compared} of 100 odometries have a transform of their time"
    # From map to base_link is where the vehicle is.
    chained = tuple(offset[axis] + at[axis] for axis in "xyz")
    east_m, north_m, up_m = enu_from_ned(uav.odometry().pos_uav_ned_m)
    assert chained[:2] == pytest.approx((east_m, north_m), abs=1.0)
    assert 0.0 < chained[2] - up_m < 1.0, "base_link is the centre of mass"


def test_a_bridge_without_the_interfaces_says_so_and_publishes(shared_stack: Stack, ros: Ros, uav: Vehicle) -> None:
    said: list[str] = []
    with running_bridge(shared_stack, ros, said=said), an_actor(shared_stack, ros) as other:
        (sentence,) = (line for line in said if "left out" in line and "kill" in line)
        assert "jezero_interfaces" in sentence
        other.do("subscribe", type="nav_msgs/msg/Odometry", name=other.name("odometry"))
        other.wait(other.name("odometry"))
        response = other.call("std_srvs/srv/Trigger", "abort")
        assert response["message"]


def test_return_home_lands(uav: Vehicle, actor: Actor, flying: None) -> None:
    response = actor.call("std_srvs/srv/Trigger", "return_home")
    assert response["success"], response["message"]
    wait_for(lambda: uav.status().code == StatusCode.IDLE, "it has not landed")


def test_a_bridge_that_ends_leaves_its_goal_to_the_rule_that_the_goal_has(
    shared_stack: Stack, ros_with_interfaces: Ros, uav: Vehicle, actor: Actor, flying: None
) -> None:
    far = {"target_m": {"x": 20.0, "y": 0.0, "z": 3.0}, "speed_mps": [0.5]}
    assert actor.send("GoTo", "go_to", **far)
    actor.wait("feedback")
    assert actor.bridge is not None
    actor.bridge.send_signal(signal.SIGINT)
    status, result = actor.result()
    assert (status, result["outcome"]) == (ABORTED, "lost")
    assert actor.bridge.wait(30) == 0
    assert uav.status().code == StatusCode.GO_TO, "the vehicle flies on"
    uav.hover()
    with running_bridge(shared_stack, ros_with_interfaces) as bridge:
        assert actor.send("GoTo", "go_to", **far, on_client_loss="cancel")
        actor.wait("feedback")
        bridge.kill()
        wait_for(lambda: uav.status().code == StatusCode.HOVER, "it flies on without its client")
