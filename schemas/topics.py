"""The table of all keys: name, message type, rate and writer. Keys are `jezero/<vehicle>/<name>`.

Every endpoint that has an effect is behind an `@` chunk, which the wildcards `*` and `**` never match.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, Literal, TypeVar, get_origin

import msgspec

from jezero.schemas import (
    actions,
    commands,
    estimate,
    fence,
    goals,
    health,
    images,
    journal,
    mission,
    preflight,
    sensors,
    state,
    terrain,
)
from jezero.schemas.struct import Message, Payload

Host = Literal["vehicle", "rover"]
"""Computer of which a topic's writer is a service."""
Rank = Literal["viewer", "pilot", "service"]
"""Who may read or ask: everybody of the team, those who fly, or only services of the vehicle itself."""

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Payload)
R = TypeVar("R", bound=Payload)


@dataclass(frozen=True)
class Topic(Generic[M]):
    """Key on which messages are published.

    Attributes:
        name: the key without `jezero/<vehicle>/`.
        type: type of its messages, for decoding; a generic struct has its arguments.
        rate_hz: nominal rate of publishing. None for messages that are published on events only.
        writer: name of the one service that publishes it; `GOAL_IN_CHARGE` or `CLIENTS` where that changes.
        host: computer whose services publish it; `CLIENTS` publish from anywhere.
        reader: who may subscribe to it, from another computer.
    """

    name: str
    type: type[M]
    rate_hz: float | None
    writer: str
    host: Host = "vehicle"
    reader: Rank = "viewer"

    @cached_property
    def struct(self) -> Any:
        """Class of the messages: `type` without its arguments."""
        return get_origin(self.type) or self.type


GOAL_IN_CHARGE = "the goal in charge"
"""Writer of a topic that each action server declares; only the server whose goal has control publishes it."""
CLIENTS = "clients"
"""Writer of a topic that is published by programs outside the stack: the command line, the SDK, any Zenoh client."""
EVERY_ACTION = "every action server"
"""Server of an endpoint on which each action server replies for its own goals."""


@dataclass(frozen=True)
class Endpoint(Generic[Q, R]):
    """Key to which requests are sent.

    Attributes:
        name: the key without `jezero/<vehicle>/`; or a pattern with `**` for requests on keys without a server of
            their own, whose content is the key.
        request_type: type of each request.
        reply_type: type (or union of types) of each reply.
        server: name of the one service that replies; `EVERY_ACTION` where each action server replies.
        refuse: function that makes the reply to a request that can't be decoded or served, from the reason.
        shared: several servers reply on this key, each for its own goals.
        wildcards: a query with wildcards gets a reply too; only for an endpoint without an effect.
        asker: who may send requests, from another computer.
        needs_field: a request that names no field at all is refused: it may be a mistake, such as a look at the key.
    """

    name: str
    request_type: type[Q]
    reply_type: Any
    server: str
    refuse: Callable[[str], R]
    shared: bool = False
    wildcards: bool = False
    asker: Rank = "pilot"
    needs_field: bool = False


def refusing(
    name: str, request_type: type[Q], reply_type: type[R], server: str, asker: Rank = "pilot", **fields: Any
) -> Endpoint[Q, R]:
    """An endpoint that refuses a request by its one type of reply.

    Args:
        fields: fields of the refusal besides its reason.
    """
    return Endpoint(name, request_type, reply_type, server, lambda why: reply_type(reason=why, **fields), asker=asker)


