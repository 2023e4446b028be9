"""The page of all actions, from the topic table and the structs of goals, feedback and results; rows for a terminal."""

import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, get_origin

import msgspec

from jezero.cli.reference.topics import Actions, Row
from jezero.cli.reference.words import Field, description_of, escape, fields_of, summary_of, table
from jezero.schemas import actions, goals
from jezero.schemas.rows import Action
from jezero.schemas.topics import ACTIONS
from jezero.services.vehicle_bridge.admission import CODE_OF, completed


class Example(NamedTuple):
    """One goal, sent in three ways; the way by Zenoh follows from `goal`."""

    goal: goals.Goal
    command: str
    call: str


EXAMPLES = {
    "takeoff": Example(goals.TakeoffGoal(altitude_m=3.0), "jezero takeoff 3", "uav.takeoff(altitude_m=3.0)"),
    "go_to": Example(
        goals.GoToGoal(target_ned_m=(-1.0, -2.0, -3.0), speed_mps=1.5),
        "jezero target -1 -2 -3 --speed 1.5",
        "uav.go_to(-1.0, -2.0, -3.0, speed_mps=1.5)",
    ),
    "fly_velocity": Example(
        goals.FlyVelocityGoal(speed_max_mps=2.0, on_client_loss="cancel"),
        "jezero velocity 1.0 --for 5",
        "uav.fly_velocity(speed_max_mps=2.0)",
    ),
    "get_images": Example(
        goals.GetImagesGoal(center_ned_m=(-2.0, 0.0, -4.0), radius_m=2.0, num_images=4, frame="rover"),
        "jezero getimages -2 0 -4 2 4 rover",
        'uav.get_images((-2.0, 0.0, -4.0), 2.0, 4, frame="rover")',
    ),
    "area_coverage": Example(
        goals.AreaCoverageGoal(polygon_ned_m=((0, 0), (9, 0), (9, 6), (0, 6)), z_ned_m=-5.0, overlap=0.65),
        "jezero gridsweep --polygon field.kml --z -5 --overlap 0.65",
        "uav.area_coverage(((0, 0), (9, 0), (9, 6), (0, 6)), -5.0, overlap=0.65)",
    ),
    "land_on_spot": Example(goals.LandOnSpotGoal(), "jezero land_on_spot", "uav.land_on_spot()"),
    "return_home": Example(goals.ReturnHomeGoal(), "jezero return", "uav.return_home()"),
}
"""Examples of jezero's own actions."""

UNCHANGED = {"on_client_loss": "continue"}
"""Field with its default, for an example whose other fields have their defaults: a request without any is refused."""

INTRODUCTION = """# Actions

This page is the output of `jezero info page actions --own`. Without `--own`, the actions of installed packages follow.
[Actions](../concepts/actions.md) explains the life of a goal, [settings](settings.md#actionstoml) the limits
of all goals.

## Send a goal

Each action below has a command, a method of [`Vehicle`](python.md#vehicle), and a Zenoh key. Three ways take
any action:

```
jezero action send go_to target_ned_m=[-1,-2,-3] speed_mps=1.5
```

```python
uav.send("go_to", target_ned_m=(-1.0, -2.0, -3.0), speed_mps=1.5).result()
```

```
zenoh --mode client --connect tcp/127.0.0.1:7447 --cfg queries_default_timeout:120000 \\
    get --decoder text --selector 'jezero/uav1/@action/go_to?target_ned_m=[-1,-2,-3];speed_mps=1.5;_time=[..]'
```

The command `zenoh` comes from the package `zenoh-cli`. The fields of a goal are parameters of the selector, separated
by `;`, or one JSON object as the payload. A value is JSON where it parses, and text otherwise. None is `null` in JSON.

A running stack describes its actions itself, with the JSON Schema of goal, feedback and result, one reply an action:

```
zenoh --mode client --connect tcp/127.0.0.1:7447 get --decoder text --selector 'jezero/uav1/action/*/description'
```

`jezero info actions --json` prints the same without a stack. A request on `action/*/running` finds the goal that is
flown: its fields, its clients, its plan, and the images so far. Both have no effect.

Positions are metres north, east and **down**, so that a negative z is up.
[Frames](../concepts/frames-and-time.md#frames) explains `world` and `rover`. Quaternions are `[w, x, y, z]`. Bounds of
10 000 and more are left out of the ranges.
"""

REPLIES: dict[Any, str] = {
    actions.Accepted: "the first reply to a goal that will be flown; `warning` names a part that is done differently",
    actions.Rejected: "the only reply to a goal that is refused; `code` is the status code of the vehicle",
    actions.Feedback[Any]: "ten times a second while the goal is flown; `feedback` is that of the action",
    actions.Result[Any]: "the last reply to an accepted goal; `outcome` is `succeeded`, `canceled` or `aborted`",
}
"""Replies to a goal, with their description."""
_LINK = re.compile(r"\[(\w+)\]\(#\w+\)")
"""A link inside a reference page; a terminal shows only its text."""


