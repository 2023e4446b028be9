"""The declaration of an action that a package adds, by which it becomes a server."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from jezero.base.config import Config
from jezero.schemas.rows import Action
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Planner

Settings = TypeVar("Settings", bound=Config)


@dataclass(frozen=True, kw_only=True)
class ActionDeclaration(Generic[Settings]):
    """One action of a package; jezero's own are in `jezero/services/actions/table.py`.

    Attributes:
        action: name, endpoints, and the types of goal, feedback and result.
        settings: type of the action's own settings, which are in a file of their own.
        planner: makes the planner from the action's own settings and those of all actions.
    """

    action: Action[Any]
    settings: type[Settings]
    planner: Callable[[Settings, ActionsConfig], Planner]