@dataclass(frozen=True)
class Action(Generic[Q]):
    """One action: its goal, its feedback, its result, and the endpoints that its server declares.

    Attributes:
        name: name of the action, its server and its keys.
        goal_type: type of a goal.
        feedback_type: type of the feedback.
        result_type: type of the result.
        phase: phase of the setpoints, from which the status code follows.
        takes_pictures: whether the server also declares `image`.
        changeable: fields of a goal that may change while it is flown.
    """

    name: str
    goal_type: type[Q]
    feedback_type: Any
    result_type: Any
    phase: commands.Phase
    takes_pictures: bool = False
    changeable: tuple[str, ...] = ()

    @cached_property
    def endpoint(self) -> Endpoint[Q, actions.Rejected]:
        """Endpoint of goals, with a stream of replies to each."""
        replies = (
            actions.Accepted
            | actions.Rejected
            | actions.Feedback[self.feedback_type]  # type: ignore[name-defined]
            | actions.Result[self.result_type]  # type: ignore[name-defined]
        )
        return Endpoint(
            f"@action/{self.name}",
            self.goal_type,
            replies,
            self.name,
            lambda why: actions.Rejected(reason=why),
            needs_field=True,
        )

    @cached_property
    def plan(self) -> Endpoint[Q, actions.PlanReply]:
        """Endpoint that plans a goal without flying it."""
        return refusing(f"@action/{self.name}/plan", self.goal_type, actions.PlanReply, self.name, accepted=False)

    @cached_property
    def cancel(self) -> Endpoint[actions.Cancel, actions.CancelReply]:
        """Endpoint that ends a goal."""
        return refusing(f"@action/{self.name}/cancel", actions.Cancel, actions.CancelReply, self.name, canceled=False)

    @cached_property
    def pause(self) -> Endpoint[actions.Pause, actions.PauseReply]:
        """Endpoint that pauses a goal."""
        return refusing(f"@action/{self.name}/pause", actions.Pause, actions.PauseReply, self.name, paused=False)

    @cached_property
    def resume(self) -> Endpoint[actions.Resume, actions.ResumeReply]:
        """Endpoint that resumes a paused goal."""
        return refusing(f"@action/{self.name}/resume", actions.Resume, actions.ResumeReply, self.name, resumed=False)

    @cached_property
    def modify(self) -> Endpoint[actions.Modify, actions.ModifyReply]:
        """Endpoint that changes fields of a goal while it is flown."""
        return refusing(f"@action/{self.name}/modify", actions.Modify, actions.ModifyReply, self.name, modified=False)

    @cached_property
    def image(self) -> Endpoint[images.GetImage, images.ImageReply]:
        """Endpoint of the pixels of one image, also after the goal's end."""
        return refusing(f"@action/{self.name}/image", images.GetImage, images.ImageReply, self.name, "viewer")

    @cached_property
    def describe(self) -> Endpoint[actions.GetDescription, actions.ActionDescription]:
        """Endpoint of the action's description; it has no effect, so that `action/*/description` gets all of them."""
        return Endpoint(
            f"action/{self.name}/description",
            actions.GetDescription,
            actions.ActionDescription,
            self.name,
            lambda why: self.description,  # a request without fields has nothing to refuse
            wildcards=True,
            asker="viewer",
        )

    @cached_property
    def running(self) -> Endpoint[actions.GetRunning, actions.RunningGoal]:
        """Endpoint of the goal that is flown; it has no effect, so that `action/*/running` finds it."""
        return Endpoint(
            f"action/{self.name}/running",
            actions.GetRunning,
            actions.RunningGoal,
            self.name,
            lambda why: actions.RunningGoal(action=self.name),  # a request without fields has nothing to refuse
            wildcards=True,
            asker="viewer",
        )

    @cached_property
    def endpoints(self) -> tuple[Endpoint[Any, Any], ...]:
        """All endpoints of its server but the shared one."""
        image = (self.image,) if self.takes_pictures else ()
        requests = (self.cancel, self.pause, self.resume, self.modify)
        return (self.endpoint, self.plan, *requests, self.describe, self.running, *image)

    @cached_property
    def description(self) -> actions.ActionDescription:
        """The action's keys, and its goal, feedback and result as JSON Schema."""
        return actions.ActionDescription(
            name=self.name,
            endpoint=self.endpoint.name,
            cancel=self.cancel.name,
            plan=self.plan.name,
            pause=self.pause.name,
            resume=self.resume.name,
            modify=self.modify.name,
            changeable=self.changeable,
            goal=msgspec.json.schema(self.goal_type),
            feedback=msgspec.json.schema(self.feedback_type),
            result=msgspec.json.schema(self.result_type),
        )


