"""A mission service without a bus, and hand-made action servers for its goals."""

from collections.abc import Sequence
from typing import Any

from msgspec.structs import replace

from jezero.runtime.service import Call, Health, Output, Publish, Reply, Request, Response
from jezero.schemas.actions import Result
from jezero.schemas.mission import GoalStep, Mission, MissionCommand, MissionProgress, MissionReply
from jezero.schemas.state import Battery, Clock, Status, StatusCode
from jezero.schemas.topics import ACTIONS, CLOCK, COMMAND_MISSION, MISSION, RETURN_HOME, RUN_MISSION, STATUS
from jezero.schemas.units import NS_PER_S
from jezero.services.mission.config import MissionConfig
from jezero.services.mission.record import MissionRecord
from jezero.services.mission.return_watch import GROUND
from jezero.services.mission.service import MissionService
from tests.client.rig import ODOMETRY, a_result, a_status

FLYING = replace(a_status(StatusCode.HOVER), battery=Battery(voltage_v=15.0, remaining=0.9))
LANDED = replace(a_status(StatusCode.IDLE), battery=Battery(voltage_v=15.0, remaining=0.9), in_charge="nobody")
STEP = GoalStep(label="go", action="go_to", goal={"target_ned_m": [1.0, 0.0, -3.0]})


def at_altitude(altitude_m: float) -> Status:
    return replace(FLYING, odometry=replace(ODOMETRY, pos_uav_ned_m=(1.0, 2.0, -altitude_m)))


class Box:
    """What arrives at the service in one step."""

    wall_ns, connected, departed, has_requests = 0, True, (), True

    def __init__(
        self,
        status: Status | None,
        request: Any = None,
        responses: Sequence[Response] = (),
        clock: Clock | None = None,
        ground: bool = False,
    ) -> None:
        self.responses = responses
        self._latest = {STATUS: status, CLOCK: clock}
        self._request, self._ground = request, ground

    def latest(self, topic: Any) -> Any:
        return self._latest.get(topic)

    def new(self, topic: Any) -> Sequence[Any]:
        return (object(),) if topic is GROUND and self._ground else ()

    def requests(self, endpoint: Any) -> Sequence[Request]:
        wanted = {RUN_MISSION: Mission, COMMAND_MISSION: MissionCommand}.get(endpoint)
        return [Request(1, "client", self._request)] if wanted is not None and isinstance(self._request, wanted) else ()


class Flown:
    """Steps a mission service once a second.

    Args:
        saved: the mission of the run before.

    Attributes:
        records: every record that was kept.
        epoch_id: of the vehicle's clock; 0 for none.
        ground: whether the ground station is heard.
        health: newest health.
        progress: newest progress.
        published: how many times the progress was published.
    """

    def __init__(self, saved: MissionRecord | None = None, config: MissionConfig | None = None) -> None:
        self.records: list[MissionRecord] = []
        self.epoch_id = 0
        self.ground = False
        self.health = ""
        self.progress = MissionProgress(t_ns=0, state="idle")
        self.published = 0
        self._service = MissionService(1, ACTIONS, saved, self.records.append, config=config)
        self._t_ns = 0

    def step(
        self, status: Status | None, request: Any = None, *responses: Response, seconds: float = 1.0
    ) -> list[Output]:
        self._t_ns += int(seconds * NS_PER_S)
        clock = Clock(t_ns=self._t_ns, wall_ns=self._t_ns, epoch_id=self.epoch_id) if self.epoch_id else None
        box = Box(status, request, responses, clock, self.ground)
        outputs = list(self._service.step(self._t_ns, box))  # type: ignore[arg-type]
        for output in outputs:
            if isinstance(output, Health):
                self.health = output.text
            elif isinstance(output, Publish) and output.topic is MISSION:
                assert isinstance(output.message, MissionProgress)
                self.progress = output.message
                self.published += 1
        return outputs

    def restart_vehicle(self) -> None:
        """Begin vehicle time anew, with another epoch."""
        self._t_ns, self.epoch_id = 0, self.epoch_id + 1

    def ask(self, status: Status | None, request: Any) -> MissionReply:
        (reply,) = self.replies(status, request)
        return reply

    def replies(self, status: Status | None, request: Any, *responses: Response) -> list[MissionReply]:
        replies = [output.payload for output in self.step(status, request, *responses) if isinstance(output, Reply)]
        return [reply for reply in replies if isinstance(reply, MissionReply)]

    def command(self, status: Status | None, command: Any) -> MissionReply:
        return self.ask(status, MissionCommand(command=command))

    def calls(self, status: Status | None, *responses: Response, request: Any = None) -> list[tuple[str, Any]]:
        """Tags of the calls in the next step, and what they send, but for plans of the way home."""
        calls = [output for output in self.step(status, request, *responses) if isinstance(output, Call)]
        return [(call.tag, call.payload) for call in calls if call.endpoint != RETURN_HOME.plan]

    def goals(self, status: Status | None) -> list[tuple[str, Any]]:
        """Names of the actions to which goals are sent in the next step, and the goals."""
        calls = [output for output in self.step(status) if isinstance(output, Call)]
        names = {action.endpoint: name for name, action in ACTIONS.items()}
        return [(names[call.endpoint], call.payload) for call in calls if call.endpoint in names]

    def end_goal(self, status: Status | None, outcome: str = "succeeded", reason: str = "") -> list[tuple[str, Any]]:
        """End the goal that flies; returns the calls of the same step."""
        return self.calls(status, self.result(self.progress.goal_id, outcome, reason))

    @staticmethod
    def result(goal_id: str, outcome: Any, reason: str = "") -> Response:
        result: Result[Any] = a_result(outcome, reason)
        return Response(f"{goal_id}/goal", replace(result, goal_id=goal_id))

    @property
    def state(self) -> str:
        return self.progress.state