def page(shown: Actions = ACTIONS) -> str:
    """The page: what all goals share, then a chapter for each action."""
    found = list(shown.values())
    common = [field.name for field in fields_of(goals.Goal)]
    parts = [INTRODUCTION, "## Fields of every goal\n", _inputs(fields_of(goals.Goal))]
    parts.append("## Replies\n")
    parts.append(table([_reply_row(struct, text) for struct, text in REPLIES.items()]) + "\n")
    for action in found:
        parts += _chapter(action, common)
    parts.append("## Values inside feedback and results\n")
    parts += [
        f"### {struct.__name__}\n\n{escape(description_of(struct))}\n\n{_outputs(struct)}"
        for struct in _inner_structs(found)
    ]
    return _link_goals("\n".join(parts), found)


def _link_goals(text: str, found: Iterable[Action[Any]]) -> str:
    """The text, in which a field that holds a goal refers to the action's chapter."""
    for action in found:
        name = action.goal_type.__name__
        text = text.replace(f"[{name}](#{name.lower()})", f"goal of [{action.name}](#{action.name})")
    return text


def _chapter(action: Action[Any], common: list[str]) -> Iterator[str]:
    code = CODE_OF[action.phase]
    yield f"## {action.name}\n\n{escape(description_of(action.goal_type))}\n".replace("\n\n\n", "\n")
    yield f"Status {code:d} (`{code.name}`) while it flies, then {completed(code):d} (`{completed(code).name}`).\n"
    if action.changeable:
        names = ", ".join(f"`{name}`" for name in action.changeable)
        yield f"May [change](../concepts/actions.md#pause-resume-modify) while it flies: {names}.\n"
    yield f"A real vehicle needs {action.odometry_min_hz:g} odometries a second for it.\n"
    if action.name in EXAMPLES:
        yield _example(action, EXAMPLES[action.name])
    goal = [field for field in fields_of(action.goal_type) if field.name not in common]
    yield f"Goal:\n\n{_inputs(goal)}"
    tag = action.feedback_type.__struct_config__.tag
    yield f"Feedback{f', with `kind` = `{tag}`' if tag else ''}:\n\n{_outputs(action.feedback_type)}"
    yield f"Result:\n\n{_outputs(action.result_type)}"
    if action.name in ACTIONS:
        yield f"Settings: `[{action.name}]` in [actions.toml](settings.md#actionstoml).\n"


def _example(action: Action[Any], example: Example) -> str:
    given = {
        name: value
        for name, value in msgspec.to_builtins(example.goal).items()
        if value != _defaults(type(example.goal)).get(name, msgspec.NODEFAULT)
    }
    given = given or UNCHANGED
    words = [f"{name}={value if isinstance(value, str) else _json(value)}" for name, value in given.items()]
    key = f"jezero/uav1/{action.endpoint.name}?{';'.join(words)}"
    return f"- Command: `{example.command}`\n- Python: `{example.call}`\n- Zenoh: `{key}`\n"


def _defaults(struct: Any) -> dict[str, Any]:
    return {field.name: field.default for field in msgspec.structs.fields(struct)}


def _json(value: Any) -> str:
    """JSON, in which whole numbers have no decimals."""
    return re.sub(r"(?<=\d)\.0(?!\d)", "", msgspec.json.encode(value).decode())


def _reply_row(struct: Any, text: str) -> dict[str, str]:
    tag = (get_origin(struct) or struct).__struct_config__.tag
    fields = ", ".join(f"`{field.name}`" for field in fields_of(struct))
    return {"`type`": f"`{tag}`", "fields": fields, "meaning": text}


def _inputs(fields: Iterable[Field]) -> str:
    """Fields that a client sets, as a table; the column of ranges is left out where there are none."""
    rows = [
        {
            "field": f"`{field.name}`",
            "value": field.value,
            "range": field.range,
            "default": field.default,
            "meaning": field.meaning,
        }
        for field in fields
    ]
    if not any(row["range"] for row in rows):
        for row in rows:
            del row["range"]
    return table(rows) + "\n"


def _outputs(struct: Any) -> str:
    """Fields that a client gets, as a table."""
    rows = [
        {
            "field": f"`{field.name}`",
            "value": f"{field.value}{' or none' if field.optional else ''}",
            "meaning": field.meaning,
        }
        for field in fields_of(struct)
    ]
    return table(rows) + "\n"


def _inner_structs(found: Iterable[Action[Any]]) -> list[type]:
    """Structs inside of feedback and results, and those inside of them, but for goals, which have chapters."""
    pending = [kind for action in found for kind in (action.feedback_type, action.result_type)]
    seen: dict[type, None] = {}
    while pending:
        for field in fields_of(pending.pop(0)):
            for struct in field.structs:
                if struct not in seen and not issubclass(struct, goals.Goal):
                    seen[struct] = None
                    pending.append(struct)
    return list(seen)


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
