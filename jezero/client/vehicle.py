"""The vehicle: its connection, requests, state and goals, with units in the names of the arguments."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar, cast, overload

from jezero.base.vehicle_name import checked_vehicle
from jezero.client import control
from jezero.client.actions import Actions
from jezero.client.camera import Camera
from jezero.client.errors import Unreachable
from jezero.client.goal import Goal, request_result
from jezero.client.goal_sender import GoalSender, OnClientLoss, action_named
from jezero.client.images import ImagesGoal
from jezero.client.mission import Missions
from jezero.client.rover import Rover
from jezero.client.session import Connection
from jezero.client.simulator import SimulatedWorld
from jezero.client.status import REPLY_TIMEOUT_S, check_preflight, request_status, wait_ready, watch_status
from jezero.client.subscription import LatestValues, Subscription, call_for_each, topic_named
from jezero.client.velocity import VelocityGoal
from jezero.keys.bundle import INSECURE_VARIABLE, VARIABLE, endpoint_of
from jezero.keys.members import KeysError
from jezero.schemas import topics
from jezero.schemas.actions import PlanReply, ResultReply
from jezero.schemas.commands import AbortReply
from jezero.schemas.estimate import Lease, Relative, SetParameters
from jezero.schemas.fence import Fence, FenceState
from jezero.schemas.goals import (
    AreaCoverageGoal,
    FlyVelocityGoal,
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
from jezero.schemas.preflight import Override, PreflightReport
from jezero.schemas.rows import Action, Topic
from jezero.schemas.state import Battery, Odometry, Status
from jezero.schemas.struct import Message
from jezero.schemas.terrain import GetGround, Ground

DEFAULT_VEHICLE, DEFAULT_ROUTER = "uav1", "tcp/127.0.0.1:7447"
Point = tuple[float, float, float]
Corners = Sequence[tuple[float, float]]
M = TypeVar("M", bound=Message)


class Vehicle:
    """A connection to one vehicle.

    Points are (3,) metres north, east and down: 4 m up is z = -4. The frame "world" has its origin where the vehicle
    started; "rover" has it at the centre of the rover's platform, with axes north, east and down too.

    A method that sends a goal returns it when it is accepted. Such a method raises `Refused` if the vehicle may not
    start the goal now, `Unreachable` if no action server replies, `TimedOut` if the reply is missing, and `ValueError`
    if a number is NaN or infinite. With `on_client_loss="cancel"` the goal ends when this client disappears.

    Threads may share a vehicle: each method may be called from any of them at any time, also `close`, which ends the
    waits of all others with `Unreachable`. A goal and a subscription are for one thread each.

    ```python
    with Vehicle.connect("uav1") as uav:
        uav.takeoff(altitude_m=2.0).result()
        goal = uav.go_to(-1.0, -2.0, -3.0)
        for feedback in goal.feedback():
            print(feedback.distance_m)
        goal.result()
        uav.land_on_spot().result()  # on the rover
    ```

    Attributes:
        actions: the actions of the stack, and the goal that is flown, whichever client sent it.
        rover: the rover, with methods that drive it.
        camera: the camera, with methods that return or save its images.
        mission: the mission service, which flies a list of goals also when this client is gone.
        simulator: the simulated world, where there is one, with methods that change it.
    """

    def __init__(self, connection: Connection) -> None:
        self.actions = Actions(connection)
        self.rover = Rover(connection)
        self.camera = Camera(connection)
        self.mission = Missions(connection)
        self.simulator = SimulatedWorld(connection)
        self._connection = connection
        self._goals = GoalSender(connection)
        self._latest = LatestValues(connection)

    @classmethod
    def connect(
        cls,
        vehicle: str | None = None,
        *,
        router: str | None = None,
        keys: str | Path | None = None,
        insecure: bool = False,
        timeout_s: float = 3.0,
    ) -> Self:
        """Connect to a vehicle. Close the connection afterwards, or use it in a `with` statement.

        Args:
            vehicle: name of the vehicle; None takes it from the environment variable JEZERO_VEHICLE, else `uav1`.
            router: Zenoh endpoint of the vehicle's router; None takes it from JEZERO_ROUTER, else
                `tcp/127.0.0.1:7447`.
            keys: folder of the bundle of `jezero keys`, for a router at an address with `tls`; None takes it from
                JEZERO_KEYS.
            insecure: permits a router on another computer without TLS; so does JEZERO_INSECURE=1.
            timeout_s: longest wait for the router.

        Raises:
            Unreachable: no router replies within `timeout_s`, the bundle is missing or refused, or TLS is missing.
            ValueError: the vehicle's name or the router's address can't be one.
        """
        if vehicle is None:
            vehicle = os.environ.get("JEZERO_VEHICLE") or DEFAULT_VEHICLE
        vehicle = checked_vehicle(vehicle)
        router = router or os.environ.get("JEZERO_ROUTER") or DEFAULT_ROUTER
        insecure = insecure or os.environ.get(INSECURE_VARIABLE) == "1"
        try:
            endpoint = endpoint_of(router, keys or os.environ.get(VARIABLE), insecure=insecure)
        except KeysError as error:
            raise Unreachable(str(error)) from None
        return cls(Connection(vehicle, endpoint, timeout_s))

    @property
    def client_id(self) -> str:
        """Id of this client; the ids of its goals begin with it."""
        return self._connection.client_id

    def close(self) -> None:
        """Close the connection. Running goals continue unless they were sent with `on_client_loss="cancel"`."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    # -- requests: each raises Unreachable or TimedOut without a reply --

    def preflight(self) -> PreflightReport:
        """Check services, sensors, fence, battery and storage, which takes a second and a half.

        ```python
        for check in uav.preflight().failed():
            print(check.name, check.text)
        ```
        """
        return check_preflight(self._connection)

    def hover(self, pos_ned_m: Point | None = None) -> None:
        """Hover here, which ends the goal in charge; or hover at a point, only while hovering already.

        Args:
            pos_ned_m: (3,) point in the world frame; None for the present position.

        Raises:
            Refused: the vehicle cannot hover now; the text is the reason.
            ValueError: a coordinate is NaN or infinite.
        """
        control.hover(self._connection, pos_ned_m)

    def fence(self) -> FenceState:
        """The fence in force, and whether the vehicle is outside."""
        return control.request_fence(self._connection)

    def set_fence(self, fence: Fence | None) -> None:
        """Set the fence, on the ground only; None takes it away. `jezero.mission_files.read_fence` reads one.

        Raises:
            Refused: the vehicle is armed.
            ValueError: it is no fence, such as the name of a file.
        """
        control.set_fence(self._connection, fence)

    def estimator_parameters(self) -> SetParameters:
        """The estimator's parameters."""
        return control.estimator_parameters(self._connection)

    def estimator_lease(self) -> Lease | None:
        """The inputs of the estimator that a goal has selected for itself; None while no goal has."""
        return control.estimator_lease(self._connection)

    def set_estimator_parameters(self, /, **fields: Any) -> SetParameters:
        """Change parameters of the estimator until it starts anew: `uav.set_estimator_parameters(std_uwb_m=0.2)`.

        Args:
            fields: new values by name, see `SetParameters`; all others stay.

        Returns:
            All parameters after the change.

        Raises:
            Refused: a value is out of range, and nothing was changed; the text is the reason.
            ValueError: there is no such parameter, or its value has another type.
        """
        return control.set_estimator_parameters(self._connection, fields)

    def abort(self, reason: str = "") -> AbortReply:
        """End the goal in charge at once, also another client's: hover, or disarm if still on the ground."""
        return control.abort(self._connection, reason)

    def pause(self) -> str:
        """Pause the goal in charge, also another client's; returns its id when the vehicle hovers.

        Raises:
            Refused: no goal is in charge, or it can't be paused now; the text is the reason.
        """
        return control.pause(self._connection)

    def resume(self) -> str:
        """Go on with the paused goal in charge, as `Goal.resume` does; returns its id.

        Raises:
            Refused: no goal is in charge, or it is not paused; the text is the reason.
        """
        return control.resume(self._connection)

    def modify(self, /, **fields: Any) -> tuple[str, str]:
        """Change fields of the goal in charge, as `Goal.modify` does; returns its id and a warning.

        Raises:
            Refused: no goal is in charge, or it goes on with the old values; the text is the reason.
            ValueError: a value is NaN or infinite.
        """
        return control.modify(self._connection, fields)

    def ground(self) -> Ground:
        """The ground of the simulator, to draw it: a real vehicle has none, and nothing that flies may use it.

        Raises:
            Unreachable: there is no simulator.
        """
        reply: Ground = self._connection.request(topics.GROUND, GetGround(), REPLY_TIMEOUT_S)
        return reply

    def kill(self, *, confirm: bool = False, vehicle: str = "") -> None:
        """Stop the motors at once, also in the air: a flying vehicle falls.

        Args:
            confirm: must be True.
            vehicle: name of the vehicle, such as "uav1"; in the air it must be given.

        Raises:
            Refused: not confirmed, in the air not by name, or the autopilot did not disarm.
        """
        control.kill(self._connection, confirm=confirm, vehicle=vehicle)

    # -- state --

    def status(self) -> Status:
        """The vehicle's last status; `schemas/state.py` describes its fields.

        Raises:
            Unreachable: no vehicle bridge replies.
            TimedOut: the reply is missing.
        """
        return request_status(self._connection)

    def watch_status(self) -> Iterator[Status]:
        """Yield the last status, then every changed one.

        Raises:
            Unreachable: no status came for 3 s.
            TimedOut: the reply to the first request is missing.
        """
        return watch_status(self._connection)

    def wait_ready(self, timeout_s: float = 30.0) -> Status:
        """Wait until the vehicle is ready for a takeoff or flies already.

        Raises:
            TimedOut: it is not ready in time; the text is the reason.
        """
        return wait_ready(self._connection, timeout_s)

    def odometry(self, timeout_s: float = 1.0) -> Odometry:
        """The newest position, velocity and attitude; raises the errors of `latest`."""
        return self.latest(topics.ODOMETRY, timeout_s)

    def relative(self, timeout_s: float = 1.0) -> Relative:
        """The newest estimate of the vehicle's state relative to the rover; raises the errors of `latest`.

        Use it only if its field `valid` is true; `reason` says why it isn't.
        """
        return self.latest(topics.RELATIVE, timeout_s)

    def battery(self, timeout_s: float = 1.0) -> Battery | None:
        """The newest state of the battery, None when it isn't measured; raises the errors of `latest`."""
        return self.latest(topics.STATUS, timeout_s).battery

    @overload
    def latest(self, topic: Topic[M], timeout_s: float = 1.0) -> M: ...

    @overload
    def latest(self, topic: str, timeout_s: float = 1.0) -> Any: ...

    def latest(self, topic: str | Topic[Any], timeout_s: float = 1.0) -> Any:
        """The newest message of any topic, at most a second old: `uav.latest(topics.IMU)`, `uav.latest("sensor/imu")`.

        The first call subscribes and waits for a message; later ones return at once.

        Args:
            topic: name or row of the topic table, `jezero.schemas.topics`.
            timeout_s: longest wait.

        Raises:
            TimedOut: no message came in time.
            Unreachable: the connection was closed.
            ValueError: there is no such topic.
        """
        return self._latest.get(topic_named(topic), timeout_s)

    @overload
    def subscribe(self, topic: Topic[M], callback: Callable[[M], object] | None = None) -> Subscription[M]: ...

    @overload
    def subscribe(self, topic: str, callback: Callable[[Any], object] | None = None) -> Subscription[Any]: ...

    def subscribe(self, topic: str | Topic[Any], callback: Callable[[Any], object] | None = None) -> Subscription[Any]:
        """Subscribe to a topic: its messages, to iterate over; or a function that is called with each.

        ```python
        with uav.subscribe(topics.ODOMETRY) as stream:
            for odometry in stream:
                ...

        subscription = uav.subscribe(topics.UWB, print)
        subscription.close()
        ```

        Args:
            topic: name or row of the topic table, `jezero.schemas.topics`.
            callback: function of one message. It is called in a thread of its own until the subscription is closed.
                When it raises, the traceback is printed and the subscription ends.

        Raises:
            ValueError: there is no such topic.
            Unreachable: the connection was closed.
        """
        subscription: Subscription[Any] = Subscription(self._connection, topic_named(topic))
        if callback is not None:
            call_for_each(subscription, callback)
        return subscription

    def result_of(self, goal_id: str) -> ResultReply | None:
        """State or result of any goal, also of another client's; None if no action server knows it."""
        return request_result(self._connection, goal_id)

    @contextmanager
    def flight(self, altitude_m: float = 2.0) -> Iterator[Self]:
        """Take off, and land at the vehicle's position at the end of a `with` block, also after an exception.

        It does not land if a pilot or a failsafe has taken over.

        Raises:
            Refused, Aborted, Canceled, Unreachable, TimedOut: the takeoff, the hover or the landing failed.
        """
        self.takeoff(altitude_m).result()
        try:
            yield self
        finally:
            control.land_here(self._connection, self._goals)

    # -- goals --

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

    def fly_velocity(
        self, *, speed_max_mps: float | None = None, on_client_loss: OnClientLoss = "cancel"
    ) -> VelocityGoal:
        """Fly by velocity: the goal returned sends the commands, and ends at the end of a `with` block.

        ```python
        with uav.fly_velocity() as stick:
            stick.send(forward_mps=1.0, yaw_rate_rps=0.2, for_s=5.0)
        ```

        Args:
            speed_max_mps: greatest horizontal speed; None for the default.
        """
        goal = FlyVelocityGoal(speed_max_mps=speed_max_mps, on_client_loss=on_client_loss)
        return cast(VelocityGoal, self._goals.send(topics.FLY_VELOCITY, goal))

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
