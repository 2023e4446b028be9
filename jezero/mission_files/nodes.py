"""YAML and JSON text as values that know their lines."""

from dataclasses import dataclass
from math import isfinite
from typing import Any, cast

import yaml

from jezero.mission_files.problems import Problem, Problems

DEPTH_MAX = 50
"""Lists and fields within each other. A mission has ten at most; time grows with the square of their number."""
TOO_DEEP = f"lists and fields are nested more than {DEPTH_MAX} deep here: nobody needs more than ten"
KEYS_OF_ALIASES = "anchors and aliases (& and *) are not read: name points and areas under `points` and `areas`"


@dataclass(frozen=True)
class FileNode:
    """A value of the file.

    Attributes:
        line: where it begins, counted from 1.
        value: None, a truth value, a number, a text, a list of nodes, or a dict of nodes by name.
    """

    line: int
    value: Any

    @property
    def plain(self) -> Any:
        """The value without its lines."""
        if isinstance(self.value, list):
            return [node.plain for node in self.value]
        if isinstance(self.value, dict):
            return {name: node.plain for name, node in self.value.items()}
        return self.value

    @property
    def in_words(self) -> str:
        """The kind of the value, for messages."""
        match self.value:
            case None:
                return "nothing"
            case bool():
                return "true" if self.value else "false"
            case dict():
                return "fields"
            case list():
                return "a list"
            case str():
                return f"the text {self.value!r}"
            case _:
                return f"{self.value!r}"


class UnreadableError(ValueError):
    """The text is no YAML, or uses a part of it that a mission doesn't need.

    Attributes:
        problem: the mistake.
    """

    def __init__(self, line: int, text: str) -> None:
        super().__init__(text)
        self.problem = Problem(line, text)


class _Loader(yaml.SafeLoader):
    """A loader that stops at a text which is nested too deeply, before its scanner looks ahead for the end."""

    def fetch_flow_collection_start(self, TokenClass: Any) -> None:
        self._check_depth()
        super().fetch_flow_collection_start(TokenClass)

    def add_indent(self, column: int) -> bool:
        self._check_depth()
        return bool(super().add_indent(column))

    def _check_depth(self) -> None:
        if self.flow_level + len(self.indents) > DEPTH_MAX:
            raise UnreadableError(self.line + 1, TOO_DEEP)


def parse(text: str, problems: Problems) -> FileNode | None:
    """The value of a text; None for an empty one. Names that stand twice are noted.

    Raises:
        UnreadableError: it can't be read at all.
    """
    loader = _Loader(text)
    try:
        for token in yaml.scan(text, _Loader):
            if isinstance(token, yaml.AliasToken | yaml.AnchorToken):
                raise UnreadableError(token.start_mark.line + 1, KEYS_OF_ALIASES)
        root = loader.get_single_node()
        return None if root is None else _node(root, loader, problems)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        context = f" {error.context}" if error.context else ""
        raise UnreadableError(1 if mark is None else mark.line + 1, f"is no YAML: {error.problem}{context}") from None
    except yaml.YAMLError as error:
        raise UnreadableError(1, f"is no YAML: {error}") from None
    finally:
        loader.dispose()


def _node(node: Any, loader: yaml.SafeLoader, problems: Problems) -> FileNode:
    line = node.start_mark.line + 1
    if isinstance(node, yaml.SequenceNode):
        return FileNode(line, [_node(part, loader, problems) for part in node.value])
    if isinstance(node, yaml.MappingNode):
        return FileNode(line, _fields(node, loader, problems))
    try:
        value = cast(Any, loader.construct_object(node))
    except (yaml.YAMLError, ValueError):
        value = node.value
    if value is not None and not isinstance(value, bool | int | float | str):
        value = node.value  # a date is a text here
    if isinstance(value, float) and not isfinite(value):
        problems.add(line, f"{node.value} is no number here: write one, such as 2.5")
        value = 0.0
    return FileNode(line, _number(value) if isinstance(value, str) and node.style is None else value)


def _fields(node: yaml.MappingNode, loader: yaml.SafeLoader, problems: Problems) -> dict[str, FileNode]:
    fields: dict[str, FileNode] = {}
    for key, value in node.value:
        name = str(key.value)
        if name in fields:
            problems.add(key.start_mark.line + 1, f"{name!r} stands here twice: leave out one of them")
        below = _node(value, loader, problems)
        fields[name] = FileNode(key.start_mark.line + 1, below.value)
    return fields


def _number(text: str) -> float | str:
    """A text that is a number after all: YAML takes 1e3 for a text."""
    try:
        number = float(text)
    except ValueError:
        return text
    return number if isfinite(number) else text
