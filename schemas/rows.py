"""The kinds of rows of the topic table: a topic, an endpoint, and an action with all its endpoints."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, Literal, TypeVar, get_origin

import msgspec

from jezero.schemas import actions, commands, images
from jezero.schemas.struct import Message, Payload

Host = Literal["vehicle", "rover"]
"""Computer of which a topic's writer is a service."""
Rank = Literal["viewer", "pilot", "service"]
"""Who may ask: everybody of the team, those who fly, or only services of the vehicle itself."""

FLYING_ODOMETRY_MIN_HZ = 8.0
"""Rate of odometry that any flight needs: a goal ends after 0.5 s without one, and three lost in a row must not end it.
In virtual time the vehicle flies to points as well at 3 Hz as at 50, see `tests/scenario/test_odometry_rates.py`."""

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
        driver: name of the service that publishes it in the place of `writer` where the sensor is a real one; "" where
            none does.
        host: computer whose services publish it; `CLIENTS` publish from anywhere. A topic of the rover's computer is
            published by the service `rover` there, or by a real rover's driver; without either by `writer`.
        link_hz: greatest rate at which it crosses a link to another computer; None for as published, 0 for never.
        urgent: whether it goes first on a link that has no room for all.
        driver: name of the service that publishes it on a real vehicle, in place of `writer`; "" for `writer` itself.
    """

    name: str
    type: type[M]
    rate_hz: float | None
    writer: str
    host: Host = "vehicle"
    link_hz: float | None = None
    urgent: bool = False
    driver: str = ""

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
        asker: who may send requests; programs of the vehicle's computer have a pilot's rights, its services all.
        needs_field: a request that names no field at all is refused: it may be a mistake, such as a look at the key.
        urgent: whether a request goes first on a link that has no room for all.
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
    urgent: bool = False


def refusing(
    name: str,
    request_type: type[Q],
    reply_type: type[R],
    server: str,
    asker: Rank = "pilot",
    *,
    urgent: bool = False,
    **fields: Any,
) -> Endpoint[Q, R]:
    """An endpoint that refuses a request by its one type of reply.

    Args:
        fields: fields of the refusal besides its reason.
    """

    def refuse(why: str) -> R:
        return reply_type(reason=why, **fields)

    return Endpoint(name, request_type, reply_type, server, refuse, asker=asker, urgent=urgent)


@dataclass(frozen=True)
class Action(Generic[Q]):
    """One action: its goal, its feedback, its result, and the endpoints that its server declares.

    Attributes:
        name: name of the action, its server and its keys.
        goal_type: type of a goal.
        feedback_type: type of the feedback.
        result_type: type of the result.
        phase: phase of the setpoints, from which the status code follows.
        takes_pictures: whether the server also declares `image`; such an action also points the camera.
        changeable: fields of a goal that may change while it is flown.
        points_camera: whether the server also declares `command/camera_pitch`, so that a move may point the camera.
        steered_by: topic of the commands by which the client of a goal steers it while it is flown; None for none.
        odometry_min_hz: rate of odometry below which the bridge of a real vehicle accepts none of its goals.
    """

    name: str
    goal_type: type[Q]
    feedback_type: Any
    result_type: Any
    phase: commands.Phase
    takes_pictures: bool = False
    changeable: tuple[str, ...] = ()
    points_camera: bool = False
    steered_by: "Topic[commands.VelocityCommand] | None" = None
    odometry_min_hz: float = FLYING_ODOMETRY_MIN_HZ

    @property
    def mission_refusal(self) -> str:
        """Reason why its goals can't be steps of a mission, or ""."""
        if self.steered_by is None:
            return ""
        return f"{self.name} follows the commands of a client, and a mission has none: take go_to"

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
        name = f"@action/{self.name}/cancel"
        return refusing(name, actions.Cancel, actions.CancelReply, self.name, urgent=True, canceled=False)

    @cached_property
    def pause(self) -> Endpoint[actions.Pause, actions.PauseReply]:
        """Endpoint that pauses a goal."""
        name = f"@action/{self.name}/pause"
        return refusing(name, actions.Pause, actions.PauseReply, self.name, urgent=True, paused=False)

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
