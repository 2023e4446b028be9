"""Goals of jezero's actions, with their feedback and their results."""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.schemas.images import Image, Index
from jezero.schemas.preflight import Override
from jezero.schemas.struct import (
    END,
    Angle,
    Fraction,
    NonNegative,
    Payload,
    Position,
    PositionNed,
    RallyPoints,
    Text,
    TimeNs,
)

Frame = Literal["world", "rover"]
Overlap = Annotated[float, Meta(ge=0.0, le=0.95)]
OriginDegrees = tuple[Annotated[float, Meta(ge=-90.0, le=90.0)], Annotated[float, Meta(ge=-180.0, le=180.0)]]
PlanId = Annotated[str, Meta(max_length=64, pattern=rf"^[0-9a-z]*{END}")]


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

    goal_id: Annotated[str, Meta(max_length=64, pattern=rf"^[A-Za-z0-9_.-]*{END}")] = ""
    issued_t_ns: TimeNs | None = None
    on_client_loss: Literal["continue", "cancel"] = "continue"
    plan_from_ned_m: PositionNed | None = None


class TakeoffGoal(Goal, frozen=True, kw_only=True):
    """Climb straight up to an altitude.

    Attributes:
        altitude_m: target altitude above the take-off point, positive up.
        override: names of failed preflight checks in spite of which the vehicle takes off; it is logged.
    """

    altitude_m: float = 2.0
    override: tuple[Override, ...] = ()


class GoToGoal(Goal, frozen=True, kw_only=True):
    """Fly in a straight line to a point.

    Attributes:
        target_ned_m: target point in `frame`; a negative z is up.
        frame: frame of the target.
        do_takeoff: take off first if the vehicle is on the ground.
        yaw_rad: heading at the target, clockwise from north. None keeps the present heading.
        speed_mps: speed along the path. None means the default speed of the settings.
        override: names of failed preflight checks in spite of which it takes off; it is logged.
    """

    target_ned_m: PositionNed
    frame: Frame = "world"
    do_takeoff: bool = False
    yaw_rad: Angle | None = None
    speed_mps: float | None = None
    override: tuple[Override, ...] = ()


class FlyVelocityGoal(Goal, frozen=True, kw_only=True):
    """Fly by velocity commands: follow those that the goal's client publishes on `command/velocity`.

    The vehicle hovers while no command arrives for half a second, and the goal ends after a longer silence. It stops in
    front of the fence and above the ground.

    Attributes:
        speed_max_mps: greatest horizontal speed. None means that of the settings.
    """

    speed_max_mps: float | None = None


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


ReturnPhase = Literal["climb", "way", "landing"]
HomePlace = Literal["rover", "takeoff_point", "rally_point", "here"]


class ReturnHomeGoal(Goal, frozen=True, kw_only=True):
    """Fly home and land: on the rover by the best knowledge of it, else where the vehicle took off, else at a rally
    point, else here.

    Twice a second the vehicle decides again: it flies to the best place that it still reaches with the battery's
    reserve. A place at which the landing fails is followed by the next one. The wind does not keep the vehicle in the
    air.

    Attributes:
        safe_height_m: height above the world's origin to which the vehicle climbs first, unless it is higher or close
            to the place. None means that of the settings.
        speed_mps: speed on the way. None means that of the settings.
        charge: fraction of the battery's capacity that is left at most, for a gauge that reports too much. None means
            what the gauge reports.
        charge_per_s: fraction of the capacity that the flight has used per second. None means the declared use.
        rally_points_ned_m: north and east of places on the ground where the vehicle may land, besides those of the
            settings.
    """

    safe_height_m: NonNegative | None = None
    speed_mps: float | None = None
    charge: Fraction | None = None
    charge_per_s: NonNegative | None = None
    rally_points_ned_m: RallyPoints = ()


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
    level ground at z = 0. A goal with both is refused, and so is one with `overlap` and `picture_distance_m`.

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
        resolution_m: distance between two lines, and between two images on a line unless `picture_distance_m` is given.
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
        angle_rad: direction of the lines, clockwise from north: 0 is north and south, pi/2 east and west. The passes
            along the outline and through narrow parts follow the area's shape all the same. None takes the direction of
            the shortest path.
        picture_distance_m: distance between two images on a line. None follows from `resolution_m` or `overlap`.
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
    angle_rad: Angle | None = None
    picture_distance_m: Annotated[float, Meta(gt=0.0)] | None = None


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


class VelocityFeedback(Payload, frozen=True, kw_only=True, tag_field="kind", tag="velocity"):
    """Progress of a flight by velocity.

    Attributes:
        pos_uav_ned_m: position of the vehicle in world NED.
        follows: whether a command is followed; false while none arrives, and the vehicle hovers.
        limited_by: what keeps the vehicle from flying as commanded, such as the fence; "" for nothing.
        refused: why the newest command that was refused was so; "" when a newer one was followed.
    """

    pos_uav_ned_m: PositionNed
    follows: bool
    limited_by: Text = ""
    refused: Text = ""


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


class ReturnFeedback(Payload, frozen=True, kw_only=True, tag_field="kind", tag="return"):
    """Progress of a return.

    Attributes:
        pos_uav_ned_m: position of the vehicle in world NED.
        phase: `climb` to the safe height, `way` to above the place, then `landing`.
        place: place to which the vehicle returns.
        place_ned_m: position of this place in world NED.
        reason: why it is this place, for people.
        landing: progress of the landing; None before.
    """

    pos_uav_ned_m: PositionNed
    phase: ReturnPhase
    place: HomePlace
    place_ned_m: PositionNed
    reason: Text = ""
    landing: LandFeedback | None = None


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


class VelocityResult(Payload, frozen=True, kw_only=True):
    """End of a flight by velocity.

    Attributes:
        completed: true after a success.
        pos_uav_ned_m: final position of the vehicle in world NED.
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


class ReturnResult(LandResult, frozen=True, kw_only=True):
    """End of a return.

    Attributes:
        completed: true after a success.
        touchdown_ned_m: position of the touchdown in world NED, by the vehicle's own estimate. None without a
            touchdown.
        place: place on which the vehicle landed, or was about to land.
        reason: why it was this place, for people.
    """

    place: HomePlace
    reason: Text = ""
