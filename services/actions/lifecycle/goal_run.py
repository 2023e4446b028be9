"""One goal from its arrival to its result: the lifecycle that all actions share.

checking and preparing where the goal needs them -> acquiring -> flying -> releasing -> over; a goal ends exactly once.
The last three are the part of `GoalFlight`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from jezero.runtime.service import BackgroundTask, Call, Inbox, Output, Reply, Request, Response, Subscribe
from jezero.schemas.actions import Accepted, Goal, Rejected, Result
from jezero.schemas.commands import Acquire
from jezero.schemas.topics import ACQUIRE, ALTIMETER, ODOMETRY, STATUS, Action
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.lifecycle.goal_flight import GoalContext, GoalFlight
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.lifecycle.selection_lease import SelectionLease
from jezero.services.actions.lifecycle.vehicle_view import VehicleView
from jezero.services.actions.motion.behaviour import Plan, Preparation, Refusal, Start
from jezero.services.actions.motion.capture import CAPTURE_INPUTS
from jezero.vehicle_config import VehicleConfig

CHECK_TIMEOUT_S = 1.5
"""Time-out of the inputs of a goal whose inputs are checked before it is accepted."""
PREPARE_TIMEOUT_S = 20.0
"""Time-out of the preparation of a goal before it is accepted."""
ACQUIRE_TIMEOUT_S = 1.0
"""Time-out of the bridge's reply; the bridge refuses older requests."""
POSITION_LOST = "the vehicle's position is not known any more: is vehicle_bridge running?"
NO_REPLY = "the vehicle bridge did not reply"


@dataclass(frozen=True)
class _New:
    name: ClassVar = "new"


@dataclass(frozen=True)
class _Checking:
    """The goal waits for its inputs, which are checked then."""

    name: ClassVar = "checking"
    deadline_ns: int


@dataclass(frozen=True)
class _Preparing:
    """The preparation runs in the background."""

    name: ClassVar = "preparing"
    deadline_ns: int
    tag: str


@dataclass(frozen=True)
class _Acquiring:
    """The goal has requested control from the bridge."""

    name: ClassVar = "acquiring"
    deadline_ns: int
    tag: str
    flight: GoalFlight


@dataclass(frozen=True)
class _Rejected:
    name: ClassVar = "over"


