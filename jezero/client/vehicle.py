"""A vehicle as its user sees it: verbs, units in their arguments, and named errors."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Any, Literal, Self

import msgspec

from jezero.client.camera import next_picture
from jezero.client.errors import Refused, TimedOut, Unreachable
from jezero.client.goal import Goal, ask_result
from jezero.client.images import ImagesGoal
from jezero.client.rover import Rover
from jezero.client.session import Connection, decode
from jezero.plugins import PluginError, find_action
from jezero.schemas.actions import (
    AreaCoverageGoal,
    Corners,
    Frame,
    GetImagesGoal,
    GoToGoal,
    LandFeedback,
    LandOnSpotGoal,
    LandResult,
    MoveFeedback,
    MoveResult,
    ResultReply,
    TakeoffGoal,
)
from jezero.schemas.actions import (
    Goal as GoalPayload,
)
from jezero.schemas.commands import Abort, AbortReply, Hover, HoverReply, Kill, KillReply
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.topics import (
    ABORT,
    AREA_COVERAGE,
    GET_IMAGES,
    GO_TO,
    HOVER,
    KILL,
    LAND_ON_SPOT,
    STATUS,
    TAKEOFF,
    Action,
)

DEFAULT_ROUTER = "tcp/127.0.0.1:7447"
Point = tuple[float, float, float]
OnClientLoss = Literal["continue", "cancel"]
ANSWER_S = 3.0
PLANNED_S = 30.0
"""For the answer to a goal that is planned before it is accepted."""
HOVER_S = 10.0
"""Ending a goal near the ground climbs first, and taking control back takes its time."""
DISARM_S = 15.0
SILENCE_S = 3.0


class Vehicle:
    """A connection to one vehicle. Points are metres north, east and down: 4 m up is z = -4.

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
        rover: to drive it.
    """

    def __init__(self, connection: Connection) -> None:
        self.rover = Rover(connection)
        self._connection = connection
        self._goals_sent = 0

    @classmethod
    def connect(cls, vehicle: str = "uav1", *, router: str = DEFAULT_ROUTER, timeout_s: float = 3.0) -> Self:
        """Connect to a vehicle's router; close it again, or use it in a `with` statement.

        Raises:
            Unreachable: there is no router within `timeout_s`.
        """
        return cls(Connection(vehicle, router, timeout_s))

    def close(self) -> None:
        """Leave the bus. Running goals go on, unless they were sent with `on_client_loss="cancel"`."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    # -- goals: each returns when it is accepted, and raises Refused, Unreachable or TimedOut --

    def takeoff(
        self, altitude_m: float = 2.0, *, on_client_loss: OnClientLoss = "continue"
    ) -> Goal[MoveFeedback, MoveResult]:
        """Take off to `altitude_m` above the take-off point, positive up."""
        _require_finite(altitude_m=altitude_m)
        goal = TakeoffGoal(**self._common(on_client_loss), altitude_m=altitude_m)
        return self._send(TAKEOFF, goal)

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
        on_client_loss: OnClientLoss = "continue",
    ) -> Goal[MoveFeedback, MoveResult]:
        """Fly to a point in a straight line.

        Args:
            x_m, y_m, z_m: metres north, east and down.
            do_takeoff: take off first when on the ground.
            yaw_rad: heading at the target, zero at north and positive towards east; None keeps it.
            speed_mps: along the line, None for the default.
        """
        _require_finite(x_m=x_m, y_m=y_m, z_m=z_m, yaw_rad=yaw_rad, speed_mps=speed_mps)
        goal = GoToGoal(
            **self._common(on_client_loss),
            target_ned_m=(x_m, y_m, z_m),
            frame=frame,
            do_takeoff=do_takeoff,
            yaw_rad=yaw_rad,
            speed_mps=speed_mps,
        )
        return self._send(GO_TO, goal)

    def land_on_spot(
        self,
        spot_ned_m: Point | None = None,
        *,
        frame: Frame = "world",
        use_uwb: bool = True,
        use_tag: bool = True,
        on_client_loss: OnClientLoss = "continue",
    ) -> Goal[LandFeedback, LandResult]:
        """Land on the rover.

        Args:
            spot_ned_m: without UWB: roughly where the rover is, or without either sensor where to land.
            use_uwb, use_tag: what finds the rover.
        """
        if spot_ned_m is not None:
            _require_finite(x_m=spot_ned_m[0], y_m=spot_ned_m[1], z_m=spot_ned_m[2])
        goal = LandOnSpotGoal(
            **self._common(on_client_loss),
            landing_spot_ned_m=spot_ned_m,
            frame=frame,
            use_uwb=use_uwb,
            use_tag=use_tag,
        )
        return self._send(LAND_ON_SPOT, goal)

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
        """Photograph a target from all sides, on a circle around it.

        Args:
            center_ned_m: of the circle; its z is the height of the flight.
            num_images: 1 to 255, spread evenly.
            target_z_ned_m: what the camera looks at, straight below the centre.
            speed_mps: along the circle, None for the default.
            stream_images: pictures come as they are taken, else all after the last one.
        """
        north_m, east_m, down_m = center_ned_m
        _require_finite(x_m=north_m, y_m=east_m, z_m=down_m, radius_m=radius_m)
        _require_finite(target_z_ned_m=target_z_ned_m, speed_mps=speed_mps)
        goal = GetImagesGoal(
            **self._common(on_client_loss),
            center_ned_m=center_ned_m,
            radius_m=radius_m,
            num_images=num_images,
            frame=frame,
            target_z_ned_m=target_z_ned_m,
            speed_mps=speed_mps,
            stream_images=stream_images,
        )
        return ImagesGoal(self._connection, GET_IMAGES, goal, ANSWER_S)

    def area_coverage(
        self,
        polygon_ned_m: Corners,
        z_ned_m: float,
        *,
        holes_ned_m: tuple[Corners, ...] = (),
        resolution_m: float | None = None,
        overlap: float | None = None,
        sidelap: float | None = None,
        frame: Frame = "world",
        speed_mps: float | None = None,
        start_ned_m: tuple[float, float] | None = None,
        on_client_loss: OnClientLoss = "continue",
    ) -> ImagesGoal:
        """Map an area: sweep it in lines, taking pictures.

        Args:
            polygon_ned_m, holes_ned_m: north and east of the corners, in order.
            z_ned_m: height of the flight; 5 m up is -5.
            resolution_m: between lines and between pictures; or `overlap` (and `sidelap`) of the pictures.
            speed_mps: along the lines, None for the default.
            start_ned_m: the path begins near it, None for the vehicle.
        """
        _require_finite(z_m=z_ned_m, resolution_m=resolution_m, overlap=overlap, sidelap=sidelap, speed_mps=speed_mps)
        goal = AreaCoverageGoal(
            **self._common(on_client_loss),
            polygon_ned_m=polygon_ned_m,
            holes_ned_m=holes_ned_m,
            z_ned_m=z_ned_m,
            resolution_m=resolution_m,
            overlap=overlap,
            sidelap=sidelap,
            frame=frame,
            speed_mps=speed_mps,
            start_ned_m=start_ned_m,
        )
        return ImagesGoal(self._connection, AREA_COVERAGE, goal, PLANNED_S)

    def resume_coverage(self, goal: AreaCoverageGoal) -> ImagesGoal:
        """Take the missing pictures of a coverage that ended early.

        Args:
            goal: `resume` of its result.
        """
        fresh = msgspec.structs.replace(goal, **self._common(goal.on_client_loss))
        return ImagesGoal(self._connection, AREA_COVERAGE, fresh, PLANNED_S)

    def send(self, action: str | Action[Any], goal: GoalPayload | None = None, **fields: Any) -> Goal[Any, Any]:
        """Send a goal to any action, also to one that an installed package adds.

        Args:
            action: the action's name, or its row of the topic table.
            goal: a struct of the action's goal type; or its fields as keyword arguments, checked against that type.

        Raises:
            ValueError: there is no such action, or the goal doesn't fit its type; the message names the field.
        """
        return Goal(self._connection, *self._checked(action, goal, fields), ANSWER_S)

    # -- services --

    def hover(self, pos_ned_m: Point | None = None) -> None:
        """Hover here, which ends a goal in charge; or at a point, only while hovering already.

        Raises:
            Refused: not possible now.
        """
        if pos_ned_m is not None:
            _require_finite(x_m=pos_ned_m[0], y_m=pos_ned_m[1], z_m=pos_ned_m[2])
        reply: HoverReply = self._connection.ask(HOVER, Hover(hover_pos=pos_ned_m), HOVER_S)
        if not reply.hover_mode:
            raise Refused(reply.reason)

    def abort(self, reason: str = "") -> AbortReply:
        """End the goal in charge at once, whoever sent it: hover, or disarm when still on the ground."""
        reply: AbortReply = self._connection.ask(ABORT, Abort(reason=reason), ANSWER_S)
        return reply

    def kill(self, *, confirm: bool = False) -> None:
        """Cut the motors at once, in the air too. Only with `confirm=True`.

        Raises:
            Refused: not confirmed, or the autopilot didn't obey.
        """
        reply: KillReply = self._connection.ask(KILL, Kill(confirm=confirm), DISARM_S)
        if not reply.killed:
            raise Refused(reply.reason)

    # -- what is known --

    def status(self) -> Status:
        """The vehicle's last status.

        Raises:
            Unreachable: nobody knows it.
        """
        arrivals = self._connection.stream(STATUS.name, b"", ANSWER_S)
        status: Status = decode(Status, self._connection.first(arrivals, STATUS.name, ANSWER_S))
        self._connection.tell_time(status.t_ns)
        return status

    def picture(self, timeout_s: float = 3.0) -> CameraFrame:
        """The next picture of the camera.

        Raises:
            Unreachable: none comes in time.
        """
        return next_picture(self._connection, timeout_s)

    def watch_status(self) -> Iterator[Status]:
        """The present status and every one from now on.

        Raises:
            Unreachable: none came for 3 s.
        """
        arrivals, undeclare = self._connection.subscribe(STATUS)
        try:
            status = self.status()
            yield status
            while True:
                try:
                    data = arrivals.take(time.monotonic() + SILENCE_S)
                except TimedOut:
                    data = None
                if data is None:
                    raise Unreachable(f"no status of {self._connection.vehicle} for {SILENCE_S:g} s")
                newer: Status = decode(Status, data)
                if newer != status:
                    status = newer
                    yield status
        finally:
            undeclare()

    def wait_ready(self, timeout_s: float = 30.0) -> Status:
        """Wait until a takeoff would be accepted, or the vehicle flies.

        Raises:
            TimedOut: it isn't ready in time; the text says what is missing.
        """
        deadline_s = time.monotonic() + timeout_s
        missing = "nobody publishes its status"
        while True:
            try:
                for status in self.watch_status():
                    if status.ready:
                        return status
                    missing = status.not_ready_reason or f"its status is {status.name}"
                    if time.monotonic() > deadline_s:
                        break
            except (Unreachable, TimedOut) as error:
                missing = str(error)
                time.sleep(min(0.1, max(deadline_s - time.monotonic(), 0.0)))
            if time.monotonic() > deadline_s:
                raise TimedOut(f"{self._connection.vehicle} is not ready after {timeout_s:g} s: {missing}")

    def result_of(self, goal_id: str) -> ResultReply | None:
        """What the action servers know of a goal, also of one sent by a client that is gone; None: nothing."""
        return ask_result(self._connection, goal_id)

    @contextmanager
    def flight(self, altitude_m: float = 2.0) -> Iterator[Self]:
        """Take off, and land at the end of the block wherever the vehicle then is.

        An exception in the block lands it too. It isn't landed when a pilot or a failsafe has taken over.
        """
        self.takeoff(altitude_m).result()
        try:
            yield self
        finally:
            self._land_here()

    # -- inside --

    def _land_here(self) -> None:
        status = self.status()
        if status.code in (StatusCode.IDLE, StatusCode.EXTERNAL):
            return
        if status.code != StatusCode.HOVER:
            self.hover()
            status = self.status()
        spot_ned_m = None if status.odometry is None else status.odometry.pos_uav_ned_m
        self.land_on_spot(spot_ned_m, use_uwb=False, use_tag=False).result()

    def _checked(
        self, action: str | Action[Any], goal: GoalPayload | None, fields: dict[str, Any]
    ) -> tuple[Action[Any], GoalPayload]:
        try:
            row = find_action(action) if isinstance(action, str) else action
        except PluginError as error:
            raise ValueError(str(error)) from error
        if goal is not None:
            if fields or not isinstance(goal, row.goal_type):
                raise ValueError(f"{row.name} takes one {row.goal_type.__name__}, or its fields as keyword arguments")
            return row, msgspec.structs.replace(goal, **self._common(goal.on_client_loss))
        common = self._common(fields.get("on_client_loss", "continue"))
        try:
            return row, msgspec.convert({**fields, **common}, row.goal_type)
        except msgspec.ValidationError as error:
            raise ValueError(f"{row.name}: {error}") from None

    def _send(self, action: Action[Any], goal: GoalPayload) -> Goal[Any, Any]:
        return Goal(self._connection, action, goal, ANSWER_S)

    def _common(self, on_client_loss: OnClientLoss) -> dict[str, Any]:
        """The fields that every goal carries: a fresh id, and the vehicle time of now so that it can expire.

        That time is asked for only where no status, feedback or result has just told it.
        """
        self._goals_sent += 1
        issued_t_ns = self._connection.vehicle_time_ns()
        if issued_t_ns is None:
            with suppress(Unreachable, TimedOut):
                issued_t_ns = self.status().t_ns
        return {
            "goal_id": f"{self._connection.client_id}-{self._goals_sent}",
            "issued_t_ns": issued_t_ns,
            "on_client_loss": on_client_loss,
        }


def _require_finite(**numbers: float | None) -> None:
    """Raises ValueError, naming the first that is NaN or infinite: JSON can't carry it."""
    for name, number in numbers.items():
        if number is not None and not math.isfinite(number):
            raise ValueError(f"{name} is {number}")
