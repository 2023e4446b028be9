"""What the pages show of one vehicle: its newest messages, each with its age, and what happened before.

Times are seconds of a monotonic wall clock that the caller reads. Ages are ages of arrival, so they grow when a link is
lost, also when vehicle time stands still.
"""

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from math import inf, isfinite
from typing import Any

import msgspec

from jezero.base.frames import subtract
from jezero.recording.thinned_path import ThinnedPath
from jezero.schemas import topics
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.fence import FenceState
from jezero.schemas.health import ServiceHealth
from jezero.schemas.preflight import PreflightReport
from jezero.schemas.rows import Topic
from jezero.schemas.state import InCharge, Status, StatusCode
from jezero.schemas.struct import Message
from jezero.services.ground_station.goals import Goals
from jezero.services.ground_station.views import (
    LATE_S,
    Reading,
    altimeter_range,
    camera_attitude,
    flight_readings,
    gnss_readings,
    ground_reading,
    landing_view,
    relative_ellipsoid,
    rounded,
    rover_pose,
    rover_readings,
    vehicle_pose,
)
from jezero.services.ground_station.words import (
    StateWords,
    Tone,
    duration,
    in_charge,
    in_words,
    state_words,
    wind_words,
)

WATCHED = (
    topics.ALTIMETER, topics.GNSS, topics.RELATIVE, topics.ROVER_ESTIMATE, topics.CAMERA_PITCH, topics.FENCE,
)  # fmt: skip
"""Topics that are read only while somebody looks."""
ALWAYS = (topics.STATUS, topics.PREFLIGHT)
"""Topics that are always read, besides the feedback of each action and the health of each service."""
SHOWN = (*WATCHED, *ALWAYS)
"""Topics that the pages show, besides that feedback and health."""
PHOTOS_MAX = 1000
HEALTH_LATE_S = 3.0
"""A service publishes its health once a second."""
PREFLIGHT_AGE_MAX_S = 30.0
"""A vehicle that stands is checked every ten seconds."""
EVENTS_KEPT = 60
CONTROL_LOSSES: dict[InCharge, str] = {"external": "Taken over by an external pilot", "failsafe": "Ended by a failsafe"}


@dataclass(frozen=True)
class Event:
    """One event.

    Attributes:
        t_s: time of its arrival, on the caller's clock.
        tone: how it is marked.
        text: a sentence.
    """

    t_s: float
    tone: Tone
    text: str


class EventLog:
    """Collects the events of one vehicle.

    Attributes:
        count: number of events so far, also of those that are not kept any more.
    """

    def __init__(self) -> None:
        self.count = 0
        self._events: deque[Event] = deque(maxlen=EVENTS_KEPT)
        self._status: Status | None = None
        self._words = ""
        self._health: dict[str, ServiceHealth] = {}

    @property
    def newest_first(self) -> Sequence[Event]:
        """The events, the newest one first."""
        return tuple(reversed(self._events))

    def add(self, t_s: float, tone: Tone, text: str) -> None:
        """Add an event, unless it repeats the last one."""
        text = in_words(text)
        if text and (not self._events or self._events[-1].text != text):
            self._events.append(Event(t_s, tone, text))
            self.count += 1

    def on_status(self, t_s: float, status: Status, state: StateWords) -> None:
        """Compare a status, and the state that it means, with those before."""
        last, self._status = self._status, status
        last_words, self._words = self._words, state.words
        if last is None:
            self.add(t_s, "plain", f"Connected: {state.words}")
            return
        if last.bridge_boot_id != status.bridge_boot_id:
            self.add(t_s, "warning", "The vehicle bridge was restarted")
        if last.epoch_id != status.epoch_id:
            self.add(t_s, "warning", "The vehicle was restarted")
        if last.armed != status.armed:
            self.add(t_s, "plain", "Motors on" if status.armed else "Motors off")
        if last.in_charge != status.in_charge and status.in_charge in CONTROL_LOSSES:
            self.add(t_s, "bad", f"In charge now: {in_charge(status)}")
        if last_words != state.words:
            self.add(t_s, "good" if state.tone in ("good", "flying") else "plain", state.words)
        if last.text != status.text:
            self.add(t_s, "plain", status.text)

    def on_health(self, t_s: float, health: ServiceHealth) -> None:
        """Compare the health of a service with the one before."""
        last, self._health[health.service] = self._health.get(health.service), health
        name = health.service.replace("_", " ")
        if last is not None and last.boot_id != health.boot_id:
            self.add(t_s, "warning", f"{name} was restarted")
        elif last is not None and last.state != health.state:
            tone: Tone = "good" if health.state == "ok" else "warning"
            self.add(t_s, tone, f"{name} is {health.state}: {health.text}")


