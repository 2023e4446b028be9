"""The description of an action for those who send its goals: endpoints, and the fields of goal, feedback and result."""

import re
from typing import Any

from jezero.cli.reference.fields import fields_of, summary_of
from jezero.cli.reference.topics import Row
from jezero.schemas.rows import Action

_LINK = re.compile(r"\[(\w+)\]\(#\w+\)")
"""A link inside a reference page; a terminal shows only its text."""


def action_rows(actions: dict[str, Action[Any]]) -> list[Row]:
    """One row for each action: its endpoint and what its goal is for."""
    return [
        {"action": name, "endpoint": action.endpoint.name, "goal": summary_of(action.goal_type)}
        for name, action in actions.items()
    ]


def field_rows(struct: Any) -> list[Row]:
    """One row for each field of a goal, a feedback or a result."""
    return [
        {
            "field": field.name,
            "value": _LINK.sub(r"\1", f"{field.value} or none" if field.optional else field.value),
            "range": field.range,
            "default": field.default,
            "meaning": field.meaning,
        }
        for field in fields_of(struct)
    ]
