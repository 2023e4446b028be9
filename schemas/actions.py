"""Messages about the goals of any action: replies, plans, descriptions, and requests about a goal that is flown.

A goal is a query on `@action/<name>`. Its replies are one `Accepted` or `Rejected`, any number of `Feedback`, and
one `Result`.
"""

from typing import Annotated, Any, ClassVar, Generic, TypeVar

from msgspec import Meta

from jezero.schemas.commands import Outcome
from jezero.schemas.goals import Corners, PlanId
from jezero.schemas.images import Image
from jezero.schemas.state import Geodetic
from jezero.schemas.struct import (
    Fraction,
    Message,
    Name,
    NonNegative,
    Payload,
    Position,
    PositionNed,
    Text,
    TimeNs,
)

F = TypeVar("F")
R = TypeVar("R")


class Accepted(Payload, frozen=True, kw_only=True, tag_field="type", tag="accepted"):
    """First reply to a goal that will be flown.

    Attributes:
        goal_id: id of the goal.
        warning: part of the goal that is done differently from the request, for people; "" for none.
    """

    goal_id: Name
    warning: Text = ""


class Rejected(Payload, frozen=True, kw_only=True, tag_field="type", tag="rejected"):
    """Only reply to a goal that is refused.

    Attributes:
        goal_id: id of the goal; "" for a goal that could not be decoded.
        reason: reason of the refusal, with what to do instead, for people.
        code: status code of the vehicle at the refusal. None when it is unknown.
    """

    goal_id: str = ""
    reason: Text
    code: int | None = None


class Feedback(Payload, Generic[F], frozen=True, kw_only=True, tag_field="type", tag="feedback"):
    """Reply with the progress of a goal, sent while it is flown.

    Attributes:
        goal_id: id of the goal.
        t_ns: vehicle time of the feedback.
        code: status code of the vehicle.
        feedback: progress, in the action's own type.
        remaining_s: time to the goal's end by its plan, without waits for wind, rover or a pause. None where it is
            unknown.
        paused: the goal is paused, and the vehicle hovers.
        changes: how often the goal's fields were changed since its start.
    """

    goal_id: Name
    t_ns: TimeNs
    code: int
    feedback: F
    remaining_s: NonNegative | None = None
    paused: bool = False
    changes: Annotated[int, Meta(ge=0)] = 0


class Result(Payload, Generic[R], frozen=True, kw_only=True, tag_field="type", tag="result"):
    """Last reply to an accepted goal.

    Attributes:
        goal_id: id of the goal.
        t_ns: vehicle time of the goal's end.
        outcome: end of the goal: `succeeded`, `canceled` or `aborted`.
        reason: reason of a canceled or aborted goal, for people; "" after a success.
        result: result, in the action's own type. None when the action's code failed before it could make one.
        position_deg: latitude, longitude and altitude of the vehicle at the end, by the autopilot. None without GNSS.
    """

    goal_id: Name
    t_ns: TimeNs
    outcome: Outcome
    reason: Text = ""
    result: R | None
    position_deg: Geodetic | None = None


class FeedbackMessage(Message, Generic[F], frozen=True, kw_only=True):
    """Feedback of a goal on the topic of its action, for every subscriber.

    Attributes:
        goal_id: id of the goal.
        action: name of the action.
        code: status code of the vehicle.
        feedback: progress, in the action's own type.
        remaining_s: time to the goal's end by its plan, see `Feedback`.
        paused: the goal is paused, see `Feedback`.
        changes: how often the goal's fields were changed, see `Feedback`.
    """

    goal_id: Name
    action: Name
    code: int
    feedback: F
    remaining_s: NonNegative | None = None
    paused: bool = False
    changes: Annotated[int, Meta(ge=0)] = 0


