"""The target view of a landing: the vehicle over the platform, its cone, and what the estimate is worth."""

from dataclasses import asdict
from math import hypot, isfinite, sqrt
from typing import Any

from jezero.frames import altitude_m
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.estimate import Relative
from jezero.schemas.goals import LandFeedback
from jezero.services.ground_station.readings import LATE_S, reading
from jezero.services.ground_station.scene import SIGMAS, ellipsoid, rounded

PHASES = {
    "approach": "Approach: flies to a point above the target",
    "descent": "Descent: goes down while it is inside the cone",
    "hold": "Hold: keeps its height, the platform is out of sight",
    "search": "Search: looks for the platform",
    "contact": "Contact: touches down, motors still on",
    "go_around": "Go-around: climbs after a bad contact",
}
INPUTS = {"uwb": "UWB", "tag": "tags", "altimeter": "altimeter"}
NORTH, EAST, DOWN = 0, 6, 11
"""Indices of the position's variances in the upper triangle of the covariance."""


def landing_view(
    message: FeedbackMessage[Any] | None, age_s: float | None, relative: Relative | None, relative_age_s: float | None
) -> dict[str, Any] | None:
    """What the target view shows; None without a landing.

    Args:
        message: newest feedback of the goal in charge.
        age_s: age of the feedback; None when it never arrived.
        relative: newest relative estimate.
    """
    feedback = None if message is None else message.feedback
    if not isinstance(feedback, LandFeedback) or age_s is None:
        return None
    asked_for = relative is not None and message is not None and relative.goal_id == message.goal_id
    on_platform = asked_for or feedback.cone_m is not None
    fresh = relative is not None and relative_age_s is not None and relative_age_s <= LATE_S
    estimate = relative if fresh and on_platform and relative is not None and relative.valid else None
    pos_m = feedback.pos_rel_ned_m if estimate is None else estimate.pos_uav_rel_rover_ned_m
    pos_age_s = age_s if estimate is None else relative_age_s
    shown = pos_m if pos_m is not None and all(map(isfinite, pos_m)) else None
    late = age_s > LATE_S
    return {
        "phase": "No news of the landing" if late else PHASES[feedback.phase],
        "late": late,
        "platform": on_platform,
        "cone": feedback.cone_m,
        "pos": None if shown is None or (pos_age_s or 0.0) > LATE_S else rounded(shown),
        "axes": None if estimate is None else ellipsoid(estimate.cov),
        "yaw": None if estimate is None else round(estimate.yaw_rover_rad, 3),
        "inputs": _inputs(relative if fresh else None) if on_platform else [],
        "verdict": _verdict(relative, relative_age_s, fresh) if on_platform else _no_rover(),
        "rows": [asdict(row) for row in _rows(shown, pos_age_s, estimate, relative_age_s)],
    }


def _rows(pos_m: Any, pos_age_s: float | None, estimate: Relative | None, estimate_age_s: float | None) -> list[Any]:
    std_m = std_down_m = None
    if estimate is not None:
        std_m = sqrt(max(estimate.cov[NORTH], estimate.cov[EAST], 0.0))
        std_down_m = sqrt(max(estimate.cov[DOWN], 0.0))
    aside_m = None if pos_m is None else hypot(pos_m[0], pos_m[1])
    return [
        reading("beside the middle", aside_m, "m", pos_age_s, 2),
        reading("± 3σ", None if std_m is None else SIGMAS * std_m, "m", estimate_age_s, 2),
        reading("height", None if pos_m is None else altitude_m(pos_m[2]), "m", pos_age_s, 2),
        reading("± 3σ height", None if std_down_m is None else SIGMAS * std_down_m, "m", estimate_age_s, 2),
    ]


def _inputs(relative: Relative | None) -> list[dict[str, Any]]:
    """Each input of the relative position, and whether it was fused in the last second."""
    used = () if relative is None else relative.inputs
    wanted = {"uwb": relative is not None and relative.use_uwb, "tag": relative is not None and relative.use_tag}
    return [
        {"name": words, "state": "used" if name in used else "silent" if wanted.get(name) else "off"}
        for name, words in INPUTS.items()
    ]


def _verdict(relative: Relative | None, age_s: float | None, fresh: bool) -> dict[str, str]:
    if relative is None or age_s is None:
        return {"tone": "bad", "text": "no estimate of the rover arrives"}
    if not fresh:
        return {"tone": "bad", "text": "the estimator is silent"}
    if not relative.valid:
        return {"tone": "bad", "text": f"estimate invalid: {relative.reason}"}
    return {"tone": "good", "text": "estimate valid"}


def _no_rover() -> dict[str, str]:
    return {"tone": "plain", "text": "by the vehicle's own position, without the rover"}
