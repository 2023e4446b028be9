"""The page of the Python client: signatures and docstrings of what a program imports, readable without a build."""

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from enum import Enum
from pkgutil import resolve_name
from types import ModuleType
from typing import Any

import msgspec

from jezero.cli.reference.actions import field_rows
from jezero.cli.reference.words import description_of, table

INTRODUCTION = """# Python

This page is the output of `jezero info page python`: the classes and functions that a program uses, with their
signatures and docstrings. [Getting started](../getting-started.md#from-python) has a first program.

A name ends with its unit, as in `altitude_m`, `speed_mps` and `yaw_rad`; frames are in [Frames and
time](../concepts/frames-and-time.md).
"""
EXAMPLE = "<!-- not run: part of a longer program -->"
"""Stands before a block of code of the page."""
SECTIONS: dict[str, tuple[str, tuple[str, ...]]] = {
    "Vehicle": ("`from jezero import Vehicle`", ("jezero.client.vehicle.Vehicle",)),
    "Goals": (
        "What the methods of a vehicle that send a goal return.",
        (
            "jezero.client.goal.Goal",
            "jezero.client.velocity.VelocityGoal",
            "jezero.client.images.ImagesGoal",
            "jezero.client.images.Picture",
        ),
    ),
    "Actions of the stack": (
        "The attribute `actions` of a vehicle.",
        ("jezero.client.actions.Actions", "jezero.client.actions.described"),
    ),
    "Simulator": ("The attribute `simulator` of a vehicle.", ("jezero.client.simulator.SimulatedWorld",)),
    "Missions": ("The attribute `mission` of a vehicle.", ("jezero.client.mission.Missions",)),
    "Mission and fence files": (
        "`from jezero.mission_files import read_mission`; needs `pip install 'jezero[cli]'`.",
        (
            "jezero.mission_files.read_mission",
            "jezero.mission_files.read_fence",
            "jezero.mission_files.MissionFile",
            "jezero.mission_files.MissionFileError",
        ),
    ),
    "Camera": (
        "The attribute `camera` of a vehicle, and its images.",
        ("jezero.client.camera.Camera", "jezero.schemas.sensors.CameraFrame", "jezero.schemas.sensors.CameraPreview"),
    ),
    "Topics": (
        "What `Vehicle.subscribe` returns; [Topics](topics.md) lists them.",
        ("jezero.client.subscription.Subscription",),
    ),
    "Rover": (
        "The attribute `rover` of a vehicle.",
        ("jezero.client.rover.Rover", "jezero.client.rover.Leg", "jezero.client.rover.Wheel"),
    ),
    "Dataset": ("Needs `pip install 'jezero[cli]'`.", ("jezero.client.dataset.Dataset",)),
    "Recordings": (
        "`from jezero.recording import open_recording`; needs `pip install 'jezero[cli]'`.",
        (
            "jezero.recording.open_recording",
            "jezero.recording.Recording",
            "jezero.recording.Summary",
            "jezero.recording.Entry",
            "jezero.recording.RecordedGoal",
            "jezero.recording.Table",
            "jezero.recording.RecordingError",
        ),
    ),
    "asyncio": (
        "`jezero.aio` has the same methods as coroutines, with the same arguments: `await uav.hover()`.",
        (
            "jezero.aio.vehicle.Vehicle",
            "jezero.aio.goal.Goal",
            "jezero.aio.goal.VelocityGoal",
            "jezero.aio.goal.ImagesGoal",
            "jezero.aio.subscription.Subscription",
            "jezero.aio.rover.Rover",
            "jezero.aio.vehicle.Camera",
        ),
    ),
    "Area files": (
        "`from jezero.area_files import read_area`",
        ("jezero.area_files.read_area", "jezero.area_files.Area", "jezero.area_files.AreaFileError"),
    ),
    "Errors": ("`from jezero import JezeroError, Refused`", ("jezero.client.errors",)),
    "Messages": (
        "Plans, status and images are structs of `jezero.schemas`; goals, feedback and results are on the page of "
        "[actions](actions.md).",
        (
            "jezero.schemas.actions",
            "jezero.schemas.state.Status",
            "jezero.schemas.state.StatusCode",
            "jezero.schemas.state.Odometry",
            "jezero.schemas.state.Battery",
            "jezero.schemas.preflight",
            "jezero.schemas.images",
        ),
    ),
    "Frames": ("`from jezero.base.frames import rotate_yaw`", ("jezero.base.frames",)),
}
"""Chapters of the page: a sentence, and the names of classes, functions and modules."""
WIDTH_MAX = 100
"""A longer signature has a line for each argument."""
_DOC_SECTION = re.compile(r"^(Args|Attributes|Raises|Returns|Yields):$")
_DOC_ENTRY = re.compile(r"^(\*{0,2}[\w.]+(?:, \w+)*): (.*)$", re.DOTALL)


def names() -> list[str]:
    """Full names of everything on the page; a module stands for its own public classes and functions."""
    return [name for _, listed in SECTIONS.values() for each in listed for name in _expanded(each)]


def page() -> str:
    """The page."""
    parts = [INTRODUCTION]
    for title, (sentence, listed) in SECTIONS.items():
        parts += [f"## {title}", sentence]
        for each in listed:
            found = resolve_name(each)
            if isinstance(found, ModuleType):
                parts.append(_prose(found.__doc__ or ""))
            parts += [_described(name) for name in _expanded(each)]
    return "\n\n".join(part.strip() for part in parts if part.strip()) + "\n"