CLOCK = Topic("clock", state.Clock, 10.0, "simulator")
IMU = Topic("sensor/imu", sensors.Imu, 50.0, "simulator")
GNSS = Topic("sensor/gnss", sensors.Gnss, 10.0, "simulator")
BARO = Topic("sensor/baro", sensors.Barometer, 10.0, "simulator")
MAG = Topic("sensor/mag", sensors.Magnetometer, 10.0, "simulator")
ALTIMETER = Topic("sensor/altimeter", sensors.Altimeter, 25.0, "simulator")
UWB = Topic("sensor/uwb", sensors.Uwb, 20.0, "simulator")
ROVER_ODOMETRY = Topic("rover/odometry", sensors.RoverOdometry, 25.0, "simulator", host="rover")
TRUTH = Topic("truth", state.Truth, 50.0, "simulator")
SCENE = Topic("simulator/scene", state.Scene, 15.0, "simulator")
CAMERA = Topic("sensor/camera", sensors.CameraFrame, 15.0, "camera")
CAMERA_INFO = Topic("camera/info", sensors.CameraInfo, 1.0, "camera")
TAG_CORNERS = Topic("sensor/tag_corners", sensors.TagCorners, 15.0, "camera")
ESTIMATE_TAG = Topic("estimate/tag", estimate.TagEstimate, 15.0, "tag_detector")
RELATIVE = Topic("estimate/relative", estimate.Relative, 50.0, "estimator")
ROVER_ESTIMATE = Topic("estimate/rover", estimate.RoverEstimate, 10.0, "estimator")
CAMERA_PITCH = Topic("command/camera_pitch", commands.CameraPitch, 20.0, GOAL_IN_CHARGE)
ROVER_COMMAND = Topic("rover/command", commands.RoverCommand, 10.0, CLIENTS)
ODOMETRY = Topic("odometry", state.Odometry, 50.0, "vehicle_bridge")
STATUS = Topic("status", state.Status, 10.0, "vehicle_bridge")
SETPOINT = Topic("command/setpoint", commands.Setpoint, 50.0, GOAL_IN_CHARGE, reader="service")
FENCE = Topic("fence", fence.FenceState, 1.0, "vehicle_bridge")
MISSION = Topic("mission/progress", mission.MissionProgress, 2.0, "mission")
PREFLIGHT = Topic("preflight", preflight.PreflightReport, None, "preflight")

TOPICS: tuple[Topic[Any], ...] = (
    CLOCK, IMU, GNSS, BARO, MAG, ALTIMETER, UWB, ROVER_ODOMETRY, TRUTH, ODOMETRY, STATUS, SETPOINT,
    SCENE, CAMERA, CAMERA_INFO, TAG_CORNERS, ESTIMATE_TAG, RELATIVE, ROVER_ESTIMATE, CAMERA_PITCH, ROVER_COMMAND,
    MISSION, PREFLIGHT, FENCE,
)  # fmt: skip

ACQUIRE = refusing(
    "@control/acquire", commands.Acquire, commands.AcquireReply, "vehicle_bridge", "service", granted=False
)
RELEASE = refusing(
    "@control/release", commands.Release, commands.ReleaseReply, "vehicle_bridge", "service", released=False, code=-1
)
HOVER = refusing("@control/hover", commands.Hover, commands.HoverReply, "vehicle_bridge", hover_mode=False)
ABORT = refusing("@control/abort", commands.Abort, commands.AbortReply, "vehicle_bridge", hovering=False)
KILL = refusing("@control/kill", commands.Kill, commands.KillReply, "vehicle_bridge", killed=False)
SET_FENCE = refusing("@fence/set", fence.SetFence, fence.FenceReply, "vehicle_bridge", accepted=False)
RESULT = Endpoint(
    "@action/result",
    actions.GetResult,
    actions.ResultReply,
    EVERY_ACTION,
    lambda why: actions.ResultReply(goal_id="-", action="-", running=False, result=None),
    shared=True,
    asker="viewer",
)
UNKNOWN_ACTION = Endpoint(
    "@action/**",
    actions.UnknownAction,
    actions.Rejected
    | actions.PlanReply
    | actions.CancelReply
    | actions.PauseReply
    | actions.ResumeReply
    | actions.ModifyReply,
    "vehicle_bridge",
    lambda why: actions.Rejected(reason=why),
    shared=True,
)
"""Requests to actions that don't exist."""
GET_PARAMETERS = refusing(
    "@estimator/parameters/get", estimate.GetParameters, estimate.ParametersReply, "estimator", "viewer", accepted=False
)
SET_PARAMETERS = refusing(
    "@estimator/parameters/set", estimate.SetParameters, estimate.ParametersReply, "estimator", accepted=False
)
LEASE = refusing(
    "@estimator/parameters/lease", estimate.Lease, estimate.LeaseReply, "estimator", "service", accepted=False
)
RUN_MISSION = refusing("@mission/run", mission.Mission, mission.MissionReply, "mission", accepted=False)
COMMAND_MISSION = refusing("@mission/command", mission.MissionCommand, mission.MissionReply, "mission", accepted=False)
CHECK_PREFLIGHT = refusing("@preflight/check", preflight.GetPreflight, preflight.PreflightReply, "preflight", "viewer")
GROUND = Endpoint(
    "simulator/ground",
    terrain.GetGround,
    terrain.Ground,
    "simulator",
    lambda why: terrain.Ground(reason=why),
    wildcards=True,
    asker="viewer",
)
"""The simulator's terrain, for people to look at."""

