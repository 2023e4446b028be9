"""Goals, their feedback, and their results.

A goal is a query on `@action/<name>`. Its replies are one `Accepted` or `Rejected`, any number of `Feedback`, and
one `Result`.
"""

from typing import Annotated, Any, Generic, Literal, TypeVar

from msgspec import Meta

from jezero.schemas.commands import Outcome
from jezero.schemas.images import Image, Index
from jezero.schemas.struct import (
    Angle,
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

Frame = Literal["world", "rover"]
Overlap = Annotated[float, Meta(ge=0.0, le=0.95)]
OriginDegrees = tuple[Annotated[float, Meta(ge=-90.0, le=90.0)], Annotated[float, Meta(ge=-180.0, le=180.0)]]
PlanId = Annotated[str, Meta(max_length=64, pattern=r"^[0-9a-z]*$")]
F = TypeVar("F")
R = TypeVar("R")


class Goal(Payload, frozen=True, kw_only=True):
    """Fields of every goal.

    Attributes:
        goal_id: id of the goal, chosen by the client; a goal that is sent twice with one id runs once. "" lets the
            server choose an id.
        issued_t_ns: vehicle time at which the client sent the goal; the goal expires 30 s later. None means that it
            does not expire.
        on_client_loss: reaction to a client that disappears: `continue` flies on, `cancel` ends the goal with a hover.
        plan_from_ned_m: only for a request for a plan: the vehicle's position in world NED at the start of the flight.
            None plans from where the vehicle is, as it is. A goal with it is refused.
    """

    goal_id: Annotated[str, Meta(max_length=64, pattern=r"^[A-Za-z0-9_.-]*$")] = ""
    issued_t_ns: TimeNs | None = None
    on_client_loss: Literal["continue", "cancel"] = "continue"
    plan_from_ned_m: PositionNed | None = None


class TakeoffGoal(Goal, frozen=True, kw_only=True):
    """Climb straight up to an altitude.

    Attributes:
        altitude_m: target altitude above the take-off point, positive up.
    """

    altitude_m: float = 2.0


class GoToGoal(Goal, frozen=True, kw_only=True):
    """Fly in a straight line to a point.

    Attributes:
        target_ned_m: target point in `frame`; a negative z is up.
        frame: frame of the target.
        do_takeoff: take off first if the vehicle is on the ground.
        yaw_rad: heading at the target, clockwise from north. None keeps the present heading.
        speed_mps: speed along the path. None means the default speed of the settings.
    """

    target_ned_m: PositionNed
    frame: Frame = "world"
    do_takeoff: bool = False
    yaw_rad: Angle | None = None
    speed_mps: float | None = None


class LandOnSpotGoal(Goal, frozen=True, kw_only=True):
    """Land on the rover, or on a spot on the ground.

    With UWB or the tags, the vehicle lands on the rover. With neither, it lands on the spot.

    Attributes:
        landing_spot_ned_m: point in `frame`, whose meaning depends on the sensors. With UWB it is not used. With the
            tags alone it is the approximate position of the rover. With neither it is the spot to land on; its z is not
            used, because the vehicle descends until it touches the ground.
        frame: frame of `landing_spot_ned_m`; without UWB only `world` is accepted.
        use_uwb: use the UWB ranges to the rover.
        use_tag: use the camera's detections of the tags on the platform.
        force: land in more wind than the settings allow, too.
    """

    landing_spot_ned_m: PositionNed | None = None
    frame: Frame = "world"
    use_uwb: bool = True
    use_tag: bool = True
    force: bool = False


class GetImagesGoal(Goal, frozen=True, kw_only=True):
    """Take images of a target from all sides, on a circle around it.

    Attributes:
        center_ned_m: centre of the circle in `frame`; its z is the height of the flight, negative is up.
        radius_m: radius of the circle.
        num_images: number of images, 1 to 255, spread evenly over one turn.
        frame: frame of `center_ned_m` and `target_z_ned_m`. With `rover` the circle moves along with the rover.
        target_z_ned_m: z of the target in `frame`. The target is straight above or below the centre, and the camera
            points at it.
        speed_mps: speed along the circle. None means the default speed of the settings.
        stream_images: report each image in the feedback as soon as it is taken. With false, only the result lists the
            images.
    """

    center_ned_m: PositionNed
    radius_m: float
    num_images: int
    frame: Frame = "world"
    target_z_ned_m: Position = 0.0
    speed_mps: float | None = None
    stream_images: bool = True


Corners = tuple[tuple[Position, Position], ...]
"""(n, 2) north and east of a polygon's corners, in order; the last one may repeat the first one."""


class AreaCoverageGoal(Goal, frozen=True, kw_only=True):
    """Map an area: fly over it in lines and take images.

    Either `resolution_m` is given, or `overlap` or `sidelap`, from which the distances follow by the camera's view of
    level ground at z = 0. A goal with both is refused.

    Attributes:
        polygon_ned_m: corners of the area in `frame`, each north and east.
        holes_ned_m: polygons inside the area that are left out, in `frame`.
        origin_deg: latitude and longitude of the world's origin around which an area in degrees became these metres.
            With it, refusals and warnings name places of the area in degrees too, and a goal is refused whose origin
            is more than 1 m away from the vehicle's. None for an area in metres.
        margin_outline_m: least horizontal distance of the vehicle from the polygon's outline, inside it. 0 means that
            its path stays inside.
        margin_holes_m: least horizontal distance of the vehicle from each hole. 0 means that its path stays outside.
        z_ned_m: height of the flight in `frame`; negative is up.
        resolution_m: distance between two lines, and between two images on a line.
        overlap: fraction of an image that the next image on the line shows again. None takes the value of `sidelap`.
        sidelap: fraction of an image that the image on the next line shows again. None takes the value of `overlap`.
        frame: frame of all positions of the goal. With `rover` the area is fixed in the world when the goal is
            accepted.
        speed_mps: speed along the lines, limited so that the camera's rate suffices for the images. None means the
            default speed of the settings.
        start_ned_m: north and east of a point in `frame`; the path begins near it. None means near the vehicle.
        first_picture: number of the planned image to start with, counted from 0; the images before it are left out.
            Above 0 only in the frame `world`.
        plan_id: id of the plan to fly, from the reply to the same goal on `@action/area_coverage/plan`. A server knows
            a plan for ten minutes, while the vehicle stays where it was. "" plans anew.
        force: fly also where less than 90 % of the area would be in the images, or higher than the altimeter reaches,
            so that no map can be made.
    """

    polygon_ned_m: Corners
    holes_ned_m: tuple[Corners, ...] = ()
    origin_deg: OriginDegrees | None = None
    margin_outline_m: NonNegative = 0.0
    margin_holes_m: NonNegative = 1.0
    z_ned_m: Position
    resolution_m: NonNegative | None = None
    overlap: Overlap | None = None
    sidelap: Overlap | None = None
    frame: Frame = "world"
    speed_mps: float | None = None
    start_ned_m: tuple[Position, Position] | None = None
    first_picture: Index = 0
    plan_id: PlanId = ""
    force: bool = False


class MoveFeedback(Payload, frozen=True, kw_only=True, tag_field="kind", tag="move"):
    """Progress of a flight to a point.

    Attributes:
        pos_uav_ned_m: position of the vehicle in `frame`.
        frame: frame of the position.
        distance_m: remaining distance to the target.
    """

    pos_uav_ned_m: PositionNed
    frame: Frame = "world"
    distance_m: NonNegative


LandPhase = Literal["approach", "descent", "hold", "search", "contact", "go_around"]


class LandFeedback(Payload, frozen=True, kw_only=True, tag_field="kind", tag="land"):
    """Progress of a landing.

    Attributes:
        pos_uav_ned_m: position of the vehicle in `frame`.
        frame: frame of the position.
        pos_rel_ned_m: position of the vehicle minus that of the platform, or of the landing spot. None while it is
            unknown.
        phase: phase of the landing. `approach` flies to a point above the platform or the spot, `descent` descends,
            `hold` keeps the height while the platform is out of sight, `search` searches for the platform, `contact`
            follows the touchdown, `go_around` climbs after a bad one.
        cone_m: horizontal distance from the middle of the platform up to which the vehicle descends at its present
            height. None for a landing on a spot, and while the platform's position is unknown.
    """

    pos_uav_ned_m: PositionNed
    frame: Frame = "world"
    pos_rel_ned_m: PositionNed | None = None
    phase: LandPhase
    cone_m: NonNegative | None = None


class ImagesFeedback(Payload, frozen=True, kw_only=True, tag_field="kind", tag="images"):
    """Progress of a goal that takes images.

    Attributes:
        pos_uav_ned_m: position of the vehicle in `frame`.
        frame: frame of the position.
        phase: `planning` before the goal is accepted, on the topic only; then `flying`.
        taken: number of images taken so far.
        planned: number of images that the goal will take in total.
        images: images taken since the last feedback; always empty for a goal with `stream_images` = false.
    """

    pos_uav_ned_m: PositionNed
    frame: Frame = "world"
    phase: Literal["planning", "flying"] = "flying"
    taken: Index
    planned: Index
    images: tuple[Image, ...] = ()


class MoveResult(Payload, frozen=True, kw_only=True):
    """End of a flight to a point.

    Attributes:
        completed: true after a success.
        pos_uav_ned_m: final position of the vehicle in world NED, whatever the goal's frame.
    """

    completed: bool
    pos_uav_ned_m: PositionNed


class ImagesResult(Payload, frozen=True, kw_only=True):
    """Images of a goal, also of one that was canceled or aborted.

    Attributes:
        completed: true after a success.
        pos_uav_ned_m: final position of the vehicle in world NED, whatever the goal's frame.
        images: all images that were taken; their positions are in world NED, whatever the goal's frame.
    """

    completed: bool
    pos_uav_ned_m: PositionNed
    images: tuple[Image, ...] = ()


class CoverageResult(ImagesResult, frozen=True, kw_only=True):
    """Images of an area, and the part of it that was covered.

    Attributes:
        covered: fraction of the area that is at most half a line distance away from the flown path, by the vehicle's
            own position estimate.
        photographed: fraction of the area that is in at least one image, on level ground at z = 0 of the world, by the
            vehicle's own estimate. None from older servers.
        resume: goal that takes the missing images, in the world frame. None when no image is missing.
    """

    covered: Fraction
    photographed: Fraction | None = None
    resume: AreaCoverageGoal | None = None


class LandResult(Payload, frozen=True, kw_only=True):
    """End of a landing.

    Attributes:
        completed: true after a success.
        touchdown_ned_m: position of the touchdown in world NED, by the vehicle's own estimate. None without a
            touchdown.
    """

    completed: bool
    touchdown_ned_m: PositionNed | None = None


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
    """

    goal_id: Name
    t_ns: TimeNs
    code: int
    feedback: F
    remaining_s: NonNegative | None = None
    paused: bool = False


class Result(Payload, Generic[R], frozen=True, kw_only=True, tag_field="type", tag="result"):
    """Last reply to an accepted goal.

    Attributes:
        goal_id: id of the goal.
        t_ns: vehicle time of the goal's end.
        outcome: end of the goal: `succeeded`, `canceled` or `aborted`.
        reason: reason of a canceled or aborted goal, for people; "" after a success.
        result: result, in the action's own type. None when the action's code failed before it could make one.
    """

    goal_id: Name
    t_ns: TimeNs
    outcome: Outcome
    reason: Text = ""
    result: R | None


class FeedbackMessage(Message, Generic[F], frozen=True, kw_only=True):
    """Feedback of a goal on the topic of its action, for every subscriber.

    Attributes:
        goal_id: id of the goal.
        action: name of the action.
        code: status code of the vehicle.
        feedback: progress, in the action's own type.
        remaining_s: time to the goal's end by its plan, see `Feedback`.
        paused: the goal is paused, see `Feedback`.
    """

    goal_id: Name
    action: Name
    code: int
    feedback: F
    remaining_s: NonNegative | None = None
    paused: bool = False


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
    """

    action: Name
    goal_id: str = ""
    clients: tuple[Annotated[str, Meta(max_length=64)], ...] = ()
    goal: dict[str, Any] = {}
    coverage: PlannedCoverage | None = None
    images: tuple[Image, ...] = ()


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
