"""What the pages show of one vehicle: its newest messages, each with its age.

Times are seconds of a monotonic wall clock that the caller reads. Ages are ages of arrival, so they grow when a link is
lost, also when vehicle time stands still.
"""

from dataclasses import asdict
from math import degrees, pi
from typing import Any

from jezero.frames import euler_from_quat, subtract
from jezero.recording.thinned_path import ThinnedPath
from jezero.schemas import topics
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.health import ServiceHealth
from jezero.schemas.state import Status
from jezero.schemas.struct import Message
from jezero.schemas.topics import Topic
from jezero.services.ground_station.events import EventLog
from jezero.services.ground_station.readings import (
    LATE_S,
    LOST_S,
    Reading,
    flight_readings,
    gnss_readings,
    ground_reading,
    rover_readings,
)
from jezero.services.ground_station.words import activity, duration, in_charge

FEEDBACK_AGE_MAX_S = 2.0
HEALTH_LATE_S = 3.0
"""A service publishes its health once a second."""
CAMERA_REST_RAD = -0.5 * pi


class VehicleState:
    """The newest message of each topic, and what follows from the earlier ones.

    Attributes:
        events: the last events.
    """

    def __init__(self) -> None:
        self.events = EventLog()
        self._newest: dict[str, tuple[float, Any]] = {}
        self._health: dict[str, tuple[float, ServiceHealth]] = {}
        self._feedback: tuple[float, FeedbackMessage[Any]] | None = None
        self._trail = ThinnedPath()
        self._home_z_ned_m: float | None = None
        self._since_s: float | None = None

    # -- messages --

    def update(self, now_s: float, topic: Topic[Any], message: Message) -> None:
        """Take in a message of any topic."""
        if isinstance(message, ServiceHealth):
            self.events.on_health(now_s, message)
            self._health[message.service] = (now_s, message)
        elif isinstance(message, FeedbackMessage):
            self._feedback = (now_s, message)
        else:
            if isinstance(message, Status):
                self._on_status(now_s, message)
            self._newest[topic.name] = (now_s, message)

    def _on_status(self, now_s: float, status: Status) -> None:
        self.events.on_status(now_s, status)
        last: Status | None = self._latest(topics.STATUS)
        if last is None or (last.code, last.in_charge, last.goal_id) != (status.code, status.in_charge, status.goal_id):
            self._since_s = now_s
        if status.odometry is None:
            return
        before = None if last is None else last.odometry
        if before is not None and before.epoch_id != status.odometry.epoch_id:
            self._trail.clear()
            self._home_z_ned_m = None
        elif before is not None and before.reset_offset_ned_m != status.odometry.reset_offset_ned_m:
            self._trail.shift(subtract(status.odometry.reset_offset_ned_m, before.reset_offset_ned_m))
        if last is not None and status.armed and not last.armed:
            self._home_z_ned_m = status.odometry.pos_uav_ned_m[2]
        self._trail.add(status.odometry.pos_uav_ned_m)

    def _latest(self, topic: Topic[Any]) -> Any:
        entry = self._newest.get(topic.name)
        return None if entry is None else entry[1]

    def _age_s(self, topic: Topic[Any], now_s: float) -> float | None:
        entry = self._newest.get(topic.name)
        return None if entry is None else now_s - entry[0]

    # -- views --

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
        since = "" if self._since_s is None else f"for {duration(now_s - self._since_s)}"
        if age_s > LATE_S:
            silent = f"No status for {duration(age_s)}; the last one was: {activity(status)}."
            return {
                "words": "Link lost", "tone": "lost", "charge": in_charge(status), "since": since,
                "why": f"{silent} {link_problem}".strip(),
            }  # fmt: skip
        why = status.text if status.ready else status.not_ready_reason or status.text
        return {
            "words": activity(status), "tone": _tone(status), "charge": in_charge(status), "since": since, "why": why,
        }  # fmt: skip

    def readings(self, now_s: float) -> list[dict[str, Any]]:
        """The instruments, in the order in which they are shown."""
        status, age_s = self._latest(topics.STATUS), self._age_s(topics.STATUS, now_s)
        rows: list[Reading] = flight_readings(status, age_s, self._home_z_ned_m)
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
            rows.append({"name": name.replace("_", " "), "state": state, "text": text})
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

    def goal(self, now_s: float) -> dict[str, Any] | None:
        """Progress of the goal in charge, whoever sent it; None without one."""
        status: Status | None = self._latest(topics.STATUS)
        if status is None or not status.goal_id:
            return None
        words = status.action.replace("_", " ")
        progress: dict[str, Any] = {"goal_id": status.goal_id, "action": status.action, "words": words, "done": None}
        if self._feedback is None or now_s - self._feedback[0] > FEEDBACK_AGE_MAX_S:
            return progress | {"text": "no news of its progress"}
        message = self._feedback[1]
        return progress | {"text": _progress(message), "done": _done(message)}

    def scene(self, now_s: float) -> dict[str, Any]:
        """Poses for the 3D view and the map, in the world frame NED; a pose that is lost is None."""
        status: Status | None = self._latest(topics.STATUS)
        age_s = self._age_s(topics.STATUS, now_s)
        odometry = None if status is None else status.odometry
        vehicle = None
        if status is not None and odometry is not None and age_s is not None and age_s < LOST_S:
            roll, pitch, yaw = (degrees(angle) for angle in euler_from_quat(odometry.q_ned_from_frd))
            vehicle = {
                "pos": _rounded(odometry.pos_uav_ned_m), "vel": _rounded(odometry.vel_uav_ned_mps),
                "q": [round(part, 4) for part in odometry.q_ned_from_frd],
                "roll": round(roll, 1), "pitch": round(pitch, 1), "yaw": round(yaw, 1),
                "armed": status.armed, "late": age_s > LATE_S, "std": odometry.std_pos_m,
            }  # fmt: skip
        wind = None if status is None else status.wind_ned_mps
        return {
            "vehicle": vehicle,
            "rover": self._rover(now_s),
            "camera": self._camera(now_s),
            "wind": None if wind is None else _rounded(wind),
        }

    def trail(self) -> list[list[float]]:
        """Path flown so far, NED."""
        return [_rounded(point_m) for point_m in self._trail.points_m]

    def _rover(self, now_s: float) -> dict[str, Any] | None:
        rover, age_s = self._latest(topics.ROVER_ESTIMATE), self._age_s(topics.ROVER_ESTIMATE, now_s)
        if rover is None or age_s is None or not rover.valid or age_s > LOST_S:
            return None
        relative = self._latest(topics.RELATIVE)
        cov = None
        if relative is not None and relative.valid:
            cov = [round(relative.cov[index], 6) for index in (0, 1, 6)]
        return {
            "pos": _rounded(rover.pos_rover_ned_m), "yaw": round(rover.yaw_rover_rad, 3), "late": age_s > LATE_S,
            "std": rover.std_pos_m, "cov": cov,
        }  # fmt: skip

    def _camera(self, now_s: float) -> dict[str, float]:
        angles, age_s = self._latest(topics.CAMERA_PITCH), self._age_s(topics.CAMERA_PITCH, now_s)
        if angles is None or age_s is None or age_s > LATE_S:
            return {"pitch": CAMERA_REST_RAD, "roll": 0.0}
        return {"pitch": round(angles.pitch_camera_rad, 3), "roll": round(angles.roll_camera_rad, 3)}


def _tone(status: Status) -> str:
    if status.in_charge in ("external", "failsafe"):
        return "bad"
    if not status.ready:
        return "warning"
    return "flying" if status.armed else "good"


def _progress(message: FeedbackMessage[Any]) -> str:
    """Progress in words, from the feedback of any action."""
    feedback = message.feedback
    parts = ["paused"] if message.paused else []
    if (distance_m := getattr(feedback, "distance_m", None)) is not None:
        parts.append(f"{distance_m:.1f} m to go")
    if (planned := getattr(feedback, "planned", None)) is not None:
        parts.append(f"{feedback.taken} of {planned} images")
    if (phase := getattr(feedback, "phase", None)) is not None:
        parts.append(str(phase).replace("_", " "))
    if message.remaining_s is not None:
        parts.append(f"{duration(message.remaining_s)} left")
    return " · ".join(parts) or "running"


def _done(message: FeedbackMessage[Any]) -> float | None:
    """Fraction of a goal's images that are taken; None for other goals."""
    planned = getattr(message.feedback, "planned", 0)
    return message.feedback.taken / planned if planned else None


def _rounded(vector: Any) -> list[float]:
    return [round(part, 3) for part in vector]
