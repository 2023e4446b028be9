"""Goals, what they report while they run, and how they end.

A goal is a query on `@action/<name>`. Its replies are one `Accepted` or `Rejected`, any number of `Feedback`, and
one `Result`.
"""

from typing import Annotated, Generic, Literal, TypeVar

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
F = TypeVar("F")
R = TypeVar("R")


class Goal(Payload, frozen=True, kw_only=True):
    """What every goal carries.

    Attributes:
        goal_id: chosen by the client, so that a goal sent twice runs once; made by the server when empty.
        issued_t_ns: vehicle time at which the client sent it; it expires after 30 s. None: never.
        on_client_loss: what happens when the client vanishes.
    """

    goal_id: Annotated[str, Meta(max_length=64, pattern=r"^[A-Za-z0-9_.-]*$")] = ""
    issued_t_ns: TimeNs | None = None
    on_client_loss: Literal["continue", "cancel"] = "continue"


class TakeoffGoal(Goal, frozen=True, kw_only=True):
    """altitude_m: above the take-off point, positive up."""

    altitude_m: float = 2.0


class GoToGoal(Goal, frozen=True, kw_only=True):
    """Fly to a point.

    Attributes:
        target_ned_m: in `frame`; negative z is up.
        do_takeoff: take off first when idle.
        yaw_rad: heading at the target, None keeps the present one.
        speed_mps: along the path, None for the default.
    """

    target_ned_m: PositionNed
    frame: Frame = "world"
    do_takeoff: bool = False
    yaw_rad: Angle | None = None
    speed_mps: float | None = None


class LandOnSpotGoal(Goal, frozen=True, kw_only=True):
    """Land on a spot.

    Attributes:
        landing_spot_ned_m: in `frame`; with the marker alone the rough position of the rover, with neither sensor the
            spot itself, whose z is not used: the vehicle descends until it touches down. With UWB not needed.
    """

    landing_spot_ned_m: PositionNed | None = None
    frame: Frame = "world"
    use_uwb: bool = True
    use_tag: bool = True


class GetImagesGoal(Goal, frozen=True, kw_only=True):
    """Photograph a target from all sides, on a circle around it.

    Attributes:
        center_ned_m: of the circle, in `frame`; its z is the height of the flight, negative is up.
        num_images: spread evenly over one turn.
        target_z_ned_m: in `frame`: what is straight above or below the centre at this height is in the middle of each
            picture.
        speed_mps: along the circle, None for the default.
        stream_images: feedback tells of each picture as it is taken; else only the result tells.
    """

    center_ned_m: PositionNed
    radius_m: float
    num_images: int
    frame: Frame = "world"
    target_z_ned_m: Position = 0.0
    speed_mps: float | None = None
    stream_images: bool = True


Corners = tuple[tuple[Position, Position], ...]
"""(n, 2) north and east of a polygon's corners, in order; the last may repeat the first."""


class AreaCoverageGoal(Goal, frozen=True, kw_only=True):
    """Map an area: sweep it in lines, taking pictures.

    Attributes:
        polygon_ned_m, holes_ned_m: in `frame`, which is frozen to the world when the goal is accepted.
        z_ned_m: height of the flight; negative is up.
        resolution_m: distance between lines and between pictures, unless `overlap` is given.
        overlap, sidelap: shares of a picture that the next one, and that of the next line, show again; instead of
            `resolution_m`, from what the camera sees of level ground from that height.
        speed_mps: None for the default; never more than half of the pictures' distance times the camera's rate.
        start_ned_m: (2,) north and east in `frame`; the path begins near it. None: near the vehicle.
        first_picture: go on with this one, counted from 0, of the path that everything else gives.
    """

    polygon_ned_m: Corners
    holes_ned_m: tuple[Corners, ...] = ()
    z_ned_m: Position
    resolution_m: NonNegative | None = None
    overlap: Overlap | None = None
    sidelap: Overlap | None = None
    frame: Frame = "world"
    speed_mps: float | None = None
    start_ned_m: tuple[Position, Position] | None = None
    first_picture: Index = 0


class MoveFeedback(Payload, frozen=True, kw_only=True, tag_field="kind", tag="move"):
    """pos_uav_ned_m: in `frame`; distance_m: to the goal's point."""

    pos_uav_ned_m: PositionNed
    frame: Frame = "world"
    distance_m: NonNegative