class GoalRun:
    """The lifecycle of one goal.

    Args:
        pictures: store of the pictures, for actions that take some.

    Attributes:
        goal: as it was sent.
        goal_id: its id.
        clients: that sent it and are still connected.
        capture: the pictures that it takes, if it does.
    """

    def __init__(
        self,
        *,
        action: Action[Any],
        goal: Goal,
        goal_id: str,
        plan: Plan,
        warning: str,
        vehicle: VehicleConfig,
        epoch_id: int,
        pictures: PictureStore | None = None,
    ) -> None:
        self.goal = goal
        self.goal_id = goal_id
        self.clients: list[str] = []
        self.capture = plan.capture
        self._accepted = Accepted(goal_id=goal_id, warning=warning)
        self._pictures = pictures
        self._stage: _New | _Checking | _Preparing | _Acquiring | GoalFlight | _Rejected = _New()
        self._cancel_reason = ""
        self._arrived_ns = 0
        lease = None if plan.selection is None else SelectionLease(goal_id, plan.selection)
        captured = () if plan.capture is None else CAPTURE_INPUTS
        inputs = tuple(dict.fromkeys((ALTIMETER, *plan.inputs, *captured)))
        self._plan = plan
        self._view = VehicleView(epoch_id, lease, inputs)
        self._context = GoalContext(
            action=action,
            goal_id=goal_id,
            plan=plan,
            inputs=inputs,
            view=self._view,
            lease=lease,
            vehicle=vehicle,
            epoch_id=epoch_id,
        )

    @property
    def stage(self) -> str:
        """Name of the present stage; "over" at the end."""
        return self._stage.stage if isinstance(self._stage, GoalFlight) else self._stage.name

    @property
    def result(self) -> Result[Any] | None:
        """Result of a goal that is over, unless it was rejected."""
        return self._stage.result if isinstance(self._stage, GoalFlight) else None

    # -- called by the server --

    def begin(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Begin with the check of the inputs, or with the acquisition of control where there is none."""
        self._arrived_ns = t_ns
        if self._plan.check_inputs is None:
            yield from self._prepare(t_ns, inbox)
            return
        self._stage = _Checking(t_ns + int(CHECK_TIMEOUT_S * NS_PER_S))
        yield Subscribe((ODOMETRY, *self._context.inputs))

    def attach(self, request: Request) -> Iterator[Output]:
        """Add a watcher: the sender of this goal, or a second one when the goal was sent twice."""
        self._context.watchers.append(request.request_id)
        if request.client_id and request.client_id not in self.clients:
            self.clients.append(request.client_id)
        if isinstance(self._stage, GoalFlight):
            yield Reply(request.request_id, self._accepted, final=False)

    def cancel(self, reason: str) -> bool:
        """End the goal at the next step; returns False when it is ending already."""
        if self.stage in ("releasing", "over"):
            return False
        self._cancel_reason = reason
        return True

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Go on with the present stage."""
        self._store_pictures(t_ns, inbox)
        stage = self._stage
        if isinstance(stage, _Checking):
            yield from self._check_inputs(t_ns, inbox, stage)
        elif isinstance(stage, _Preparing):
            yield from self._await_preparation(t_ns, inbox, stage)
        elif isinstance(stage, _Acquiring):
            yield from self._await_control(t_ns, inbox, stage)
        elif isinstance(stage, GoalFlight):
            yield from stage.step(t_ns, inbox, self._cancel_reason)

    # -- until the goal is accepted --

    def _check_inputs(self, t_ns: int, inbox: Inbox, stage: _Checking) -> Iterator[Output]:
        """Go on or refuse as soon as every input has come, or the time for it is over."""
        if self._cancel_reason:
            yield from self._reject(self._cancel_reason, inbox)
            return
        odometry = self._view.odometry(inbox)
        complete = all(inbox.latest(topic) is not None for topic in self._plan.inputs)
        complete = complete and (self.capture is None or not self.capture.refusal())
        if not (complete and odometry is not None) and t_ns <= stage.deadline_ns:
            return
        if odometry is None:
            yield from self._reject(POSITION_LOST, inbox)
            return
        check = self._plan.check_inputs
        reason = "" if check is None else check(self._view.state(t_ns, inbox, odometry))
        yield from self._reject(reason, inbox) if reason else self._prepare(t_ns, inbox)

    def _prepare(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Start the preparation, if the goal needs one, else acquire control."""
        start = self._plan.start
        if not isinstance(start, Preparation):
            yield from self._acquire(t_ns, inbox, start)
            return
        odometry = self._view.odometry(inbox)
        if odometry is None:
            yield from self._reject(POSITION_LOST, inbox)
            return
        tag = f"{self.goal_id}/prepare/{t_ns}"
        self._stage = _Preparing(t_ns + int(PREPARE_TIMEOUT_S * NS_PER_S), tag)
        yield BackgroundTask(start.work(self._view.state(t_ns, inbox, odometry)), tag)

    def _await_preparation(self, t_ns: int, inbox: Inbox, stage: _Preparing) -> Iterator[Output]:
        """Go on or refuse when the work is done; a cancel doesn't wait for it."""
        response = _response(inbox, stage.tag)
        if self._cancel_reason:
            yield from self._reject(self._cancel_reason, inbox)
        elif response is not None:
            prepared: Any = response.payload  # Start | Refusal, by the type of the preparation's work
            if isinstance(prepared, Refusal):
                yield from self._reject(prepared.reason, inbox)
            else:
                yield from self._acquire(t_ns, inbox, prepared)
        elif t_ns > stage.deadline_ns:
            reason = f"the goal could not be prepared within {PREPARE_TIMEOUT_S:g} s"
            yield from self._reject(reason, inbox)

    def _acquire(self, t_ns: int, inbox: Inbox, start: Start) -> Iterator[Output]:
        """Request control from the bridge, and start the behaviour meanwhile, so that the first feedback is ready."""
        odometry = self._view.odometry(inbox)
        if odometry is None:  # there was some when the goal arrived
            yield from self._reject(POSITION_LOST, inbox)
            return
        timeout_s = ACQUIRE_TIMEOUT_S
        tag = f"{self.goal_id}/acquire/{t_ns}"
        acquire = Acquire(
            goal_id=self.goal_id,
            action=self._context.action.name,
            do_takeoff=self._plan.do_takeoff,
            issued_t_ns=t_ns,
            goal_t_ns=self._arrived_ns,
            goal_issued_t_ns=self.goal.issued_t_ns,
        )
        yield Call(ACQUIRE, acquire, tag, timeout_s)
        flight = GoalFlight(t_ns, inbox, odometry, start, self._context)
        self._stage = _Acquiring(t_ns + int((timeout_s + 0.5) * NS_PER_S), tag, flight)

    def _await_control(self, t_ns: int, inbox: Inbox, stage: _Acquiring) -> Iterator[Output]:
        response, flight = _response(inbox, stage.tag), stage.flight
        if response is None:
            flight.drop_first_feedback()
            if t_ns > stage.deadline_ns:
                yield from self._reject(NO_REPLY, inbox)
        elif response.payload is None:
            yield from self._reject(f"{NO_REPLY}: {response.error}", inbox)
        elif not response.payload.granted:
            yield from self._reject(response.payload.reason, inbox)
        else:
            self._stage = flight
            yield from (Reply(watcher, self._accepted, final=False) for watcher in self._context.watchers)
            yield from flight.begin(t_ns, response.payload, with_feedback=not self._cancel_reason)

    def _reject(self, reason: str, inbox: Inbox) -> Iterator[Output]:
        status = inbox.latest(STATUS)
        rejected = Rejected(goal_id=self.goal_id, reason=reason, code=None if status is None else status.code)
        yield from (Reply(watcher, rejected) for watcher in self._context.watchers)
        self._stage = _Rejected()

    # -- pictures --

    def _store_pictures(self, t_ns: int, inbox: Inbox) -> None:
        """Write the pictures that have come to the disk at once, so that none stays in memory."""
        if self.capture is None or self._pictures is None:
            return
        for shot in self.capture.update(t_ns, inbox):
            try:
                self._pictures.keep(shot.reply(self.goal_id))
            except OSError as error:
                self.capture.fail(f"they can't be stored: {error.strerror or error}")


def _response(inbox: Inbox, tag: str) -> Response | None:
    return next((response for response in inbox.responses if response.tag == tag), None)