TAKEOFF = Action(
    "takeoff",
    goals.TakeoffGoal,
    goals.MoveFeedback,
    goals.MoveResult,
    commands.Phase.TAKEOFF,
    changeable=("altitude_m",),
)
GO_TO = Action(
    "go_to",
    goals.GoToGoal,
    goals.MoveFeedback,
    goals.MoveResult,
    commands.Phase.GO_TO,
    changeable=("target_ned_m", "yaw_rad", "speed_mps"),
)
LAND_ON_SPOT = Action(
    "land_on_spot",
    goals.LandOnSpotGoal,
    goals.LandFeedback,
    goals.LandResult,
    commands.Phase.LANDING,
    changeable=("landing_spot_ned_m",),
)
RETURN_HOME = Action(
    "return_home",
    goals.ReturnHomeGoal,
    goals.ReturnFeedback,
    goals.ReturnResult,
    commands.Phase.LANDING,
)
AREA_COVERAGE = Action(
    "area_coverage",
    goals.AreaCoverageGoal,
    goals.ImagesFeedback,
    goals.CoverageResult,
    commands.Phase.COVERAGE,
    takes_pictures=True,
    changeable=("polygon_ned_m", "holes_ned_m", "z_ned_m", "speed_mps"),
)
GET_IMAGES = Action(
    "get_images",
    goals.GetImagesGoal,
    goals.ImagesFeedback,
    goals.ImagesResult,
    commands.Phase.GET_IMAGES,
    takes_pictures=True,
    changeable=("center_ned_m", "radius_m", "num_images", "target_z_ned_m", "speed_mps"),
)
ACTIONS: dict[str, Action[Any]] = {
    a.name: a for a in (TAKEOFF, GO_TO, GET_IMAGES, AREA_COVERAGE, LAND_ON_SPOT, RETURN_HOME)
}

ENDPOINTS: tuple[Endpoint[Any, Any], ...] = (
    ACQUIRE, RELEASE, HOVER, ABORT, KILL, RESULT, UNKNOWN_ACTION, GET_PARAMETERS, SET_PARAMETERS, LEASE,
    RUN_MISSION, COMMAND_MISSION, CHECK_PREFLIGHT, SET_FENCE, GROUND,
    *(endpoint for action in ACTIONS.values() for endpoint in action.endpoints),
)  # fmt: skip


KEYS = ("**", "@alive/**", *sorted({f"{e.name.partition('/')[0]}/**" for e in ENDPOINTS if e.name.startswith("@")}))
"""Names that cover everything of a vehicle: `**` stops at a chunk that begins with `@`."""


def health_of(service: str) -> Topic[health.ServiceHealth]:
    """The topic on which a service's runtime publishes its health, at 1 Hz of wall time and when the state changes."""
    return Topic(f"health/{service}", health.ServiceHealth, 1.0, service)


def journal_of(service: str) -> Topic[journal.JournalPart]:
    """The topic on which a service's runtime publishes the service's journal, for the recorder."""
    return Topic(f"journal/{service}", journal.JournalPart, 10.0, service, reader="service")


def feedback_of(action: Action[Any]) -> Topic[actions.FeedbackMessage[Any]]:
    """The topic on which an action's feedback is published for every subscriber."""
    message: Any = actions.FeedbackMessage[action.feedback_type]  # type: ignore[name-defined]
    return Topic(f"action/{action.name}/feedback", message, 10.0, action.name)


def key(vehicle: str, name: str) -> str:
    """The Zenoh key of a topic or endpoint of one vehicle."""
    return f"jezero/{vehicle}/{name}"


def liveliness_key(vehicle: str, kind: Literal["service", "client", "claim"], name: str) -> str:
    """The key of the liveliness token of a service, of a client, or of a process that claims a service's name."""
    return f"jezero/{vehicle}/@alive/{kind}/{name}"