@dataclass(frozen=True)
class FlightEnd:
    """A loss of control by the bridge: motors cut, a crash, a failsafe or a takeover.

    Attributes:
        t_s: time at which it arrived, on the caller's clock.
        words: what happened, with the bridge's reason.
    """

    t_s: float
    words: str


class FlightEndDetector:
    """Detects from the status that the bridge lost control of the vehicle.

    Attributes:
        newest: the newest loss that nobody has taken note of, and from which control was not taken back; None without
            one.
    """

    def __init__(self) -> None:
        self.newest: FlightEnd | None = None
        self._last: Status | None = None

    def update(self, now_s: float, status: Status) -> None:
        """Compare a status with the one before."""
        last, self._last = self._last, status
        was_lost = last is not None and last.in_charge in CONTROL_LOSSES
        if status.in_charge in CONTROL_LOSSES and (last is None or last.in_charge != status.in_charge):
            self.newest = FlightEnd(now_s, _flight_end_words(status))
        elif was_lost and status.code == StatusCode.HOVER:  # a person has taken control back
            self.newest = None

    def take_note(self) -> None:
        """Forget the newest loss: a person has seen it."""
        self.newest = None


def _flight_end_words(status: Status) -> str:
    reason = status.text
    if reason.startswith("motors cut"):
        return reason[0].upper() + reason[1:]
    return f"{CONTROL_LOSSES[status.in_charge]}: {reason.removeprefix('failsafe: ').removeprefix('taken over: ')}"


