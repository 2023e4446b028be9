"""The vehicle: the methods of `jezero.client.vehicle.Vehicle` as coroutines."""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from functools import partial, wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, Self, TypeVar, overload

from jezero.aio.goal import Goal, ImagesGoal, VelocityGoal, cancel_with_task
from jezero.aio.rover import Rover
from jezero.aio.subscription import Subscription
from jezero.aio.threads import Threads, in_thread
from jezero.client import actions, camera, control, goal, images, mission, simulator, velocity
from jezero.client import vehicle as client
from jezero.client.errors import TimedOut, Unreachable
from jezero.client.status import STATUS_TIMEOUT_S, no_status
from jezero.schemas.actions import PlanReply
from jezero.schemas.goals import Goal as GoalPayload
from jezero.schemas.rows import Action, Topic
from jezero.schemas.state import Status
from jezero.schemas.struct import Message
from jezero.schemas.topics import STATUS

P = ParamSpec("P")
G = TypeVar("G", bound=goal.Goal[Any, Any])
A = TypeVar("A")
M = TypeVar("M", bound=Message)


def sends(
    method: Callable[Concatenate[client.Vehicle, P], G], kind: Callable[[Threads, G], A]
) -> Callable[Concatenate["Vehicle", P], Coroutine[Any, Any, A]]:
    """Make a coroutine method from a method of `jezero.client` that sends a goal.

    Args:
        method: the method.
        kind: class of the goal that the coroutine returns when it is accepted.
    """

    @wraps(method)
    async def call(self: "Vehicle", /, *args: P.args, **kwargs: P.kwargs) -> A:
        return kind(self._threads, await self._send(partial(method, self._blocking, *args, **kwargs)))

    return call


class Camera:
    """The camera of one vehicle, the attribute `Vehicle.camera`; see `jezero.client.camera.Camera`."""

    def __init__(self, threads: Threads, blocking: camera.Camera) -> None:
        self._threads = threads
        self._blocking = blocking

    frame = in_thread(camera.Camera.frame)
    preview = in_thread(camera.Camera.preview)
    snap = in_thread(camera.Camera.snap)


class Missions:
    """Missions of one vehicle, the attribute `Vehicle.mission`; see `jezero.client.mission.Missions`."""

    def __init__(self, threads: Threads, blocking: mission.Missions) -> None:
        self._threads = threads
        self._blocking = blocking

    run = in_thread(mission.Missions.run)
    pause = in_thread(mission.Missions.pause)
    resume = in_thread(mission.Missions.resume)
    swapped = in_thread(mission.Missions.swapped)
    skip = in_thread(mission.Missions.skip)
    stop = in_thread(mission.Missions.stop)
    progress = in_thread(mission.Missions.progress)


class SimulatedWorld:
    """The simulated world of one vehicle, `Vehicle.simulator`; see `jezero.client.simulator.SimulatedWorld`."""

    def __init__(self, threads: Threads, blocking: simulator.SimulatedWorld) -> None:
        self._threads = threads
        self._blocking = blocking

    state = in_thread(simulator.SimulatedWorld.state)
    reset = in_thread(simulator.SimulatedWorld.reset)
    place = in_thread(simulator.SimulatedWorld.place)
    wind = in_thread(simulator.SimulatedWorld.wind)
    fault = in_thread(simulator.SimulatedWorld.fault)
    pause = in_thread(simulator.SimulatedWorld.pause)
    resume = in_thread(simulator.SimulatedWorld.resume)
    step = in_thread(simulator.SimulatedWorld.step)
    speed = in_thread(simulator.SimulatedWorld.speed)


class Actions:
    """The actions of one vehicle's stack, the attribute `Vehicle.actions`; see `jezero.client.actions.Actions`."""

    def __init__(self, threads: Threads, blocking: actions.Actions) -> None:
        self._threads = threads
        self._blocking = blocking

    descriptions = in_thread(actions.Actions.descriptions)
    running = in_thread(actions.Actions.running)
    cancel = in_thread(actions.Actions.cancel)
    picture = in_thread(actions.Actions.picture)


