"""`jezero new`: the start of a package that adds something to jezero."""

import re
import sys
from importlib.resources import files
from importlib.resources.abc import Traversable
from importlib.util import find_spec
from keyword import iskeyword
from pathlib import Path
from string import Template

import click

from jezero.base.files import naming
from jezero.base.plugins import name_refusal, plugin_names
from jezero.cli.options import CommandGroup

SUFFIX = ".tmpl"


@click.group(cls=CommandGroup)
def new() -> None:
    """Write the start of a package that adds something to jezero."""


@new.command()
@click.argument("name")
@click.option(
    "--into",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(),
    help="Folder in which the package's folder is made.  [default: this folder]",
)
def action(name: str, into: Path) -> None:
    """Write a package that adds the action NAME: behaviour, test and pyproject, which fly at once.

    NAME is lower-case letters, digits and underscores, such as `survey_spiral`.
    """
    if refusal := name_refusal(name) or _module_refusal(name):
        raise click.UsageError(refusal)
    folder = into / name
    if folder.exists():
        raise click.UsageError(f"{folder} is there already: choose another name, or another folder with --into")
    words = {"name": name, "dashed": name.replace("_", "-"), "Class": _class_name(name)}
    written = [
        _write(template, folder / _target(path, name), words) for path, template in _templates(files(__package__))
    ]
    for path in written:
        click.echo(f"wrote {path}")
    click.echo(f"next: pip install -e {folder} && pytest {folder}; {folder / 'README.md'} says how to fly it")


def _module_refusal(name: str) -> str:
    """The reason why the package's module or class may not have this name, or "".

    The module of an installed action may be written again. A folder without code can't hide the module, so it counts
    as none.
    """
    class_name = _class_name(name)
    if iskeyword(name) or iskeyword(class_name):
        return f"action {name!r} is a word of Python's syntax, which no module or class can have: choose another name"
    source = (files(__package__) / "templates/action/src/action.py.tmpl").read_text(encoding="utf-8")
    if re.search(rf"^from .* import .*\b{class_name}\b", source, re.MULTILINE):
        return f"action {name!r} would have the class {class_name}, a name that jezero uses: choose another name"
    if name in plugin_names():
        return ""
    spec = None if name in sys.stdlib_module_names else find_spec(name)
    if name in sys.stdlib_module_names or (spec is not None and spec.origin is not None):
        return f"action {name!r} has the name of a Python module that is installed already: choose another name"
    return ""


def _class_name(name: str) -> str:
    return "".join(map(str.capitalize, name.split("_")))


def _templates(package: Traversable) -> list[tuple[str, Traversable]]:
    """The template files of an action, each with its path below the template's folder."""
    found: list[tuple[str, Traversable]] = []

    def walk(folder: Traversable, prefix: str) -> None:
        for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
            if entry.is_dir():
                walk(entry, f"{prefix}{entry.name}/")
            elif entry.name.endswith(SUFFIX):
                found.append((prefix + entry.name.removesuffix(SUFFIX), entry))

    walk(package / "templates" / "action", "")
    return found


def _target(path: str, name: str) -> str:
    """Where a template's file goes: module and test carry the action's name."""
    return path.replace("action.py", f"{name}.py")


def _write(template: Traversable, path: Path, words: dict[str, str]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with naming(path):
        path.write_text(Template(template.read_text(encoding="utf-8")).substitute(words), encoding="utf-8")
    return path