class ShownState:
    """The newest message of each topic, and what follows from the earlier ones.

    Attributes:
        events: the last events.
        goals: the goal in charge.
        flight_end: what ended the last flight before its time.
    """

    def __init__(self) -> None:
        self.events = EventLog()
        self.goals = Goals()
        self.flight_end = FlightEndDetector()
        self._newest: dict[str, tuple[float, Any]] = {}
        self._health: dict[str, tuple[float, ServiceHealth]] = {}
        self._feedback: tuple[float, FeedbackMessage[Any]] | None = None
        self._trail = ThinnedPath()
        self._since_s: float | None = None
        self._stands_since_s = -inf
        """Since when the vehicle stands on the ground as it does now; preflight reports from before don't count."""

    # -- messages --

    def update(self, now_s: float, topic: Topic[Any], message: Message) -> None:
        """Take in a message of any topic."""
        if isinstance(message, ServiceHealth):
            self.events.on_health(now_s, message)
            self._health[message.service] = (now_s, message)
        elif isinstance(message, FeedbackMessage):
            self._on_feedback(now_s, message)
        else:
            if isinstance(message, Status):
                self._on_status(now_s, message)
            self._newest[topic.name] = (now_s, message)

    def _on_feedback(self, now_s: float, message: FeedbackMessage[Any]) -> None:
        message = _typed(message)
        self.goals.on_feedback(now_s, message)
        self._feedback = (now_s, message)

    def _on_status(self, now_s: float, status: Status) -> None:
        last: Status | None = self._latest(topics.STATUS)
        if last is not None and (last.code, last.epoch_id) != (status.code, status.epoch_id):
            self._stands_since_s = now_s
        self.events.on_status(now_s, status, state_words(status, self._preflight(now_s)))
        self.goals.on_status(status)
        self.flight_end.update(now_s, status)
        if last is None or (last.code, last.in_charge, last.goal_id) != (status.code, status.in_charge, status.goal_id):
            self._since_s = now_s
        if status.odometry is None:
            return
        before = None if last is None else last.odometry
        if before is not None and before.epoch_id != status.odometry.epoch_id:
            self._trail.clear()
            self.goals.forget()
        elif before is not None and before.reset_offset_ned_m != status.odometry.reset_offset_ned_m:
            self._trail.shift(subtract(status.odometry.reset_offset_ned_m, before.reset_offset_ned_m))
        if status.armed:
            self._trail.add(status.odometry.pos_uav_ned_m)

    def _latest(self, topic: Topic[Any]) -> Any:
        entry = self._newest.get(topic.name)
        return None if entry is None else entry[1]

    def _age_s(self, topic: Topic[Any], now_s: float) -> float | None:
        entry = self._newest.get(topic.name)
        return None if entry is None else now_s - entry[0]

    def _preflight(self, now_s: float) -> PreflightReport | None:
        """Newest preflight report; None without a fresh one since the vehicle stands on the ground."""
        age_s = self._age_s(topics.PREFLIGHT, now_s)
        if age_s is None or age_s > min(PREFLIGHT_AGE_MAX_S, now_s - self._stands_since_s):
            return None
        report: PreflightReport = self._latest(topics.PREFLIGHT)
        return report

    @property
    def epoch_id(self) -> int | None:
        """Epoch of the newest status; None before the first one."""
        status: Status | None = self._latest(topics.STATUS)
        return None if status is None else status.epoch_id

    # -- views --

    @property
    def runs(self) -> dict[str, int]:
        """Id of the present run of each service."""
        return {name: health.boot_id for name, (_, health) in self._health.items()}

    @property
    def origin_deg(self) -> tuple[float, float] | None:
        """Latitude and longitude of the world's origin; None until the autopilot has sent them."""
        status: Status | None = self._latest(topics.STATUS)
        odometry = None if status is None else status.odometry
        return None if odometry is None or odometry.origin_deg is None else odometry.origin_deg[:2]

    @property
    def start_z_ned_m(self) -> float:
        """z of the place from which heights are counted: where the vehicle stood before it was armed, or where it
        stands. While that is not known it is the world's origin, near which the vehicle stood at first."""
        status: Status | None = self._latest(topics.STATUS)
        if status is not None and status.takeoff_ned_m is not None:
            return status.takeoff_ned_m[2]
        odometry = None if status is None or status.armed or not status.landed else status.odometry
        z_ned_m = 0.0 if odometry is None else odometry.pos_uav_ned_m[2]
        return z_ned_m if isfinite(z_ned_m) else 0.0

    @property
    def rover_ned_m(self) -> list[float] | None:
        """Newest position of the rover; None when no estimate is valid."""
        rover = self._latest(topics.ROVER_ESTIMATE)
        return list(rover.pos_rover_ned_m) if rover is not None and rover.valid else None

    def has_status(self, now_s: float, age_max_s: float) -> bool:
        """Whether the newest status is at most so old."""
        age_s = self._age_s(topics.STATUS, now_s)
        return age_s is not None and age_s <= age_max_s

    def status_line(self, now_s: float, link_problem: str) -> dict[str, Any]:
        """The vehicle's activity, who is in charge, since when and why.

        Args:
            link_problem: why no message can come; "" while a router is connected.
        """
        status: Status | None = self._latest(topics.STATUS)
        age_s = self._age_s(topics.STATUS, now_s)
        if status is None or age_s is None:
            reason = link_problem or "No vehicle bridge publishes a status: is the stack up? (jezero ps)"
            return {"words": "No vehicle", "tone": "lost", "charge": "", "since": "", "why": reason}
        state = state_words(status, self._preflight(now_s))
        if age_s > LATE_S:
            silent = f"The vehicle is silent for {duration(age_s)}; its last state was: {state.words}."
            why = f"{silent} {link_problem}".strip()
            return {"words": "Link lost", "tone": "lost", "charge": "", "since": "", "why": why}
        since = "" if self._since_s is None else f"for {duration(now_s - self._since_s)}"
        return {
            "words": state.words, "tone": state.tone, "charge": in_charge(status), "since": since,
            "why": in_words(state.why or status.text),
        }  # fmt: skip

    def notice(self, now_s: float) -> str:
        """What ended the last flight, with its age, until somebody takes note of it; "" for nothing."""
        end = self.flight_end.newest
        return "" if end is None else f"{in_words(end.words)} ({duration(now_s - end.t_s)} ago)"

    def readings(self, now_s: float) -> list[dict[str, Any]]:
        """The instruments, in the order in which they are shown."""
        status, age_s = self._latest(topics.STATUS), self._age_s(topics.STATUS, now_s)
        rows: list[Reading] = flight_readings(status, age_s, self.start_z_ned_m)
        rows.insert(2, ground_reading(self._latest(topics.ALTIMETER), self._age_s(topics.ALTIMETER, now_s)))
        rows += gnss_readings(self._latest(topics.GNSS), self._age_s(topics.GNSS, now_s))
        rows += rover_readings(
            self._latest(topics.RELATIVE), self._age_s(topics.RELATIVE, now_s),
            self._latest(topics.ROVER_ESTIMATE), self._age_s(topics.ROVER_ESTIMATE, now_s),
        )  # fmt: skip
        return [asdict(row) for row in rows]

    def services(self, now_s: float) -> list[dict[str, Any]]:
        """Each service with the state that it published last, and its sentence."""
        rows = []
        for name, (t_s, health) in sorted(self._health.items()):
            silent = now_s - t_s > HEALTH_LATE_S
            state = "silent" if silent else health.state
            text = f"no health for {duration(now_s - t_s)}; the last was: {health.text}" if silent else health.text
            rows.append({"name": name.replace("_", " "), "state": state, "text": in_words(text)})
        return rows

    def event_rows(self, now_s: float) -> list[dict[str, Any]]:
        """The last events, the newest first."""
        return [
            {"age": f"{duration(now_s - event.t_s)} ago", "tone": event.tone, "text": event.text}
            for event in self.events.newest_first
        ]

    @property
    def paused(self) -> bool:
        """Whether the goal in charge is paused."""
        status: Status | None = self._latest(topics.STATUS)
        return status is not None and status.paused

    def landing(self, now_s: float) -> dict[str, Any] | None:
        """The target view of a landing that is in charge, whoever sent it; None without one."""
        status: Status | None = self._latest(topics.STATUS)
        if status is None or self._feedback is None or status.goal_id != self._feedback[1].goal_id:
            return None
        relative, relative_age_s = self._latest(topics.RELATIVE), self._age_s(topics.RELATIVE, now_s)
        return landing_view(self._feedback[1], now_s - self._feedback[0], relative, relative_age_s)

    def scene(self, now_s: float) -> dict[str, Any]:
        """Poses for the 3D view and the map, in the world frame NED; a pose that is lost is None."""
        status, age_s = self._latest(topics.STATUS), self._age_s(topics.STATUS, now_s)
        wind = None if status is None or age_s is None or age_s > LATE_S else status.wind_ned_mps
        return {
            "vehicle": vehicle_pose(status, age_s),
            "range": altimeter_range(self._latest(topics.ALTIMETER), self._age_s(topics.ALTIMETER, now_s)),
            "lost": self._lost(status, age_s),
            "rover": rover_pose(self._latest(topics.ROVER_ESTIMATE), self._age_s(topics.ROVER_ESTIMATE, now_s)),
            "ellipsoid": relative_ellipsoid(self._latest(topics.RELATIVE), self._age_s(topics.RELATIVE, now_s)),
            "camera": camera_attitude(self._latest(topics.CAMERA_PITCH), self._age_s(topics.CAMERA_PITCH, now_s)),
            "wind": None if wind is None else rounded(wind),
            "wind_words": wind_words(wind, None if status is None else status.std_gust_mps),
        }

    def _lost(self, status: Status | None, age_s: float | None) -> dict[str, Any] | None:
        """Where the vehicle was last, in words of time, once nothing comes from it any more."""
        pose = vehicle_pose(status, 0.0)
        if pose is None or age_s is None or age_s <= LATE_S:
            return None
        return {"pos": pose["pos"], "age": f"{duration(age_s)} ago"}

    def trail(self) -> list[list[float]]:
        """Path flown so far, NED."""
        return [rounded(point_m) for point_m in self._trail.points_m]

    def fence(self) -> list[dict[str, Any]]:
        """Zones of the fence in force; corners are north and east."""
        state: FenceState | None = self._latest(topics.FENCE)
        fence = None if state is None else state.fence
        zones = () if fence is None else fence.zones
        return [
            {"name": zone.name, "keep_in": fence is not None and zone is fence.keep_in, "corners": zone.corners_ned_m}
            for zone in zones
        ]

    def photos(self) -> list[list[float]]:
        """Where the last images of the newest goal were taken, NED."""
        view = self.goals.view
        images = [] if view is None else list(view.images.values())[-PHOTOS_MAX:]
        return [rounded(image.pos_camera_ned_m) for image in images]


def _typed(message: FeedbackMessage[Any]) -> FeedbackMessage[Any]:
    """The feedback of one of jezero's own actions as its struct; that of another one as its fields."""
    action = topics.ACTIONS.get(message.action)
    if action is not None and isinstance(message.feedback, dict):
        with suppress(msgspec.ValidationError):  # of another version
            return msgspec.structs.replace(message, feedback=msgspec.convert(message.feedback, action.feedback_type))
    return message