class Vehicle:
    """A connection to one vehicle, for the tasks of one event loop.

    Methods have the names, arguments and errors of `jezero.Vehicle`, whose documentation describes them. A method that
    sends a goal returns it when it is accepted; a task that is canceled before then cancels the goal.

    Tasks may share a vehicle. A goal and a subscription are for one task each.

    Attributes:
        actions: the actions of the stack, and the goal that is flown, whichever client sent it.
        rover: the rover, with methods that drive it.
        camera: the camera, with methods that return or save its images.
        simulator: the simulated world, where there is one.
        mission: the mission service; subscribe to `topics.MISSION` to watch it.
    """

    def __init__(self, threads: Threads, blocking: client.Vehicle) -> None:
        self.actions = Actions(threads, blocking.actions)
        self.rover = Rover(threads, blocking.rover)
        self.camera = Camera(threads, blocking.camera)
        self.mission = Missions(threads, blocking.mission)
        self.simulator = SimulatedWorld(threads, blocking.simulator)
        self._threads = threads
        self._blocking = blocking

    @classmethod
    async def connect(
        cls,
        vehicle: str | None = None,
        *,
        router: str | None = None,
        keys: str | Path | None = None,
        insecure: bool = False,
        timeout_s: float = 3.0,
    ) -> Self:
        """Connect to a vehicle; arguments and errors as of `jezero.Vehicle.connect`.

        Close the connection afterwards: `async with await Vehicle.connect("uav1") as uav`.
        """
        threads = Threads()
        blocking = await threads.run(
            client.Vehicle.connect, vehicle, router=router, keys=keys, insecure=insecure, timeout_s=timeout_s
        )
        return cls(threads, blocking)

    @property
    def client_id(self) -> str:
        """Id of this client; the ids of its goals begin with it."""
        return self._blocking.client_id

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exception: object) -> None:
        await self.close()

    close = in_thread(client.Vehicle.close)

    # -- goals --

    takeoff = sends(client.Vehicle.takeoff, Goal)
    go_to = sends(client.Vehicle.go_to, Goal)
    fly_velocity = sends(client.Vehicle.fly_velocity, VelocityGoal)
    land_on_spot = sends(client.Vehicle.land_on_spot, Goal)
    return_home = sends(client.Vehicle.return_home, Goal)
    get_images = sends(client.Vehicle.get_images, ImagesGoal)
    area_coverage = sends(client.Vehicle.area_coverage, ImagesGoal)
    resume_coverage = sends(client.Vehicle.resume_coverage, ImagesGoal)

    async def plan(self, action: str | Action[Any], goal: GoalPayload | None = None, **fields: Any) -> PlanReply:
        """Plan a goal without flying it; arguments and errors as of `jezero.Vehicle.plan`."""
        return await self._threads.run(partial(self._blocking.plan, action, goal, **fields))

    async def send(
        self, action: str | Action[Any], goal: GoalPayload | None = None, **fields: Any
    ) -> Goal[Any, Any] | ImagesGoal | VelocityGoal:
        """Send a goal to any action; arguments and errors as of `jezero.Vehicle.send`."""
        sent = await self._send(partial(self._blocking.send, action, goal, **fields))
        if isinstance(sent, images.ImagesGoal):
            return ImagesGoal(self._threads, sent)
        if isinstance(sent, velocity.VelocityGoal):
            return VelocityGoal(self._threads, sent)
        return Goal(self._threads, sent)

    # -- requests --

    hover = in_thread(client.Vehicle.hover)
    fence = in_thread(client.Vehicle.fence)
    set_fence = in_thread(client.Vehicle.set_fence)
    estimator_parameters = in_thread(client.Vehicle.estimator_parameters)
    estimator_lease = in_thread(client.Vehicle.estimator_lease)
    set_estimator_parameters = in_thread(client.Vehicle.set_estimator_parameters)
    abort = in_thread(client.Vehicle.abort)
    kill = in_thread(client.Vehicle.kill)
    pause = in_thread(client.Vehicle.pause)
    resume = in_thread(client.Vehicle.resume)
    modify = in_thread(client.Vehicle.modify)
    ground = in_thread(client.Vehicle.ground)

    # -- state --

    status = in_thread(client.Vehicle.status)
    preflight = in_thread(client.Vehicle.preflight)
    wait_ready = in_thread(client.Vehicle.wait_ready)
    odometry = in_thread(client.Vehicle.odometry)
    relative = in_thread(client.Vehicle.relative)
    battery = in_thread(client.Vehicle.battery)
    result_of = in_thread(client.Vehicle.result_of)

    async def watch_status(self) -> AsyncIterator[Status]:
        """Yield the last status, then every changed one; errors as of `jezero.Vehicle.watch_status`."""
        async with self.subscribe(STATUS) as stream:
            status = await self.status()
            yield status
            while True:
                try:
                    newer = await stream.next(STATUS_TIMEOUT_S)
                except TimedOut:
                    raise Unreachable(await self._threads.run(no_status, self._blocking._connection)) from None
                if newer != status:
                    status = newer
                    yield status

    @overload
    async def latest(self, topic: Topic[M], timeout_s: float = 1.0) -> M: ...

    @overload
    async def latest(self, topic: str, timeout_s: float = 1.0) -> Any: ...

    async def latest(self, topic: str | Topic[Any], timeout_s: float = 1.0) -> Any:
        """The newest message of any topic; arguments and errors as of `jezero.Vehicle.latest`."""
        return await self._threads.run(self._blocking.latest, topic, timeout_s)

    @overload
    def subscribe(self, topic: Topic[M]) -> Subscription[M]: ...

    @overload
    def subscribe(self, topic: str) -> Subscription[Any]: ...

    def subscribe(self, topic: str | Topic[Any]) -> Subscription[Any]:
        """Subscribe to a topic, whose messages `async for` yields; errors as of `jezero.Vehicle.subscribe`."""
        return Subscription(self._blocking.subscribe(topic))

    @asynccontextmanager
    async def flight(self, altitude_m: float = 2.0) -> AsyncIterator[Self]:
        """Take off, and land at the end of an `async with` block, also after an exception or a cancellation.

        It does not land if a pilot or a failsafe has taken over. Errors as of `jezero.Vehicle.flight`.
        """
        await (await self.takeoff(altitude_m)).result()
        try:
            yield self
        finally:
            await self._threads.run(control.land_here, self._blocking._connection, self._blocking._goals)

    # -- internals --

    async def _send(self, send: Callable[[], G]) -> G:
        """Send a goal in a thread.

        The thread goes on when the task is canceled. A goal that is accepted then would fly without an owner.
        """
        sending = asyncio.ensure_future(self._threads.run(send))
        try:
            return await asyncio.shield(sending)
        except asyncio.CancelledError:
            await asyncio.wait([sending])
            if sending.exception() is None:
                await cancel_with_task(self._threads, sending.result())
            raise
