"""The goal in charge, whichever client sent it: whose it is, where it flies, how far it is, and its images."""

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import msgspec

from jezero.schemas.actions import FeedbackMessage, RunningGoal
from jezero.schemas.images import Image
from jezero.schemas.state import Status
from jezero.services.ground_station.words import duration

FEEDBACK_AGE_MAX_S = 2.0
ASKED_AGAIN_S = 3.0
"""Period of requests for a goal that no server admits to fly yet, that was changed, or of which images are missing."""
Point = list[float]


@dataclass
class GoalView:
    """The goal that is or was last in charge.

    Attributes:
        goal_id: its id.
        action: name of its action.
        clients: ids of the clients that sent it; None until its server has replied.
        goal: its fields.
        path: (n, 3) path that it flies in the world, NED; empty where it is not known.
        pictures: (n, 2) places of all planned images, by index.
        images: images taken so far, by index.
        changes: number of changes of the goal that are known here.
    """

    goal_id: str
    action: str
    clients: tuple[str, ...] | None = None
    goal: dict[str, Any] = field(default_factory=dict)
    path: list[Point] = field(default_factory=list)
    pictures: list[Point] = field(default_factory=list)
    images: dict[int, Image] = field(default_factory=dict)
    changes: int = 0


@dataclass(frozen=True)
class _Feedback:
    t_s: float
    goal_id: str
    fields: dict[str, Any]
    remaining_s: float | None
    paused: bool
    changes: int


class Goals:
    """Follows the goals of one vehicle.

    Attributes:
        view: the goal in charge, or the last one that was; None before the first.
        changes: grows when what is drawn of the goal changes.
    """

    def __init__(self) -> None:
        self.view: GoalView | None = None
        self.changes = 0
        self._in_charge = ""
        self._feedback: _Feedback | None = None
        self._asked_s = -ASKED_AGAIN_S
        self._asked_changes = 0
        """Number of changes of the goal, at the last request."""

    def on_status(self, status: Status) -> None:
        """Follow the goal in charge."""
        if status.goal_id == self._in_charge:
            return
        self._in_charge = status.goal_id
        self.changes += 1
        if status.goal_id:
            self.view = GoalView(status.goal_id, status.action)
            self._asked_s = -ASKED_AGAIN_S

    def forget(self) -> None:
        """Forget the last goal, because the vehicle was restarted: its places are in another frame."""
        self.view = None
        self.changes += 1

    def on_feedback(self, now_s: float, message: FeedbackMessage[Any]) -> None:
        """Take in feedback of any goal, as a struct or as its fields."""
        fields: dict[str, Any] = msgspec.to_builtins(message.feedback)
        self._feedback = _Feedback(now_s, message.goal_id, fields, message.remaining_s, message.paused, message.changes)
        images = fields.get("images")
        if not images or self.view is None or self.view.goal_id != message.goal_id:
            return
        with suppress(msgspec.ValidationError):  # a package's own kind of images
            for each in images:
                image = msgspec.convert(each, Image)
                self.view.images[image.index] = image
        self.changes += 1

    def wants_running(self, now_s: float) -> bool:
        """Whether the action servers should be asked for the goal in charge; True is the begin of a request."""
        view = self.view
        if view is None or view.goal_id != self._in_charge or now_s - self._asked_s < ASKED_AGAIN_S:
            return False
        taken = changes = 0
        if self._feedback is not None and self._feedback.goal_id == view.goal_id:
            taken, changes = self._feedback.fields.get("taken", 0), self._feedback.changes
        if view.clients is not None and len(view.images) >= taken and view.changes == changes:
            return False
        self._asked_s = now_s
        self._asked_changes = changes
        return True

    def on_running(self, running: RunningGoal | None) -> None:
        """Take in the reply of the action servers."""
        view = self.view
        if running is None or view is None or running.goal_id != view.goal_id:
            return
        view.clients, view.goal, view.changes = running.clients, running.goal, self._asked_changes
        view.images |= {image.index: image for image in running.images}
        view.path, view.pictures = [list(point) for point in running.path_ned_m], _places_of_images(running)
        self.changes += 1

    # -- views --

    def owner(self, own_id: str, own_goals: Collection[str]) -> str:
        """Who sent the goal in charge, for people.

        Args:
            own_id: client id of this ground station.
            own_goals: ids of the goals that were sent from the page that shows this.
        """
        view = self.view
        if view is None or view.clients is None:
            return ""
        if view.goal_id in own_goals:
            return "sent from this page"
        if own_id and view.goal_id.startswith(f"{own_id}-"):
            return "sent from another page of this ground station"
        if not view.clients:
            is_step = view.goal_id.count(".") >= 2  # the mission service adds number of step and try
            return "sent by a mission" if is_step else "its sender is gone"
        return "sent by another program" if len(view.clients) == 1 else "sent by several other programs"

    def progress(self, now_s: float, own_id: str = "", own_goals: Collection[str] = ()) -> dict[str, Any] | None:
        """Progress of the goal in charge, whoever sent it; None without one."""
        view = self.view
        if view is None or view.goal_id != self._in_charge:
            return None
        shown: dict[str, Any] = {
            "goal_id": view.goal_id,
            "action": view.action,
            "words": view.action.replace("_", " "),
            "owner": self.owner(own_id, own_goals),
            "done": None,
        }
        news = self._feedback
        if news is None or news.goal_id != view.goal_id or now_s - news.t_s > FEEDBACK_AGE_MAX_S:
            return shown | {"text": "no news of its progress"}
        planned = news.fields.get("planned") or 0
        done = news.fields.get("taken", 0) / planned if planned else None
        return shown | {"text": _progress(news), "done": done}

    def drawing(self) -> dict[str, Any]:
        """What the map draws of the goal: its path while it is flown, and which of its images are taken."""
        view = self.view
        if view is None or view.goal_id != self._in_charge:
            return {"path": [], "pictures": [], "taken": []}
        return {"path": view.path, "pictures": view.pictures, "taken": sorted(view.images)}


def _places_of_images(running: RunningGoal) -> list[Point]:
    """Places of a coverage's images, as far as they are known in the world's frame: an area relative to the rover was
    fixed in the world where the rover was at the acceptance."""
    if running.coverage is None or running.goal.get("frame", "world") != "world":
        return []
    return [list(point) for point in running.coverage.pictures_ned_m]


def _progress(news: _Feedback) -> str:
    """Progress in words, from the feedback of any action."""
    fields, parts = news.fields, ["paused"] if news.paused else []
    if (distance_m := fields.get("distance_m")) is not None:
        parts.append(f"{distance_m:.1f} m to go")
    if (planned := fields.get("planned")) is not None:
        parts.append(f"{fields.get('taken', 0)} of {planned} images")
    if (phase := fields.get("phase")) is not None:
        parts.append(str(phase).replace("_", " "))
    if news.remaining_s is not None:
        parts.append(f"{duration(news.remaining_s)} left")
    return " · ".join(parts) or "running"
