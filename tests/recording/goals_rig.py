"""Hand-made journals of action servers in a recording."""

from pathlib import Path

import msgspec
from msgspec import Raw

from jezero.base.codec import encode
from jezero.recording import RecordedGoal, open_recording
from jezero.recording.writer import RecordingWriter
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, FeedbackMessage, Result
from jezero.schemas.commands import Outcome
from jezero.schemas.goals import GoToGoal, MoveFeedback, MoveResult
from jezero.schemas.journal import AnyEntry, JournalPart, Replied, Requested, Step
from jezero.schemas.struct import Payload
from tests.recording.rig import SECOND_NS

GOAL = GoToGoal(target_ned_m=(1.0, 2.0, -3.0), goal_id="a")
RESULT = MoveResult(completed=True, pos_uav_ned_m=(1.0, 2.0, -3.0))


def requested(request_id: int, goal: Payload = GOAL, action: str = "go_to") -> Requested:
    return Requested(f"@action/{action}", request_id, "py-1", Raw(encode(goal)))


def replied(request_id: int, reply: Payload, *, final: bool = True) -> Replied:
    return Replied(request_id, Raw(encode(reply)), final)


def step(seconds: float) -> Step:
    return Step(int(seconds * SECOND_NS), 0, True)


def accepted(request_id: int = 1, goal_id: str = "a", warning: str = "") -> Replied:
    return replied(request_id, Accepted(goal_id=goal_id, warning=warning), final=False)


def succeeded(seconds: float, request_id: int = 1, goal_id: str = "a") -> Replied:
    return ended(seconds, "succeeded", "", request_id, goal_id, RESULT)


def ended(
    seconds: float,
    outcome: Outcome,
    reason: str,
    request_id: int = 1,
    goal_id: str = "a",
    result: MoveResult | None = None,
) -> Replied:
    t_ns = int(seconds * SECOND_NS)
    end: Result[MoveResult] = Result(goal_id=goal_id, t_ns=t_ns, outcome=outcome, reason=reason, result=result)
    return replied(request_id, end)


class Flight:
    """Writes a recording whose vehicle time is 100 s behind its own clock.

    Attributes:
        path: the recording.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._writer = RecordingWriter(path, {})
        self._parts: dict[str, int] = {}
        self.write(0.0, "health/go_to", b"{}")

    def write(self, seconds: float, topic: str, data: bytes) -> None:
        self._writer.write(int((100.0 + seconds) * SECOND_NS), topic, data)

    def journal(self, seconds: float, *entries: AnyEntry, action: str = "go_to") -> None:
        """Write a part of a journal that was closed at a time."""
        number = self._parts[action] = self._parts.get(action, -1) + 1
        t_ns = int(seconds * SECOND_NS)
        part = JournalPart(t_ns=t_ns, service=action, boot_id=1, number=number, entries=entries)
        self.write(seconds, topics.journal_of(action).name, msgspec.json.encode(part))

    def feedback(self, seconds: float, goal_id: str = "a", distance_m: float = 1.0) -> None:
        content = MoveFeedback(pos_uav_ned_m=(0.0, 0.0, -2.0), distance_m=distance_m)
        self.write(seconds, topics.feedback_of(topics.GO_TO).name, encode(message(seconds, goal_id, content)))

    def close(self) -> None:
        """Finish the recording."""
        self._writer.close()

    def goals(self, start_s: float = 0.0, end_s: float | None = None) -> list[RecordedGoal]:
        """Finish the recording, and read its goals."""
        self.close()
        return open_recording(self.path).goals(start_s=start_s, end_s=end_s)


def message(seconds: float, goal_id: str, content: Payload) -> FeedbackMessage[Payload]:
    action = "go_to" if isinstance(content, MoveFeedback) else "get_images"
    return FeedbackMessage(t_ns=int(seconds * SECOND_NS), goal_id=goal_id, action=action, code=4, feedback=content)
