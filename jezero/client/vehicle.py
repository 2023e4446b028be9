"""The vehicle: its connection, requests and state; `goal_methods` has the methods that send goals."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar, overload

from jezero.client import control
from jezero.client.actions import Actions
from jezero.client.camera import Camera
from jezero.client.errors import Unreachable
from jezero.client.goal import request_result
from jezero.client.goal_methods import GoalMethods, Point
from jezero.client.goal_sender import GoalSender
from jezero.client.mission import Missions
from jezero.client.rover import Rover
from jezero.client.session import Connection
from jezero.client.status import REPLY_TIMEOUT_S, check_preflight, request_status, wait_ready, watch_status
from jezero.client.subscription import LatestValues, Subscription, call_for_each, topic_named
from jezero.keys.bundle import INSECURE_VARIABLE, VARIABLE, endpoint_of
from jezero.keys.members import KeysError
from jezero.schemas import topics
from jezero.schemas.actions import ResultReply
from jezero.schemas.commands import AbortReply
from jezero.schemas.estimate import Relative
from jezero.schemas.fence import Fence, FenceState
from jezero.schemas.preflight import PreflightReport
from jezero.schemas.rows import Topic
from jezero.schemas.state import Battery, Odometry, Status
from jezero.schemas.struct import Message
from jezero.schemas.terrain import GetGround, Ground

DEFAULT_VEHICLE, DEFAULT_ROUTER = "uav1", "tcp/127.0.0.1:7447"
M = TypeVar("M", bound=Message)


class Vehicle(GoalMethods):
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
    """

    def __init__(self, connection: Connection) -> None:
        super().__init__(GoalSender(connection))
        self.actions = Actions(connection)
        self.rover = Rover(connection)
        self.camera = Camera(connection)
        self.mission = Missions(connection)
        self._connection = connection
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
            ValueError: the router's address is none.
        """
        vehicle = vehicle or os.environ.get("JEZERO_VEHICLE") or DEFAULT_VEHICLE
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
        """
        control.set_fence(self._connection, fence)

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
