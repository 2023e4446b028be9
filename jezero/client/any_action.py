"""Goals for any action by its name, also for actions that installed packages add."""

from typing import Any

import msgspec

from jezero.plugins import PluginError, find_action
from jezero.schemas.actions import Goal
from jezero.schemas.topics import Action


def action_named(action: str | Action[Any]) -> Action[Any]:
    """The row of the topic table of an action; a row stays as it is.

    Raises:
        ValueError: there is no action of that name, or the package that adds it is broken.
    """
    try:
        return find_action(action) if isinstance(action, str) else action
    except PluginError as error:
        raise ValueError(str(error)) from error


def goal_of(action: Action[Any], goal: Goal | None, fields: dict[str, Any], common: dict[str, Any]) -> Goal:
    """A goal to send, with the fields that every goal carries.

    Args:
        goal: a struct of the action's goal type; or None, with the goal's own `fields`.
        common: new id, time of issue and the rule for a vanished client.

    Raises:
        ValueError: the goal doesn't fit the action's type; the message names the field.
    """
    if goal is not None:
        if fields or not isinstance(goal, action.goal_type):
            raise ValueError(f"{action.name} takes one {action.goal_type.__name__}, or its fields as keyword arguments")
        renewed: Goal = msgspec.structs.replace(goal, **common)
        return renewed
    try:
        made: Goal = msgspec.convert({**fields, **common}, action.goal_type)
    except msgspec.ValidationError as error:
        raise ValueError(f"{action.name}: {error}") from None
    return made
