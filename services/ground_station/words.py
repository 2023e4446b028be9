"""The stack's sentences, names and numbers in words for people, and the vehicle's state in words."""

import re
from collections.abc import Mapping
from math import atan2, hypot, isfinite, pi
from typing import Literal, NamedTuple

from jezero.schemas.preflight import PreflightReport
from jezero.schemas.state import InCharge, Status, StatusCode
from jezero.schemas.struct import VelocityNed

DEGREES = "°"
UNITS = {"m": "m", "mps": "m/s", "rad": DEGREES, "s": "s", "deg": DEGREES, "px": "px", "hz": "Hz"}
"""Unit that people type, by the end of a field's name; an angle in radians is typed in degrees."""
Tone = Literal["good", "flying", "plain", "warning", "bad", "lost"]
"""How something is marked on the pages."""
NOT_CHECKED = "The preflight checks have not reported yet since the vehicle stands here"
ACTIVITIES = {
    StatusCode.IDLE: "On the ground",
    StatusCode.TAKEOFF: "Taking off",
    StatusCode.TAKEOFF_DONE: "Taken off",
    StatusCode.HOVER: "Hovering",
    StatusCode.GO_TO: "Flying to a point",
    StatusCode.GO_TO_DONE: "At the point",
    StatusCode.GET_IMAGES: "Taking images around a target",
    StatusCode.GET_IMAGES_DONE: "All images taken",
    StatusCode.LANDING: "Landing",
    StatusCode.LANDING_DONE: "Landed",
    StatusCode.COVERAGE: "Covering an area",
    StatusCode.COVERAGE_DONE: "Area covered",
    StatusCode.ABORT: "Aborting",
    StatusCode.EXTERNAL: "Under other command",
    StatusCode.ACTION: "Flying {action}",
    StatusCode.ACTION_DONE: "Finished {action}",
}
IN_CHARGE = {
    "none": "nobody",
    "goal": "the goal {action}",
    "hover": "the hover of the vehicle bridge",
    "external": "an external pilot: a person or another program",
    "failsafe": "a failsafe of the autopilot",
}
OTHERS: Mapping[InCharge, str] = {"external": "external pilot", "failsafe": "failsafe"}
"""Who flies while the bridge does not."""
MODES = {"AUTO.LAND": "Landing", "AUTO.PRECLAND": "Landing", "AUTO.RTL": "Returning", "AUTO.LOITER": "Hovering"}
"""What the autopilot does by itself, by its mode."""
COMPASS = ("N", "NNE", "NE", "ENE", "E", "ESE", "SE", "SSE", "S", "SSW", "SW", "WSW", "W", "WNW", "NW", "NNW")
_NAME = re.compile(r"(?<![\w/.=-])\$?\.?[a-z][a-z0-9]*(?:_[a-z0-9]+)+(?![\w/=-]|\.\w)")
_CLIENT = re.compile(r",? ?\b(?:goal )?py-[0-9a-f]{12}(?:-\d+)?")
_MODE = re.compile(r"\b(?:mode )?(AUTO\.\w+|OFFBOARD|POSCTL|ALTCTL|STABILIZED|MANUAL|ACRO)\b")
_MODE_WORDS = {"AUTO.RTL": "return", "AUTO.LOITER": "hold", "POSCTL": "position", "ALTCTL": "altitude"}
_DOWN = re.compile(r"\bz = (-?\d+(?:\.\d+)?) m\b")
_COUNTS_DOWN = re.compile(r": (?:NED counts|z points) down, 5 m up is −5")
_NOT_SAID = ("ned", *UNITS)


def in_words(text: str) -> str:
    """A sentence of the stack for people: names of actions and fields as words, modes by name, ids left out.

    E.g. "land_on_spot: altitude_m is 9000" becomes "land on spot: altitude is 9000". Heights are positive up.
    """
    text = _CLIENT.sub("", text)
    text = _MODE.sub(lambda mode: f"{_MODE_WORDS.get(mode[1]) or mode[1].rpartition('.')[2].lower()} mode", text)
    text = _DOWN.sub(lambda down: f"height {-float(down[1]):g} m", _COUNTS_DOWN.sub("", text))
    return _NAME.sub(lambda name: label_of(name[0].lstrip("$.")), text)


def label_of(name: str) -> str:
    """The name of a field or an action for people, e.g. "target height" of `target_z_ned_m`."""
    first, *rest = name.split("_")
    words = [first, *(word for word in rest if word not in _NOT_SAID)]
    return " ".join("height" if word == "z" else word for word in words)


def activity(status: Status) -> str:
    """What the vehicle does, e.g. "Hovering" or "Landing, failsafe"."""
    if status.in_charge in OTHERS:
        if not status.armed:
            return "Motors off"
        return f"{MODES.get(status.autopilot_mode, 'Flying')}, {OTHERS[status.in_charge]}"
    words = ACTIVITIES[StatusCode(status.code)].format(action=status.action.replace("_", " ") or "an action")
    return f"{words}, paused" if status.paused else words


class StateWords(NamedTuple):
    """The state of a vehicle for people.

    Attributes:
        words: what it does, and on the ground whether it may take off, e.g. "On the ground, ready".
        tone: `good` for a vehicle on the ground only when all that is checked before a takeoff is well.
        why: what explains the words; "" where the bridge's last event does.
    """

    words: str
    tone: Tone
    why: str


def state_words(status: Status, preflight: PreflightReport | None) -> StateWords:
    """The state of a vehicle for people.

    Args:
        preflight: newest preflight report; None when there is none since the vehicle stands on the ground.
    """
    words = activity(status)
    if status.in_charge in OTHERS:
        return StateWords(words, "bad", "")
    if status.code != StatusCode.IDLE:
        return StateWords(words, "flying" if status.ready else "warning", status.not_ready_reason)
    if not status.ready:
        return StateWords(f"{words}, not ready", "warning", status.not_ready_reason)
    if preflight is None:
        return StateWords(f"{words}, not checked", "warning", NOT_CHECKED)
    if failed := preflight.failed():
        return StateWords(f"{words}, preflight failed", "warning", "; ".join(f"{c.name}: {c.text}" for c in failed))
    return StateWords(f"{words}, ready", "good", "")


def in_charge(status: Status) -> str:
    """Who commands the vehicle, e.g. "the goal go to"."""
    return IN_CHARGE[status.in_charge].format(action=status.action.replace("_", " "))


def duration(seconds: float) -> str:
    """A duration, e.g. "3 s" or "2 min 5 s"; never with decimals, so that it changes once a second."""
    minutes, rest_s = divmod(int(max(seconds, 0.0)), 60)
    return f"{minutes} min {rest_s} s" if minutes else f"{rest_s} s"


def wind_words(wind_ned_mps: VelocityNed | None, std_gust_mps: float | None) -> str:
    """The wind, e.g. "1.5 m/s from WSW, gusts ±0.6 m/s"; "unknown" without an estimate."""
    if wind_ned_mps is None or not all(map(isfinite, wind_ned_mps)):
        return "unknown"
    north_mps, east_mps, _ = wind_ned_mps
    from_rad = atan2(-east_mps, -north_mps)
    words = f"{hypot(north_mps, east_mps):.1f} m/s from {COMPASS[round(from_rad / (2.0 * pi) * 16) % 16]}"
    if std_gust_mps is None or not isfinite(std_gust_mps):
        return words
    return f"{words}, gusts ±{2.0 * std_gust_mps:.1f} m/s"