def _expanded(name: str) -> Iterator[str]:
    found = resolve_name(name)
    if not isinstance(found, ModuleType):
        yield name
        return
    for own, value in vars(found).items():
        is_code = inspect.isclass(value) or inspect.isfunction(value)
        if is_code and value.__module__ == found.__name__ and not own.startswith("_") and own == value.__name__:
            yield f"{name}.{own}"


def _described(name: str) -> str:
    """The heading, signature, docstring and methods of a class or function."""
    found = resolve_name(name)
    heading = f"### {name}"
    if inspect.isfunction(found):
        return "\n\n".join([heading, _signature(found), _prose(found.__doc__ or "")])
    if issubclass(found, msgspec.Struct):
        rows = field_rows(found)
        return "\n\n".join(filter(None, [heading, description_of(found), table(rows) if rows else ""]))
    if issubclass(found, Enum):
        return "\n\n".join([heading, _prose(found.__doc__ or ""), table(_members(found))])
    bases = [base.__name__ for base in found.__bases__ if issubclass(base, Exception)]
    kind = f"Derived from `{bases[0]}`." if bases else ""
    text = _prose(found.__doc__ or "")
    made = _signature(found.__init__, found.__name__) if "**Args**" in text else ""
    return "\n\n".join(filter(None, [heading, made, kind, text, *_methods(found)]))


def _members(enum: type[Enum]) -> list[dict[str, str]]:
    return [{"name": f"`{member.name}`", "value": f"`{member.value}`"} for member in enum]


def _methods(cls: type) -> Iterator[str]:
    """Public methods and properties of a class, with those of base classes of jezero."""
    seen: set[str] = set()
    for base in cls.__mro__:
        if not base.__module__.startswith("jezero"):
            continue
        for name, value in vars(base).items():
            if name.startswith("_") or name in seen:
                continue
            seen.add(name)
            if isinstance(value, property) and value.fget is not None:
                returns = _parsed(value.fget).returns
                kind = f": {ast.unparse(returns)}" if returns else ""
                yield f"#### {cls.__name__}.{name}\n\n`{name}{kind}` (property)\n\n{_prose(value.__doc__ or '')}"
            elif inspect.isfunction(function := inspect.unwrap(getattr(value, "__func__", value))):
                prefix = "async " if inspect.iscoroutinefunction(getattr(value, "__func__", value)) else ""
                text = _prose(function.__doc__ or "")
                yield f"#### {cls.__name__}.{name}\n\n{_signature(function, name, prefix)}\n\n{text}"


def _parsed(function: Callable[..., Any]) -> ast.FunctionDef | ast.AsyncFunctionDef:
    """A function's definition as it stands in its file, whose annotations are shorter than those of the object."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(function)))).body
    assert isinstance(definition, ast.FunctionDef | ast.AsyncFunctionDef)
    return definition


def _signature(function: Callable[..., Any], name: str = "", prefix: str = "") -> str:
    definition = _parsed(function)
    arguments = definition.args
    if arguments.args and arguments.args[0].arg in ("self", "cls"):
        del arguments.args[0]
    returns = "" if definition.returns is None or name[:1].isupper() else f" -> {ast.unparse(definition.returns)}"
    prefix = "async " if isinstance(definition, ast.AsyncFunctionDef) else prefix
    begin, listed = f"{prefix}{name or definition.name}", list(_arguments(arguments))
    call = f"{begin}({', '.join(listed)}){returns}"
    if len(call) > WIDTH_MAX:
        call = "\n".join([f"{begin}(", *(f"    {argument}," for argument in listed), f"){returns}"])
    return f"```text\n{call}\n```"


def _arguments(arguments: ast.arguments) -> Iterator[str]:
    """Each argument with its annotation and its default; `*` stands before those that need their name."""
    first = [*arguments.posonlyargs, *arguments.args]
    defaults = [*[None] * (len(first) - len(arguments.defaults)), *arguments.defaults]
    for argument, default in zip(first, defaults, strict=True):
        yield _argument(argument, default)
    if arguments.vararg or arguments.kwonlyargs:
        yield f"*{ast.unparse(arguments.vararg)}" if arguments.vararg else "*"
    for argument, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True):
        yield _argument(argument, default)
    if arguments.kwarg:
        yield f"**{ast.unparse(arguments.kwarg)}"


def _argument(argument: ast.arg, default: ast.expr | None) -> str:
    text = ast.unparse(argument)
    return text if default is None else f"{text} = {ast.unparse(default)}"


def _prose(docstring: str) -> str:
    """A docstring as Markdown: its sections become lists, its code is marked as an example."""
    lines: list[str] = []
    entries: list[str] | None = None
    for line in inspect.cleandoc(docstring).splitlines():
        if title := _DOC_SECTION.match(line):
            lines += [*_listed(entries), f"**{title[1]}**", ""]
            entries = []
        elif entries is not None and (not line or line.startswith(" ")):
            entries.append(line)
        else:
            lines += _listed(entries)
            entries = None
            lines += [EXAMPLE, line] if line.startswith("```") and line != "```" else [line]
    return "\n".join([*lines, *_listed(entries)]).strip()


def _listed(entries: list[str] | None) -> list[str]:
    """The entries of a section as a list; an entry's further lines are indented more than its first."""
    if entries is None:
        return []
    text = textwrap.dedent("\n".join(entries)).strip()
    joined = re.sub(r"\n +", " ", re.sub(r"\n\s*\n", "\n", text))
    listed = []
    for entry in filter(None, joined.split("\n")):
        named = _DOC_ENTRY.match(entry)
        listed.append(f"- `{named[1]}`: {named[2]}" if named else f"- {entry}")
    return [*listed, ""]
