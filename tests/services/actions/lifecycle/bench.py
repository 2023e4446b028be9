"""A server of an action with an inbox that is filled by hand, for what a bus seldom does in a step."""

from collections.abc import Callable, Sequence
from typing import Any

from msgspec.structs import replace

from jezero.base.frames import Vec3
from jezero.runtime.node import Mailbox
from jezero.runtime.service import BackgroundTask, Call, Output, Publish, Reply, Request, Response
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Cancel, GetResult, GetRunning, Modify, Pause
from jezero.schemas.commands import AcquireReply, Phase
from jezero.schemas.goals import Goal, GoToGoal, MoveFeedback, MoveResult
from jezero.schemas.rows import Action, Topic
from jezero.schemas.state import Odometry, Status, StatusCode
from jezero.services.actions.lifecycle.server import ActionServer
from jezero.services.actions.motion.behaviour import Done, Move, Plan, Planner, Remaining, VehicleState
from jezero.services.actions.table import PLANNERS
from tests.services.actions.rig import CONFIG

S = 1_000_000_000
BRIDGE_BOOT_ID, GRANT = 1, 3
ODOMETRY_HOVERING = Odometry(
    t_ns=0,
    epoch_id=1,
    pos_uav_ned_m=(0.0, 0.0, -3.0),
    vel_uav_ned_mps=(0.0, 0.0, 0.0),
    q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
    rates_uav_frd_rps=(0.0, 0.0, 0.0),
)
GRANTED = AcquireReply(granted=True, control_id="c", bridge_boot_id=BRIDGE_BOOT_ID, grants=GRANT)
HOVER = Action("hover_a_while", GoToGoal, MoveFeedback, MoveResult, Phase.ACTION)


class Bench:
    """A server, its inbox, and a vehicle that hovers whatever its setpoints are.

    Attributes:
        odometry: published in each step, and in the status; None: the vehicle's position is lost.
        status: published in each step; None: the bridge is silent.
    """

    def __init__(self, action: Action[Any] = topics.GO_TO, planner: Planner | None = None) -> None:
        self.action = action
        self.server = ActionServer(action, planner or PLANNERS[action.name](CONFIG), CONFIG, boot_id=5)
        self.inbox = Mailbox(())
        self.t_ns = 10 * S
        self.odometry: Odometry | None = ODOMETRY_HOVERING
        self.status: Status | None = Status(
            t_ns=0,
            code=int(StatusCode.HOVER),
            name=StatusCode.HOVER.name,
            armed=True,
            landed=False,
            in_charge="hover",
            bridge_boot_id=BRIDGE_BOOT_ID,
            grants=GRANT,
            epoch_id=1,
            ready=True,
        )
        self._requests = 0

    def step(self, after_s: float = 0.02, *, flies: bool = True) -> list[Output]:
        """Publish what the vehicle publishes, and step the server.

        Args:
            after_s: time since the last step.
            flies: publish odometry on its own topic too.
        """
        self.t_ns += round(after_s * S)
        if self.odometry is not None:
            self.odometry = replace(self.odometry, t_ns=self.t_ns)
        if self.odometry is not None and flies:
            self.inbox.add_message(topics.ODOMETRY.name, self.odometry)
        if self.status is not None:
            self.status = replace(self.status, t_ns=self.t_ns, odometry=self.odometry)
            self.inbox.add_message(topics.STATUS.name, self.status)
        return self.step_alone()

    def step_alone(self, after_s: float = 0.0) -> list[Output]:
        """Step the server with what is in its inbox already."""
        self.t_ns += round(after_s * S)
        outputs = list(self.server.step(self.t_ns, self.inbox))
        self.inbox.clear()
        return outputs

    def request(self, payload: Any, client_id: str = "me") -> int:
        """Put a request into the inbox; returns its id."""
        action = self.action
        endpoints: dict[Any, Any] = {
            Pause: action.pause,
            Modify: action.modify,
            Cancel: action.cancel,
            GetRunning: action.running,
            GetResult: topics.RESULT,
        }
        self._requests += 1
        endpoint = endpoints.get(type(payload), action.endpoint)
        self.inbox.add_request(endpoint.name, Request(self._requests, client_id, payload))
        return self._requests

    def request_plan(self, goal: Goal) -> int:
        self._requests += 1
        self.inbox.add_request(self.action.plan.name, Request(self._requests, "me", goal))
        return self._requests

    def respond(self, outputs: Sequence[Output], payload: Any, error: str | None = None) -> None:
        """Respond to the call or the background task among the outputs."""
        (tag,) = (output.tag for output in outputs if isinstance(output, Call | BackgroundTask))
        self.inbox.responses.append(Response(tag, payload, error))

    def give_control(self, code: StatusCode = StatusCode.GO_TO) -> None:
        """Put the goal in charge in each status that is published after this."""
        assert self.status is not None
        self.status = replace(self.status, code=int(code), in_charge="goal", grant=GRANT)

    def take_control(self, code: StatusCode = StatusCode.HOVER) -> None:
        """Put no goal in charge in each status that is published after this."""
        assert self.status is not None
        self.status = replace(self.status, code=int(code), in_charge="none", grant=0)

    def fly(self, goal: Goal) -> list[Output]:
        """Send a goal and give it control; returns what its first setpoint comes with."""
        self.request(goal)
        self.respond(self.step(flies=False), GRANTED)
        assert replies(self.step(flies=False), Accepted)
        self.give_control()
        return self.step()


