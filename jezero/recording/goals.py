"""The goals of a recording: as they were sent, with their feedback and their results."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec

from jezero.base.codec import BadPayloadError, decode_request
from jezero.schemas import journal
from jezero.schemas.actions import Accepted, FeedbackMessage, Rejected, Result
from jezero.schemas.goals import Goal
from jezero.schemas.journal import JournalPart
from jezero.schemas.rows import Action
from jezero.schemas.units import NS_PER_S

GoalOutcome = Literal["succeeded", "canceled", "aborted", "rejected", "unknown"]
RESULT_START = b'{"type":"result"'
"""Start of an encoded `Result`."""
_RequestKey = tuple[str, int, int]
"""Name and boot id of an action server, and its id of a request."""


@dataclass(frozen=True, kw_only=True)
class RecordedGoal:
    """One goal.

    Its request and its result are in the journal of the action's server. A recording without this journal has the
    feedback alone, and one that begins after the request, or ends before the result, has the rest.

    Attributes:
        goal_id: id of the goal; "" for a rejected one that got none.
        action: name of its action.
        goal: the goal as it was sent. None where the recording does not have it.
        client_id: id of the client that sent it; "" for one that did not name itself, and where it is unknown.
        start_s: time of its start from the recording's first message, to about a tenth of a second.
        start_ns: vehicle time at which its server received it, or that of its first feedback.
        end_ns: vehicle time of its result or rejection, or that of its last feedback.
        feedback: its feedback in the order of time.
        outcome: its end: that of the result, or `rejected`; `unknown` where the recording does not have it.
        reason: reason of another outcome than a success, for people; "" after a success.
        warning: part of the goal that was done differently from the request, for people; "" for none.
        result: the result, in the action's own type. None where there is none.
    """

    goal_id: str
    action: str
    goal: Goal | None = None
    client_id: str = ""
    start_s: float
    start_ns: int
    end_ns: int
    feedback: tuple[FeedbackMessage[Any], ...] = ()
    outcome: GoalOutcome = "unknown"
    reason: str = ""
    warning: str = ""
    result: Any = None

    @property
    def duration_s(self) -> float:
        """Vehicle time from its start to its end."""
        return (self.end_ns - self.start_ns) / NS_PER_S


@dataclass
class _Trace:
    """What is known of one goal so far; see `RecordedGoal`."""

    action: str
    start_s: float
    start_ns: int
    goal: Goal | None = None
    client_id: str = ""
    warning: str = ""
    feedback: list[FeedbackMessage[Any]] = field(default_factory=list)
    end: Rejected | Result[Any] | None = None
    end_ns: int | None = None

    @property
    def is_plan(self) -> bool:
        """Whether it is a goal that was only planned, as far as the recording shows."""
        phases = {getattr(message.feedback, "phase", "") for message in self.feedback}
        return self.goal is None and self.end is None and phases == {"planning"}

    def recorded(self, goal_id: str) -> RecordedGoal:
        last_ns = self.feedback[-1].t_ns if self.feedback else self.start_ns
        ended = self.end if isinstance(self.end, Result) else None
        outcome: GoalOutcome = "unknown" if self.end is None else "rejected" if ended is None else ended.outcome
        return RecordedGoal(
            goal_id=goal_id,
            action=self.action,
            goal=self.goal,
            client_id=self.client_id,
            start_s=self.start_s,
            start_ns=self.start_ns,
            end_ns=last_ns if self.end_ns is None else self.end_ns,
            feedback=tuple(self.feedback),
            outcome=outcome,
            reason="" if self.end is None else self.end.reason,
            warning=self.warning,
            result=None if ended is None else ended.result,
        )


class GoalCollector:
    """Collects the goals of one recording from its journals and its feedback, in the order of the recording.

    Args:
        actions: the known actions by name.
    """

    def __init__(self, actions: Mapping[str, Action[Any]]) -> None:
        self._actions = actions
        self._decoders = {name: msgspec.json.Decoder(action.endpoint.reply_type) for name, action in actions.items()}
        self._goals: dict[tuple[str, str], _Trace] = {}
        """Accepted goals by action and goal id; a rejected one may have the id of another."""
        self._rejected: list[tuple[str, _Trace]] = []
        """Rejected goals with their ids."""
        self._requests: dict[_RequestKey, _Trace] = {}
        """Requests without a reply yet."""
        self._accepted: set[_RequestKey] = set()
        self._t_ns: dict[str, int] = {}
        """Vehicle time of each server's last step."""

    def add_feedback(self, at_s: float, message: FeedbackMessage[Any]) -> None:
        """Add a message of an action's feedback topic.

        Args:
            at_s: time from the recording's first message.
            message: the message.
        """
        self._goal(message.action, message.goal_id, at_s, message.t_ns).feedback.append(message)

    def add_journal(self, at_s: float, part: JournalPart) -> None:
        """Add a part of the journal of any service.

        Args:
            at_s: time from the recording's first message.
            part: the part.

        Raises:
            BadPayloadError: a goal or a reply is not of the type that its action has here.
        """
        action = self._actions.get(part.service)
        if action is None:
            return
        received: list[journal.Requested] = []
        for entry in part.entries:
            match entry:
                case journal.Requested(endpoint) if endpoint == action.endpoint.name:
                    received.append(entry)
                case journal.Step(t_ns):
                    self._t_ns[part.service] = t_ns
                    received_s = max(at_s - max(part.t_ns - t_ns, 0) / NS_PER_S, 0.0)
                    for request in received:
                        key = (part.service, part.boot_id, request.request_id)
                        goal = _goal_of(action, request)
                        self._requests[key] = _Trace(part.service, received_s, t_ns, goal, request.client_id)
                    received.clear()
                case journal.Replied(request_id, reply):
                    self._on_reply(at_s, (part.service, part.boot_id, request_id), bytes(reply))

    def goals(self) -> list[RecordedGoal]:
        """All goals in the order of their starts."""
        known = [trace.recorded(goal_id) for (_, goal_id), trace in self._goals.items() if not trace.is_plan]
        known += [trace.recorded(goal_id) for goal_id, trace in self._rejected]
        known += [trace.recorded("") for trace in self._requests.values()]
        return sorted(known, key=lambda goal: (goal.start_s, goal.start_ns))

    def _goal(self, action: str, goal_id: str, at_s: float, t_ns: int) -> _Trace:
        """A goal, begun now if it is new."""
        return self._goals.setdefault((action, goal_id), _Trace(action, at_s, t_ns))

    def _on_reply(self, at_s: float, key: _RequestKey, data: bytes) -> None:
        """Take in a reply to any request."""
        if not (key in self._requests or key in self._accepted or data.startswith(RESULT_START)):
            return
        service = key[0]
        match self._decode(service, data):
            case Accepted(goal_id=goal_id, warning=warning):
                request = self._requests.pop(key, None)
                if request is None:
                    return
                self._accepted.add(key)
                trace = self._goal(service, goal_id, request.start_s, request.start_ns)
                if trace.goal is None:  # else it is the goal of an earlier request, which was sent twice
                    trace.goal, trace.client_id = request.goal, request.client_id
                    trace.start_s, trace.start_ns = request.start_s, request.start_ns
                trace.warning = trace.warning or warning
            case Rejected() as end if key in self._requests:
                trace = self._requests.pop(key)
                planned = self._goals.get((service, end.goal_id))
                if planned is not None and planned.goal is None:  # it was rejected after its preparation
                    trace.feedback = planned.feedback
                    del self._goals[service, end.goal_id]
                trace.end, trace.end_ns = end, self._t_ns.get(service, trace.start_ns)
                self._rejected.append((end.goal_id, trace))
            case Result() as end:
                trace = self._goal(service, end.goal_id, at_s, end.t_ns)
                trace.end, trace.end_ns = end, end.t_ns

    def _decode(self, service: str, data: bytes) -> Any:
        try:
            return self._decoders[service].decode(data)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise BadPayloadError(str(error)) from None


def _goal_of(action: Action[Any], request: journal.Requested) -> Any:
    data = b"" if bytes(request.request) == b"null" else bytes(request.request)
    return decode_request(action.goal_type, data, request.parameters)


def feedback_by_goal(messages: Iterable[Any]) -> list[list[FeedbackMessage[Any]]]:
    """The feedback of each goal, goals in the order of their first feedback.

    Args:
        messages: recorded messages in the order of time; those that are no feedback are left out.
    """
    by_goal: dict[tuple[str, str], list[FeedbackMessage[Any]]] = {}
    for message in messages:
        if isinstance(message, FeedbackMessage):
            by_goal.setdefault((message.action, message.goal_id), []).append(message)
    return list(by_goal.values())
