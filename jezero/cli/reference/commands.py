"""The page of all commands, from the commands themselves."""

import inspect
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import click

from jezero.cli.main import main
from jezero.cli.reference.words import escape, table
from jezero.cli.sections import SECTIONS

SHARED_MIN = 5
"""Options that at least this number of commands have alike are described once, at the top of the page."""
BOUND_MAX = 1e6
"""Upper bounds from here on are those of a data type."""
INTRODUCTION = """# Commands

This page is the output of `jezero info page commands`. Numbers may be negative: `jezero target -1 -2 -3`. Exit codes
are in [Getting started](../getting-started.md#a-first-flight-by-hand).
"""

EXAMPLE = "<!-- not run: example of a command's help -->"
"""Stands before a block of code of the page."""

Option = dict[str, str]


def page() -> str:
    """The page: the sections of `jezero --help`, with the options that many commands share at the top."""
    commands = {name: list(_tree(f"jezero {name}", command)) for name, command in _top_level().items()}
    counts = Counter(tuple(option.items()) for tree in commands.values() for _, c in tree for option in _options(c))
    shared = [dict(option) for option, count in counts.items() if count >= SHARED_MIN]
    parts = [INTRODUCTION, f"## Options that many commands have\n\n{table([_row(option) for option in shared])}\n"]
    for title, entries in SECTIONS.items():
        parts.append(f"## {title}\n")
        parts += [_chapter(path, command, shared) for name in entries for path, command in commands[name]]
    return "\n".join(parts)


def _top_level() -> dict[str, click.Command]:
    with click.Context(main, info_name="jezero") as context:
        found = {name: main.get_command(context, name) for name in main.list_commands(context)}
    return {name: command for name, command in found.items() if command is not None}


def _tree(path: str, command: click.Command) -> Iterator[tuple[str, click.Command]]:
    """A command, then the commands below it, each with the words that call it."""
    yield path, command
    if isinstance(command, click.Group):
        for name, below in command.commands.items():
            yield from _tree(f"{path} {name}", below)


def _chapter(path: str, command: click.Command, shared: list[Option]) -> str:
    with click.Context(command, info_name=path) as context:
        words = [word for word in command.collect_usage_pieces(context) if word != "[OPTIONS]"]
    options = _options(command)
    rows = [_row(option) for option in options if option not in shared]
    common = ", ".join(f"`{option['option'].split()[0]}`" for option in options if option in shared)
    usage = [f"`{_numbers(' '.join([path, *words]))}`"] if words and not isinstance(command, click.Group) else []
    if common and not rows:
        usage.append(f"{'options' if usage else 'Options:'} {common}")
    elif common:
        rows.append({"option": common, "meaning": "see the top of the page"})
    parts = [f"### {path}", "; ".join(usage), *_paragraphs(command.help or ""), table(rows) if rows else ""]
    return "\n\n".join(filter(None, parts)) + "\n"


def _paragraphs(text: str) -> Iterable[str]:
    """Paragraphs of a help text; one that is marked to keep its line breaks becomes a block of code."""
    for paragraph in inspect.cleandoc(text).split("\n\n"):
        kept = paragraph.removeprefix("\b\n")
        yield escape(paragraph.replace("\n", " ")) if kept == paragraph else f"{EXAMPLE}\n```\n{kept}\n```"


def _options(command: click.Command) -> list[Option]:
    return [_option(parameter) for parameter in command.params if isinstance(parameter, click.Option)]


def _option(option: click.Option) -> Option:
    names = ", ".join([*option.opts, *option.secondary_opts])
    kind: Any = option.type
    choices = "|".join(map(str, kind.choices)) if isinstance(kind, click.Choice) else ""
    word = option.metavar or " ".join([choices or _numbers(kind.name.upper())] * option.nargs)
    value = "" if option.is_flag else f" {word}"
    low, high = getattr(kind, "min", None), getattr(kind, "max", None)
    limits = "" if low is None else f"≥ {low:g}" if high is None or high > BOUND_MAX else f"{low:g} … {high:g}"
    default = f"default: {option.default}" if option.show_default and not option.is_flag else ""
    text = re.sub(r" *\[default: (.*)\]\.?", r" (default: \1)", option.help or "")
    extra = "; ".join(filter(None, [limits, default]))
    repeatable = " Repeatable." if option.multiple and "epeatable" not in text else ""
    return {"option": f"{names}{value}", "meaning": f"{text}{repeatable}" + (f" ({extra})" if extra else "")}


def _row(option: Option) -> Option:
    return {"option": f"`{option['option']}`", "meaning": option["meaning"]}


def _numbers(text: str) -> str:
    """Types of numbers by one word; whether a range holds is in the meaning."""
    return re.sub(r"\b(FLOAT|INTEGER)( RANGE)?\b", "NUMBER", text)
