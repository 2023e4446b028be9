"""Goals with random fields, and what the client that sends them knows of their outcome."""

from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random
from typing import Any

import msgspec

from jezero.runtime.memory_bus import SentRequest
from jezero.schemas.actions import Accepted
from jezero.schemas.goals import Goal
from jezero.schemas.rows import Action

FIELD_DRAWS: dict[str, Callable[[Random], Any]] = {
    "altitude_m": lambda rng: rng.uniform(0.6, 5.0),
    "target_ned_m": lambda rng: (rng.uniform(-8.0, 8.0), rng.uniform(-8.0, 8.0), rng.uniform(-6.0, -1.5)),
    "landing_spot_ned_m": lambda rng: (rng.uniform(-4.0, 4.0), rng.uniform(-4.0, 4.0), 0.0),
    "center_ned_m": lambda rng: (rng.uniform(-5.0, 5.0), rng.uniform(-5.0, 5.0), rng.uniform(-6.0, -3.0)),
    "radius_m": lambda rng: rng.uniform(1.0, 4.0),
    "num_images": lambda rng: rng.randint(1, 12),
    "polygon_ned_m": lambda rng: ((0.0, 0.0), (rng.uniform(2.0, 6.0), 0.0), (0.0, rng.uniform(2.0, 6.0))),
    "z_ned_m": lambda rng: rng.uniform(-6.0, -2.0),
    "resolution_m": lambda rng: rng.uniform(0.5, 1.5),
    "do_takeoff": lambda rng: rng.random() < 0.5,
    "frame": lambda rng: rng.choice(("world", "world", "world", "rover")),
    "use_uwb": lambda rng: rng.random() < 0.4,
    "use_tag": lambda rng: rng.random() < 0.4,
    "speed_mps": lambda rng: rng.choice((None, rng.uniform(0.5, 4.0))),
    "yaw_rad": lambda rng: rng.choice((None, rng.uniform(-3.1, 3.1))),
    "on_client_loss": lambda rng: rng.choice(("continue", "cancel")),
}
"""Functions that draw the fields of goals, by field name; fields without one keep their defaults."""


def draw_goal(action: Action[Any], rng: Random, goal_id: str, t_ns: int) -> Goal:
    """Draw a valid goal, whether or not the vehicle can fly it now.

    Raises:
        KeyError: the action's goal has a field without a default that is missing in FIELD_DRAWS.
    """
    values: dict[str, Any] = {"goal_id": goal_id, "issued_t_ns": t_ns}
    for info in msgspec.structs.fields(action.goal_type):
        if info.name in FIELD_DRAWS:
            values[info.name] = FIELD_DRAWS[info.name](rng)
        elif info.required and info.name not in values:
            raise KeyError(f"FIELD_DRAWS has no entry for the field {info.name} of {action.name}")
    goal: Goal = action.goal_type(**values)
    return goal


@dataclass
class SentGoal:
    """A goal that a client sent, and the client's knowledge of its outcome.

    Attributes:
        goal: the goal.
        action: the goal's action.
        queries: one query for each time that the goal was sent.
        result_query: the last query for the goal's result.
        result_queried_ns: time of that query, or of the goal's first sending.
        known_outcome: the outcome, "rejected", or "" while the client knows none.
    """

    goal: Goal
    action: Action[Any]
    queries: list[SentRequest] = field(default_factory=list)
    result_query: SentRequest | None = None
    result_queried_ns: int = 0
    known_outcome: str = ""

    @property
    def accepted(self) -> bool:
        return any(isinstance(reply, Accepted) for query in self.queries for reply in query.replies)