def replies(outputs: Sequence[Output], kind: type[Any]) -> list[Any]:
    """Payloads of the replies of a type."""
    return [output.payload for output in outputs if isinstance(output, Reply) and isinstance(output.payload, kind)]


def published(outputs: Sequence[Output], topic: Topic[Any]) -> list[Any]:
    return [output.message for output in outputs if isinstance(output, Publish) and output.topic is topic]


def calls(outputs: Sequence[Output], kind: type[Any]) -> list[Call]:
    """Calls with requests of a type."""
    return [output for output in outputs if isinstance(output, Call) and isinstance(output.payload, kind)]


class Hovers:
    """A planner whose goals hover.

    Args:
        rest: rest of the flight.
        frame: of the feedback.
        pause_refusal: why the goal can't be paused, by its own time.

    Attributes:
        fields: of the plans.
        done: what a step returns; None: a hover.
        started_ns: the goal's own time at its newest start.
        stepped_ns: the goal's own time at its newest step.
    """

    def __init__(
        self,
        fields: dict[str, Any] | None = None,
        *,
        done: Done | None = None,
        rest: Remaining | None = None,
        frame: str = "world",
        pause_refusal: Callable[[int], str] = lambda t_ns: "",
    ) -> None:
        self.fields, self.done = fields or {}, done
        self._rest, self._frame, self._pause_refusal = rest, frame, pause_refusal
        self.started_ns = self.stepped_ns = 0

    def plan(self, goal: GoToGoal, status: Status) -> Plan:
        return replace(Plan(self.start), **self.fields)

    def start(self, t_ns: int, state: VehicleState) -> "Hovers":
        self.started_ns = t_ns
        return self

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        self.stepped_ns = t_ns
        feedback: Any = MoveFeedback(pos_uav_ned_m=(1.0, 2.0, -3.0), frame=self._frame, distance_m=0.0)  # type: ignore[arg-type]
        return self.done or Move(Phase.ACTION, feedback, pos_ned_m=(0.0, 0.0, -3.0), vel_ned_mps=(0.0, 0.0, 0.0))

    def remaining(self, state: VehicleState) -> Remaining | None:
        return self._rest

    def pause_refusal(self, state: VehicleState) -> str:
        return self._pause_refusal(self.stepped_ns)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> MoveResult:
        return MoveResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m)
