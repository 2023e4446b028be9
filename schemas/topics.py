"""EVERY key: name, message type, rate, delivery. Keys are `jezero/<vehicle>/<name>`.

Anything with an effect is behind an `@` chunk, which the wildcards `*` and `**` never match.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, Literal, TypeVar

from jezero.schemas import actions, commands, estimate, health, images, sensors, state
from jezero.schemas.struct import Message, Payload

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Payload)
R = TypeVar("R", bound=Payload)


@dataclass(frozen=True)
class Topic(Generic[M]):
    """A key that messages are published on.

    Attributes:
        rate_hz: nominal; None when it is sent on events only.
        delivery: `newest` may drop when the network is congested, `all` waits.
    """

    name: str
    type: type[M]
    rate_hz: float | None
    delivery: Literal["newest", "all"] = "newest"


@dataclass(frozen=True)
class Endpoint(Generic[Q, R]):
    """A key that questions are put to.

    Attributes:
        reply_type: type (or union of types) of each reply.
        refuse: makes the reply for a question that can't be decoded or served, from the reason.
        shared: several servers answer on this key, each only what it knows.
    """

    name: str
    request_type: type[Q]
    reply_type: Any
    refuse: Callable[[str], R]
    shared: bool = False


@dataclass(frozen=True)
class Action(Generic[Q]):
    """One action: its goal, what it reports, how it ends, and the endpoints it is served on.

    Attributes:
        takes_pictures: whether it is served on `image` too.
    """

    name: str
    goal_type: type[Q]
    feedback_type: Any
    result_type: Any
    phase: commands.Phase
    takes_pictures: bool = False

    @cached_property
    def endpoint(self) -> Endpoint[Q, actions.Rejected]:
        replies = (
            actions.Accepted
            | actions.Rejected
            | actions.Feedback[self.feedback_type]  # type: ignore[name-defined]
            | actions.Result[self.result_type]  # type: ignore[name-defined]
        )
        return Endpoint(f"@action/{self.name}", self.goal_type, replies, lambda why: actions.Rejected(reason=why))

    @cached_property
    def cancel(self) -> Endpoint[actions.Cancel, actions.CancelReply]:
        return Endpoint(
            f"@action/{self.name}/cancel",
            actions.Cancel,
            actions.CancelReply,
            lambda why: actions.CancelReply(canceled=False, reason=why),
        )

    @cached_property
    def image(self) -> Endpoint[images.GetImage, images.ImageReply]:
        """The pixels of one picture per question, also after the goal's end."""
        return Endpoint(
            f"@action/{self.name}/image",
            images.GetImage,
            images.ImageReply,
            lambda why: images.ImageReply(reason=why),
        )


CLOCK = Topic("clock", state.Clock, 10.0, "all")
IMU = Topic("sensor/imu", sensors.Imu, 50.0)
GNSS = Topic("sensor/gnss", sensors.Gnss, 10.0)
BARO = Topic("sensor/baro", sensors.Barometer, 10.0)
MAG = Topic("sensor/mag", sensors.Magnetometer, 10.0)
ALTIMETER = Topic("sensor/altimeter", sensors.Altimeter, 25.0)
UWB = Topic("sensor/uwb", sensors.Uwb, 20.0)
ROVER_ODOMETRY = Topic("rover/odometry", sensors.RoverOdometry, 25.0)
TRUTH = Topic("truth", state.Truth, 50.0)
SCENE = Topic("simulator/scene", state.Scene, 15.0)
CAMERA = Topic("sensor/camera", sensors.CameraFrame, 15.0)
CAMERA_INFO = Topic("camera/info", sensors.CameraInfo, 1.0)
TAG_CORNERS = Topic("sensor/tag_corners", sensors.TagCorners, 15.0)
ESTIMATE_TAG = Topic("estimate/tag", estimate.TagEstimate, 15.0)
RELATIVE = Topic("estimate/relative", estimate.Relative, 50.0)
ROVER_ESTIMATE = Topic("estimate/rover", estimate.RoverEstimate, 10.0)
CAMERA_PITCH = Topic("command/camera_pitch", commands.CameraPitch, 20.0)
ROVER_COMMAND = Topic("rover/command", commands.RoverCommand, 10.0)
ODOMETRY = Topic("odometry", state.Odometry, 50.0)
STATUS = Topic("status", state.Status, 10.0, "all")
SETPOINT = Topic("command/setpoint", commands.Setpoint, 50.0)

