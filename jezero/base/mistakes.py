"""One sentence for one mistake in what people and programs give, whichever way it comes.

The command line, the Python client, the services on the bus, mission files and settings all use these sentences.
"""

import difflib
import re
from collections.abc import Iterable, Iterator
from functools import cache
from typing import Any

import msgspec
from msgspec import inspect

from jezero.schemas.goals import Goal

WORD_LENGTH_MAX = 64
"""A longer word is cut before it is shown or compared."""
TYPES = {
    "float": "a number", "int": "a whole number", "bool": "true or false", "str": "a text", "array": "a list",
    "object": "fields", "null": "nothing",
}  # fmt: skip
_PATH = re.compile(r" - at `\$(.*)`$", re.DOTALL)
_PART = re.compile(r"\.(\w+)|\[(\d+|\.\.\.)\]")
_TYPE = re.compile(r"`([a-z| ]+)`")
_MISSING = re.compile(r"Object missing required field `(\w+)`")
_UNKNOWN = re.compile(r"Object contains unknown field `(.*)`", re.DOTALL)
_CHOICE = re.compile(r"Invalid enum value '?(.*?)'?", re.DOTALL)
_RANGE = re.compile(r"Expected `[a-z| ]+` (?:>=|>|<=|<) .*")


def unknown(what: str, word: str, known: Iterable[str]) -> str:
    """The sentence for a name that doesn't exist.

    Args:
        what: what it would be the name of, such as "action".
        word: the name that was given.
        known: the names that exist.
    """
    names = tuple(known)
    shown = word if len(word) <= WORD_LENGTH_MAX else f"{word[:WORD_LENGTH_MAX]}…"
    near = difflib.get_close_matches(shown, names, n=1)
    hint = f"did you mean {near[0]!r}? Known are" if near else "known are"
    return f"there is no {what} {shown!r}; {hint} {', '.join(names) or 'none'}"


def missing(name: str) -> str:
    """The sentence for a value that must be given."""
    return f"{name} is missing"


def out_of_range(low: float | None, high: float | None, *, whole: bool = False) -> str:
    """What is expected instead of a number out of its range; both bounds belong to the range.

    Args:
        low: least value; None without a bound.
        high: greatest value; None without a bound.
        whole: whether it is a whole number.
    """
    word = TYPES["int" if whole else "float"]
    if low is not None and high is not None:
        return f"expected {word} from {low:.10g} to {high:.10g}"
    bounds = [_bound("of at least", low), _bound("of at most", high)]
    return " ".join(["expected", word, *filter(None, bounds)])


def wrong_type(expected: str, given: str) -> str:
    """What is expected instead of a value of another type, both in words such as "a number"."""
    return f"expected {expected}, not {given}"


def mistake(error: msgspec.ValidationError, kind: Any, what: str = "field") -> str:
    """The sentence for a mistake that msgspec has found; it begins with the path of the field, such as `steps[0].name`.

    Args:
        kind: the type that was decoded.
        what: what a field of it is called, such as "setting".
    """
    text = str(error)
    found = _PATH.search(text)
    path = found.group(1).removeprefix(".") if found else ""
    text = _PATH.sub("", text)
    if without := _MISSING.fullmatch(text):
        return missing(f"{path}.{without.group(1)}" if path else without.group(1))
    sentence = _sentence(text, tuple(_types_at(kind, path)), what)
    return f"{path}: {sentence}" if path else sentence


def _sentence(text: str, types: tuple[inspect.Type, ...], what: str) -> str:
    """The sentence for an error of msgspec without its path.

    Args:
        types: the types that its field may have.
    """
    if field := _UNKNOWN.fullmatch(text):
        return unknown(what, field.group(1), _field_names(types))
    if (choice := _CHOICE.fullmatch(text)) and (choices := tuple(_choices(types))):
        return unknown("value", choice.group(1), choices)
    numbers = [each for each in types if isinstance(each, inspect.FloatType | inspect.IntType)]
    if len(numbers) == 1 and _RANGE.fullmatch(text):
        return _range(numbers[0])
    text = _TYPE.sub(lambda match: _in_words(match.group(1)), text).replace(", got ", ", not ")
    return text[0].lower() + text[1:]


def _in_words(types: str) -> str:
    names = [name.strip() for name in types.split("|")]
    return " or ".join(TYPES.get(name, name) for name in names)


def _range(number: inspect.FloatType | inspect.IntType) -> str:
    whole = isinstance(number, inspect.IntType)
    if number.gt is None and number.lt is None:
        return out_of_range(number.ge, number.le, whole=whole)
    low = _bound("above", number.gt) or _bound("of at least", number.ge)
    high = _bound("below", number.lt) or _bound("of at most", number.le)
    return f"expected {TYPES['int' if whole else 'float']} {' and '.join(filter(None, (low, high)))}"


def _bound(words: str, value: float | None) -> str:
    return "" if value is None else f"{words} {value:.10g}"


@cache
def _type_of(kind: Any) -> inspect.Type:
    return inspect.type_info(kind)


def _types_at(kind: Any, path: str) -> Iterator[inspect.Type]:
    """The types that a value may have at a path such as `steps[0].name`; several for a union."""
    types = list(_alternatives(_type_of(kind)))
    for name, index in _PART.findall(f".{path}" if path and path[0] != "[" else path):
        types = [found for each in types for part in _parts(each, name, index) for found in _alternatives(part)]
    yield from types


def _parts(kind: inspect.Type, name: str, index: str) -> Iterator[inspect.Type]:
    """The type of one part: of a field with this name, or of the elements of a list or mapping."""
    match kind:
        case inspect.StructType() if name:
            yield from (field.type for field in kind.fields if field.encode_name == name)
        case inspect.TupleType() if index.isdigit():
            yield from kind.item_types[int(index) : int(index) + 1]
        case inspect.ListType() | inspect.VarTupleType() if index:
            yield kind.item_type
        case inspect.DictType() if index:
            yield kind.value_type


def _alternatives(kind: inspect.Type) -> Iterator[inspect.Type]:
    """The types of a union; any other type itself."""
    match kind:
        case inspect.Metadata():
            yield from _alternatives(kind.type)
        case inspect.UnionType():
            for each in kind.types:
                yield from _alternatives(each)
        case _:
            yield kind


def _field_names(types: Iterable[inspect.Type]) -> Iterator[str]:
    """Names of the fields of structs; those that every goal has, and the client fills in, are left out."""
    names: dict[str, None] = {}
    for each in types:
        if isinstance(each, inspect.StructType):
            names.update(dict.fromkeys(own_fields(each.cls)))
    yield from names


def own_fields(kind: Any) -> list[str]:
    """Names of a struct's fields, without those that every goal has and the client fills in."""
    common = Goal.__struct_fields__ if issubclass(kind, Goal) else ()
    return [field.encode_name for field in msgspec.structs.fields(kind) if field.name not in common]


def _choices(types: Iterable[inspect.Type]) -> Iterator[str]:
    for each in types:
        if isinstance(each, inspect.LiteralType):
            yield from map(str, each.values)
        elif isinstance(each, inspect.EnumType):
            yield from (str(member.value) for member in each.cls)