class PlannedCoverage(Payload, frozen=True, kw_only=True):
    """Plan of an area coverage. Its points are north and east in the goal's frame.

    Attributes:
        plan_id: id of the plan; a goal with this `plan_id` flies exactly this plan.
        path_ned_m: (n, 2) path from the first image on, to the centimetre.
        pictures_ned_m: (m, 2) points at which images are taken.
        start_ned_m: point near which the path begins: that of the goal, or the vehicle's position.
        line_distance_m: distance between two lines.
        picture_distance_m: distance between two images along the path.
        length_m: length of the path.
        duration_s: duration of the flight along the path.
        covered: fraction of the area that is at most half a line distance away from the path.
        photographed: fraction of the area that is in at least one image, on level ground.
    """

    plan_id: PlanId
    path_ned_m: Corners
    pictures_ned_m: Corners
    start_ned_m: tuple[Position, Position]
    line_distance_m: NonNegative
    picture_distance_m: NonNegative
    length_m: NonNegative
    duration_s: NonNegative
    covered: Fraction
    photographed: Fraction


class PlanReply(Payload, frozen=True, kw_only=True):
    """Reply to a goal that is planned and not flown.

    Attributes:
        accepted: the goal would be accepted now.
        reason: reason why it would be refused, for people.
        input_missing: the refusal is for a measurement that is missing now, and may be there in flight.
        code: status code of the vehicle. None when it is unknown.
        warning: part of the goal that would be done differently from the request, for people; "" for none.
        duration_s: planned duration of the flight, without waits for wind or rover. None where it is unknown.
        distance_m: planned length of the flight. None where it is unknown.
        battery_used: fraction of the battery's capacity that the flight uses. None where the duration is unknown.
        battery_remaining: present fraction of the battery's capacity. None when the autopilot doesn't measure it.
        battery_critical: fraction that must be left, see `Battery.critical`. None when it is unknown.
        coverage: path and images of an area coverage. None for other actions.
        path_ned_m: (n, 3) corners of the planned way in world NED, from the vehicle's position to the end of the goal.
            Empty where it is unknown.
    """

    accepted: bool
    reason: Text = ""
    input_missing: bool = False
    code: int | None = None
    warning: Text = ""
    duration_s: NonNegative | None = None
    distance_m: NonNegative | None = None
    battery_used: NonNegative | None = None
    battery_remaining: Fraction | None = None
    battery_critical: Fraction | None = None
    coverage: PlannedCoverage | None = None
    path_ned_m: tuple[PositionNed, ...] = ()


class UnknownAction(Payload, frozen=True, kw_only=True):
    """Request on a key below `@action/` that no action server may have; the runtime makes it, whatever the client sent.

    Attributes:
        key: the key, without `jezero/<vehicle>/`.
    """

    key: str


class GetDescription(Payload, frozen=True, kw_only=True):
    """Request for the description of an action; it has no fields."""


class ActionDescription(Payload, frozen=True, kw_only=True):
    """Description of an action, from which a program can send its goals.

    Attributes:
        name: name of the action.
        endpoint: key of its goals, without `jezero/<vehicle>/`.
        cancel: key that ends a goal.
        plan: key that plans a goal without flying it.
        pause: key that pauses a goal.
        resume: key that resumes a paused goal.
        modify: key that changes fields of a goal while it is flown.
        changeable: fields of a goal that may change while it is flown.
        goal: JSON Schema of a goal.
        feedback: JSON Schema of the field `feedback` of the replies while a goal is flown.
        result: JSON Schema of the field `result` of the last reply.
    """

    has_lines: ClassVar[bool] = True

    name: Name
    endpoint: Text
    cancel: Text
    plan: Text
    pause: Text = ""
    resume: Text = ""
    modify: Text = ""
    changeable: tuple[Text, ...] = ()
    goal: dict[str, Any]
    feedback: dict[str, Any]
    result: dict[str, Any]


class GetRunning(Payload, frozen=True, kw_only=True):
    """Request for the goal that an action server flies; it has no fields."""


