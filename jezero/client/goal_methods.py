"""The methods of a vehicle that send goals, with units in the names of their arguments."""

from collections.abc import Sequence
from typing import Any

from jezero.client.goal import Goal
from jezero.client.goal_sender import GoalSender, OnClientLoss, action_named
from jezero.client.images import ImagesGoal
from jezero.schemas import topics
from jezero.schemas.actions import PlanReply
from jezero.schemas.goals import (
    AreaCoverageGoal,
    Frame,
    GetImagesGoal,
    GoToGoal,
    LandFeedback,
    LandOnSpotGoal,
    LandResult,
    MoveFeedback,
    MoveResult,
    ReturnFeedback,
    ReturnHomeGoal,
    ReturnResult,
    TakeoffGoal,
)
from jezero.schemas.goals import Goal as GoalPayload
from jezero.schemas.preflight import Override
from jezero.schemas.rows import Action

Point = tuple[float, float, float]
Corners = Sequence[tuple[float, float]]


class GoalMethods:
    """The part of `jezero.Vehicle` that sends goals; the class `Vehicle` describes frames and errors."""

    def __init__(self, goals: GoalSender) -> None:
        self._goals = goals

    def takeoff(
        self,
        altitude_m: float = 2.0,
        *,
        override: Sequence[Override] = (),
        on_client_loss: OnClientLoss = "continue",
    ) -> Goal[MoveFeedback, MoveResult]:
        """Take off.

        Args:
            altitude_m: altitude above the take-off point, positive up.
            override: names of failed preflight checks in spite of which the vehicle takes off; see `preflight`.
        """
        goal = TakeoffGoal(altitude_m=altitude_m, override=tuple(override), on_client_loss=on_client_loss)
        return self._goals.send(topics.TAKEOFF, goal)

    def go_to(
        self,
        x_m: float,
        y_m: float,
        z_m: float,
        *,
        frame: Frame = "world",
        do_takeoff: bool = False,
        yaw_rad: float | None = None,
        speed_mps: float | None = None,
        override: Sequence[Override] = (),
        on_client_loss: OnClientLoss = "continue",
    ) -> Goal[MoveFeedback, MoveResult]:
        """Fly to a point in a straight line.

        Args:
            x_m: metres north.
            y_m: metres east.
            z_m: metres down.
            frame: frame of the point.
            do_takeoff: take off first if the vehicle is on the ground.
            yaw_rad: heading at the target, zero at north and positive towards east; None keeps the heading.
            speed_mps: speed along the line; None for the default.
            override: as in `takeoff`.
        """
        goal = GoToGoal(
            target_ned_m=(x_m, y_m, z_m),
            frame=frame,
            do_takeoff=do_takeoff,
            yaw_rad=yaw_rad,
            speed_mps=speed_mps,
            override=tuple(override),
            on_client_loss=on_client_loss,
        )
        return self._goals.send(topics.GO_TO, goal)

    def land_on_spot(
        self,
        spot_ned_m: Point | None = None,
        *,
        frame: Frame = "world",
        use_uwb: bool = True,
        use_tag: bool = True,
        force: bool = False,
        on_client_loss: OnClientLoss = "continue",
    ) -> Goal[LandFeedback, LandResult]:
        """Land on the rover, or on a spot on the ground if it uses neither UWB nor the tags.

        Args:
            spot_ned_m: (3,) with the tags alone: approximate position of the rover; with neither sensor: landing spot.
            frame: frame of the spot.
            use_uwb: use the UWB ranges to the rover.
            use_tag: use the AprilTags on the platform.
            force: land in more wind than the settings allow, too.
        """
        goal = LandOnSpotGoal(
            landing_spot_ned_m=spot_ned_m,
            frame=frame,
            use_uwb=use_uwb,
            use_tag=use_tag,
            force=force,
            on_client_loss=on_client_loss,
        )
        return self._goals.send(topics.LAND_ON_SPOT, goal)

    def return_home(
        self,
        *,
        safe_height_m: float | None = None,
        speed_mps: float | None = None,
        rally_points_ned_m: Sequence[tuple[float, float]] = (),
        on_client_loss: OnClientLoss = "continue",
    ) -> Goal[ReturnFeedback, ReturnResult]:
        """Fly home and land: on the rover if it is known, else where the vehicle took off, else at a rally point.

        Args:
            safe_height_m: height above the world's origin to which the vehicle climbs first; None for the default.
            speed_mps: speed on the way; None for the default.
            rally_points_ned_m: (n, 2) places on the ground where the vehicle may land, besides those of the settings.
        """
        goal = ReturnHomeGoal(
            safe_height_m=safe_height_m, speed_mps=speed_mps, on_client_loss=on_client_loss,
            rally_points_ned_m=tuple(rally_points_ned_m),
        )  # fmt: skip
        return self._goals.send(topics.RETURN_HOME, goal)

    def get_images(
        self,
        center_ned_m: Point,
        radius_m: float,
        num_images: int,
        *,
        frame: Frame = "world",
        target_z_ned_m: float = 0.0,
        speed_mps: float | None = None,
        stream_images: bool = True,
        on_client_loss: OnClientLoss = "continue",
    ) -> ImagesGoal:
        """Take images of a target from all sides, on a circle around it.

        Args:
            center_ned_m: (3,) centre of the circle; its z is the flight's altitude.
            radius_m: radius of the circle.
            num_images: number of images, 1 to 255, spread evenly.
            frame: frame of the centre and of the target.
            target_z_ned_m: z of the point, on the vertical line through the centre, at which the camera points.
            speed_mps: speed along the circle; None for the default.
            stream_images: whether the feedback announces each image as it is taken; else only the result lists them.
        """
        goal = GetImagesGoal(
            center_ned_m=center_ned_m,
            radius_m=radius_m,
            num_images=num_images,
            frame=frame,
            target_z_ned_m=target_z_ned_m,
            speed_mps=speed_mps,
            stream_images=stream_images,
            on_client_loss=on_client_loss,
        )
        return self._goals.send_for_images(topics.GET_IMAGES, goal)

    def area_coverage(
        self,
        polygon_ned_m: Corners,
        z_ned_m: float,
        *,
        holes_ned_m: Sequence[Corners] = (),
        origin_deg: tuple[float, float] | None = None,
        margin_outline_m: float = 0.0,
        margin_holes_m: float = 1.0,
        resolution_m: float | None = None,
        overlap: float | None = None,
        sidelap: float | None = None,
        frame: Frame = "world",
        speed_mps: float | None = None,
        start_ned_m: tuple[float, float] | None = None,
        plan_id: str = "",
        force: bool = False,
        angle_rad: float | None = None,
        picture_distance_m: float | None = None,
        on_client_loss: OnClientLoss = "continue",
    ) -> ImagesGoal:
        """Cover an area in parallel lines and take images of all of it.

        Give `resolution_m`, or `overlap` (and `sidelap`).

        Args:
            polygon_ned_m: (n, 2) corners of the area, north and east, in order.
            z_ned_m: altitude of the flight, NED; 5 m up is -5.
            holes_ned_m: polygons (n, 2) that are left out.
            origin_deg: latitude and longitude of the world's origin that placed an area in degrees, such as
                `Area.origin_deg`. With it, refusals and warnings name places in degrees too.
            margin_outline_m: least distance of the vehicle from the outline, inside it.
            margin_holes_m: least distance of the vehicle from each hole.
            resolution_m: distance between lines, and between images unless `picture_distance_m` is given.
            overlap: share of each image that the next one repeats, 0 to 0.95.
            sidelap: share of each image that the images of the next line repeat, 0 to 0.95; None is `overlap`.
            frame: frame of all points.
            speed_mps: speed along the lines; None for the default.
            start_ned_m: (2,) the path starts near this point; None for the vehicle's position.
            plan_id: id of the plan to fly, from `uav.plan("area_coverage", ...).coverage`; "" for a new plan.
            force: fly also if less than 90 % of the area would be in the images, or too high for a map.
            angle_rad: direction of the lines, clockwise from north; None for the shortest path.
            picture_distance_m: distance between two images on a line; None for that of `resolution_m` or `overlap`.
        """
        goal = AreaCoverageGoal(
            polygon_ned_m=tuple(polygon_ned_m), holes_ned_m=tuple(tuple(hole) for hole in holes_ned_m),
            origin_deg=origin_deg, margin_outline_m=margin_outline_m, margin_holes_m=margin_holes_m, z_ned_m=z_ned_m,
            resolution_m=resolution_m, overlap=overlap, sidelap=sidelap, frame=frame, speed_mps=speed_mps,
            start_ned_m=start_ned_m, on_client_loss=on_client_loss, plan_id=plan_id, force=force, angle_rad=angle_rad,
            picture_distance_m=picture_distance_m,
        )  # fmt: skip
        return self._goals.send_for_images(topics.AREA_COVERAGE, goal)

    def resume_coverage(self, goal: AreaCoverageGoal) -> ImagesGoal:
        """Take the missing images of a coverage that ended early.

        Args:
            goal: field `resume` of that coverage's result.
        """
        return self._goals.send_for_images(topics.AREA_COVERAGE, goal)

    def send(self, action: str | Action[Any], goal: GoalPayload | None = None, **fields: Any) -> Goal[Any, Any]:
        """Send a goal to any action, also to one that an installed package adds.

        Args:
            action: the action's name, or its row of the topic table.
            goal: a struct of the action's goal type; or its fields as keyword arguments, checked against that type.

        Raises:
            ValueError: there is no such action, or the goal doesn't fit its type; the message names the field.
        """
        return self._goals.send(action_named(action), goal, fields)

    def plan(self, action: str | Action[Any], goal: GoalPayload | None = None, **fields: Any) -> PlanReply:
        """How long a goal would fly, how far, and how much battery it would use; it is not flown.

        ```python
        plan = uav.plan("get_images", center_ned_m=(0.0, 0.0, -10.0), radius_m=50.0, num_images=12)
        print(plan.duration_s, plan.distance_m, plan.battery_used)
        ```

        Args:
            action: as in `send`.
            goal: as in `send`.

        Raises:
            Refused: the vehicle would refuse the goal now.
            ValueError: there is no such action, or the goal doesn't fit its type; the message names the field.
            Unreachable: no action server replies.
            TimedOut: the reply is missing.
        """
        return self._goals.plan(action_named(action), goal, fields)