TOPICS: tuple[Topic[Any], ...] = (
    CLOCK, IMU, GNSS, BARO, MAG, ALTIMETER, UWB, ROVER_ODOMETRY, TRUTH, ODOMETRY, STATUS, SETPOINT,
    SCENE, CAMERA, CAMERA_INFO, TAG_CORNERS, ESTIMATE_TAG, RELATIVE, ROVER_ESTIMATE, CAMERA_PITCH, ROVER_COMMAND,
)  # fmt: skip

ACQUIRE = Endpoint(
    "@control/acquire",
    commands.Acquire,
    commands.AcquireReply,
    lambda why: commands.AcquireReply(granted=False, reason=why),
)
RELEASE = Endpoint(
    "@control/release",
    commands.Release,
    commands.ReleaseReply,
    lambda why: commands.ReleaseReply(released=False, code=-1, reason=why),
)
HOVER = Endpoint(
    "@control/hover",
    commands.Hover,
    commands.HoverReply,
    lambda why: commands.HoverReply(hover_mode=False, reason=why),
)
ABORT = Endpoint(
    "@control/abort",
    commands.Abort,
    commands.AbortReply,
    lambda why: commands.AbortReply(hovering=False, reason=why),
)
KILL = Endpoint(
    "@control/kill",
    commands.Kill,
    commands.KillReply,
    lambda why: commands.KillReply(killed=False, reason=why),
)
RESULT = Endpoint(
    "@action/result",
    actions.GetResult,
    actions.ResultReply,
    lambda why: actions.ResultReply(goal_id="-", action="-", running=False, result=None),
    shared=True,
)
GET_PARAMETERS = Endpoint(
    "@estimator/parameters/get",
    estimate.GetParameters,
    estimate.ParametersReply,
    lambda why: estimate.ParametersReply(accepted=False, reason=why),
)
SET_PARAMETERS = Endpoint(
    "@estimator/parameters/set",
    estimate.SetParameters,
    estimate.ParametersReply,
    lambda why: estimate.ParametersReply(accepted=False, reason=why),
)
LEASE = Endpoint(
    "@estimator/parameters/lease",
    estimate.Lease,
    estimate.LeaseReply,
    lambda why: estimate.LeaseReply(accepted=False, reason=why),
)

TAKEOFF = Action("takeoff", actions.TakeoffGoal, actions.MoveFeedback, actions.MoveResult, commands.Phase.TAKEOFF)
GO_TO = Action("go_to", actions.GoToGoal, actions.MoveFeedback, actions.MoveResult, commands.Phase.GO_TO)
LAND_ON_SPOT = Action(
    "land_on_spot", actions.LandOnSpotGoal, actions.LandFeedback, actions.LandResult, commands.Phase.LANDING
)
AREA_COVERAGE = Action(
    "area_coverage",
    actions.AreaCoverageGoal,
    actions.ImagesFeedback,
    actions.CoverageResult,
    commands.Phase.COVERAGE,
    takes_pictures=True,
)
GET_IMAGES = Action(
    "get_images",
    actions.GetImagesGoal,
    actions.ImagesFeedback,
    actions.ImagesResult,
    commands.Phase.GET_IMAGES,
    takes_pictures=True,
)
ACTIONS: dict[str, Action[Any]] = {a.name: a for a in (TAKEOFF, GO_TO, GET_IMAGES, AREA_COVERAGE, LAND_ON_SPOT)}

ENDPOINTS: tuple[Endpoint[Any, Any], ...] = (
    ACQUIRE, RELEASE, HOVER, ABORT, KILL, RESULT, GET_PARAMETERS, SET_PARAMETERS, LEASE,
    *(a.endpoint for a in ACTIONS.values()), *(a.cancel for a in ACTIONS.values()),
    *(a.image for a in ACTIONS.values() if a.takes_pictures),
)  # fmt: skip


def health_of(service: str) -> Topic[health.ServiceHealth]:
    """The topic on which a service's runtime reports at 1 Hz of wall time."""
    return Topic(f"health/{service}", health.ServiceHealth, 1.0)


def feedback_of(action: Action[Any]) -> Topic[actions.FeedbackMessage]:
    """The topic on which an action's feedback goes to anyone watching."""
    return Topic(f"action/{action.name}/feedback", actions.FeedbackMessage, 10.0)


def key(vehicle: str, name: str) -> str:
    """The Zenoh key of a topic or endpoint of one vehicle."""
    return f"jezero/{vehicle}/{name}"


def liveliness_key(vehicle: str, kind: Literal["service", "client", "claim"], name: str) -> str:
    """The liveliness token that says that a service or a client is there, or that somebody wants a service's name."""
    return f"jezero/{vehicle}/@alive/{kind}/{name}"