LandPhase = Literal["approach", "descent", "hold", "search", "contact"]


class LandFeedback(Payload, frozen=True, kw_only=True, tag_field="kind", tag="land"):
    """How a landing goes.

    Attributes:
        pos_rel_ned_m: vehicle relative to the landing spot, or to the rover's platform; None as long as it isn't known.
        phase: `hold` waits at its height for a rover out of sight, `search` looks for it.
    """

    pos_uav_ned_m: PositionNed
    frame: Frame = "world"
    pos_rel_ned_m: PositionNed | None = None
    phase: LandPhase


class ImagesFeedback(Payload, frozen=True, kw_only=True, tag_field="kind", tag="images"):
    """How the taking of pictures goes.

    Attributes:
        pos_uav_ned_m: in `frame`.
        taken, planned: numbers of pictures.
        images: taken since the last feedback; always empty without `stream_images`.
    """

    pos_uav_ned_m: PositionNed
    frame: Frame = "world"
    taken: Index
    planned: Index
    images: tuple[Image, ...] = ()


class MoveResult(Payload, frozen=True, kw_only=True):
    """pos_uav_ned_m: where it ended, in world NED whatever the goal's frame."""

    completed: bool
    pos_uav_ned_m: PositionNed


class ImagesResult(Payload, frozen=True, kw_only=True):
    """What was photographed, also by a goal that could not be finished.

    Attributes:
        pos_uav_ned_m: where it ended; this and all positions of `images` in world NED, whatever the goal's frame.
    """

    completed: bool
    pos_uav_ned_m: PositionNed
    images: tuple[Image, ...] = ()


class CoverageResult(ImagesResult, frozen=True, kw_only=True):
    """How much was mapped.

    Attributes:
        covered: share of the area within half a line distance of the way flown, by the vehicle's own estimate.
        resume: the goal that takes the pictures that are missing, in the world frame; None when there are none.
    """

    covered: Fraction
    resume: AreaCoverageGoal | None = None


class LandResult(Payload, frozen=True, kw_only=True):
    """touchdown_ned_m: by the vehicle's own estimate, world NED; None when it did not touch down."""

    completed: bool
    touchdown_ned_m: PositionNed | None = None


class Accepted(Payload, frozen=True, kw_only=True, tag_field="type", tag="accepted"):
    """`warning` tells what of the goal was not done as asked."""

    goal_id: Name
    warning: Text = ""


class Rejected(Payload, frozen=True, kw_only=True, tag_field="type", tag="rejected"):
    """`reason` tells what to do instead; `code` is the status at that time, None when unknown."""

    goal_id: str = ""
    reason: Text
    code: int | None = None


class Feedback(Payload, Generic[F], frozen=True, kw_only=True, tag_field="type", tag="feedback"):
    goal_id: Name
    t_ns: TimeNs
    code: int
    feedback: F


class Result(Payload, Generic[R], frozen=True, kw_only=True, tag_field="type", tag="result"):
    """The end of a goal.

    Attributes:
        reason: of a goal that was canceled or aborted.
        result: of the action; None when the action's own code failed so badly that there is none.
    """

    goal_id: Name
    t_ns: TimeNs
    outcome: Outcome
    reason: Text = ""
    result: R | None


class FeedbackMessage(Message, Generic[F], frozen=True, kw_only=True):
    """The feedback of a goal, published for everybody; F is the action's own feedback type."""

    goal_id: Name
    action: Name
    code: int
    feedback: F


class Cancel(Payload, frozen=True, kw_only=True):
    goal_id: Name


class CancelReply(Payload, frozen=True, kw_only=True):
    """canceled: the goal was running and is being ended; its own query gets the result."""

    canceled: bool
    reason: Text = ""


class GetResult(Payload, frozen=True, kw_only=True):
    """Ask all action servers for the result of a goal; only the one that knows it answers."""

    goal_id: Name


class ResultReply(Payload, frozen=True, kw_only=True):
    """`result` is None while the goal still runs; else the JSON of the goal's `Result`."""

    goal_id: Name
    action: Name
    running: bool
    result: Annotated[str, Meta(max_length=4_000_000)] | None = None
