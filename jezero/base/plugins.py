"""Actions that installed packages add: their entry points in the group `jezero.actions`.

A package declares them in its pyproject.toml:

    [project.entry-points."jezero.actions"]
    spiral = "spiral:ACTION"

`spiral` is the action's name; `spiral:ACTION` is its declaration, which has an attribute `action`: the row of the
action in the topic table. Names are read without importing the package, so that a broken one disturbs nobody else.
"""

import re
from collections.abc import Iterable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from jezero.base.mistakes import unknown
from jezero.schemas.commands import Phase
from jezero.schemas.rows import Action
from jezero.schemas.topics import ACTIONS

GROUP = "jezero.actions"
SERVICE_NAMES = (
    "simulator", "camera", "camera_driver", "autopilot", "rover", "rover_driver", "uwb", "vehicle_bridge",
    "tag_detector", "estimator", "preflight", "mission", "recorder", "ground_station", "actions",
)  # fmt: skip
"""Names of services, which no action may have: the server of an action is a service with the action's name. They are
those of `jezero/services/table.py`, which this module can't import."""
_NAME = re.compile(r"[a-z][a-z0-9_]{0,40}")


class PluginError(RuntimeError):
    """A package's action can't be used; the message names the package and says what to do."""


@cache
def plugin_names() -> tuple[str, ...]:
    """Names of the actions that installed packages add, sorted; none of the packages is imported.

    Actions with a name that is refused are left out, see `refused_plugins`.
    """
    return tuple(sorted({point.name for point in entry_points(group=GROUP) if not name_refusal(point.name)}))


def refused_plugins() -> dict[str, str]:
    """The reason of each refusal of an installed package's action for its name, by that name."""
    refusals = {point.name: name_refusal(point.name) for point in entry_points(group=GROUP)}
    return {name: refusals[name] for name in sorted(refusals) if refusals[name]}


@cache
def load_declaration(name: str) -> Any:
    """The declaration of an action that a package adds.

    Raises:
        PluginError: no installed package adds it, several do, its package can't be imported, or it is no declaration.
    """
    if refusal := name_refusal(name):
        raise PluginError(refusal)
    point = _only(name, tuple(entry_points(group=GROUP, name=name)))
    try:
        declaration = point.load()
    except Exception as error:
        raise PluginError(f"action {name!r}: {point.value} can't be imported: {error!r}") from error
    action = getattr(declaration, "action", None)
    if not isinstance(action, Action):
        raise PluginError(f"action {name!r}: {point.value} has no attribute `action` (a jezero.schemas.rows.Action)")
    if action.name != name or action.phase is not Phase.ACTION:
        raise PluginError(
            f"action {name!r}: {point.value} declares the name {action.name!r} and the phase {action.phase.value!r}; "
            f"they must be {name!r} and {Phase.ACTION.value!r}"
        )
    return declaration


def find_action(name: str) -> Action[Any]:
    """The action of that name: one of jezero's own, or one that a package adds.

    Raises:
        PluginError: there is none, or its package is broken.
    """
    own = ACTIONS.get(name)
    return load_declaration(name).action if own is None else own


def all_actions() -> dict[str, Action[Any]]:
    """Every action by name: jezero's own, then those of packages.

    Raises:
        PluginError: the package of one is broken.
    """
    return {name: find_action(name) for name in action_names()}


def action_names() -> tuple[str, ...]:
    """Names of all actions: jezero's own, then those of packages."""
    return (*ACTIONS, *plugin_names())


def name_refusal(name: str) -> str:
    """The reason why a package's action may not have this name, or ""."""
    if name in ACTIONS:
        return f"action {name!r} is one of jezero's own: a package must give its action another name"
    if name in SERVICE_NAMES:
        return f"action {name!r} has the name of a service: its package must give it another name"
    if not _NAME.fullmatch(name):
        return f"action {name!r}: use lower-case letters, digits and underscores"
    return ""


def _only(name: str, points: Iterable[EntryPoint]) -> EntryPoint:
    found = {point.value: point for point in points}
    if not found:
        raise PluginError(f"{unknown('action', name, action_names())}. Is the package that adds it installed?")
    if len(found) > 1:
        raise PluginError(f"action {name!r} is added by several packages: {', '.join(found)}; uninstall all but one")
    return next(iter(found.values()))