class RunningGoal(Payload, frozen=True, kw_only=True):
    """The goal that an action server flies, for other clients than the one that sent it.

    Attributes:
        action: name of the action.
        goal_id: id of the goal; "" while the server flies none.
        clients: ids of the clients that sent it and are still connected.
        goal: the goal's fields as JSON.
        coverage: plan of an area coverage. None for other goals.
        images: images taken so far, in the present world frame.
        path_ned_m: (n, 3) corners of the way that was planned last, in world NED. Empty where it is unknown.
    """

    action: Name
    goal_id: str = ""
    clients: tuple[Annotated[str, Meta(max_length=64)], ...] = ()
    goal: dict[str, Any] = {}
    coverage: PlannedCoverage | None = None
    images: tuple[Image, ...] = ()
    path_ned_m: tuple[PositionNed, ...] = ()


class Cancel(Payload, frozen=True, kw_only=True):
    """Request to cancel a goal.

    Attributes:
        goal_id: id of the goal.
    """

    goal_id: Name


class CancelReply(Payload, frozen=True, kw_only=True):
    """Reply to `Cancel`.

    Attributes:
        canceled: the goal was running and is ending; its result is a reply to the goal's own query.
        reason: reason why nothing was canceled, for people.
    """

    canceled: bool
    reason: Text = ""


class Pause(Payload, frozen=True, kw_only=True):
    """Request to pause a goal: the vehicle brakes and hovers until the goal is resumed or ends.

    Attributes:
        goal_id: id of the goal.
        issued_t_ns: vehicle time at which the client sent the request. A request that is older than 30 s, or than the
            last one to pause or resume the goal, has no effect. None means that the age is not checked.
    """

    goal_id: Name
    issued_t_ns: TimeNs | None = None


class PauseReply(Payload, frozen=True, kw_only=True):
    """Reply to `Pause`.

    Attributes:
        paused: the goal pauses; `paused` in the status and in the feedback is true once the vehicle hovers.
        reason: reason why it does not, for people.
    """

    paused: bool
    reason: Text = ""


class Resume(Payload, frozen=True, kw_only=True):
    """Request to go on with a paused goal.

    Attributes:
        goal_id: id of the goal.
        issued_t_ns: vehicle time at which the client sent the request, see `Pause`.
    """

    goal_id: Name
    issued_t_ns: TimeNs | None = None


class ResumeReply(Payload, frozen=True, kw_only=True):
    """Reply to `Resume`.

    Attributes:
        resumed: the goal goes on.
        reason: reason why it does not, for people.
    """

    resumed: bool
    reason: Text = ""


class Modify(Payload, frozen=True, kw_only=True):
    """Request to change fields of a goal while it is flown, or paused.

    Attributes:
        goal_id: id of the goal.
        fields: new values of fields of the goal; all others stay. `changeable` in the action's description lists the
            fields that may change.
        issued_t_ns: vehicle time at which the client sent the request. A request that is older than 30 s, or than the
            last one to modify the goal, has no effect. None means that the age is not checked.
    """

    goal_id: Name
    fields: dict[str, Any]
    issued_t_ns: TimeNs | None = None


class ModifyReply(Payload, frozen=True, kw_only=True):
    """Reply to `Modify`.

    Attributes:
        modified: the goal goes on with the new values.
        reason: reason why it goes on with the old ones, for people.
        warning: part of the new goal that is done differently from the request, for people; "" for none.
    """

    modified: bool
    reason: Text = ""
    warning: Text = ""


class GetResult(Payload, frozen=True, kw_only=True):
    """Request for the result of a goal. All action servers receive it; only the server of that goal replies.

    Attributes:
        goal_id: id of the goal.
    """

    goal_id: Name


class ResultReply(Payload, frozen=True, kw_only=True):
    """Reply to `GetResult`.

    Attributes:
        goal_id: id of the goal.
        action: name of the action.
        running: the goal has not ended yet.
        result: the goal's `Result` as JSON. None while the goal is running.
    """

    goal_id: Name
    action: Name
    running: bool
    result: Annotated[str, Meta(max_length=4_000_000)] | None = None
