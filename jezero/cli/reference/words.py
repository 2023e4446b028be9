"""Words for people: the fields of a struct with value and unit, range, default and meaning; tables in Markdown."""

import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, get_origin

import msgspec
from msgspec import inspect as types

from jezero.base.plugins import action_names
from jezero.schemas.topics import ACTIONS

BOUND_MAX = {types.FloatType: 1e4, types.IntType: 1e6}
"""Bounds from here on only keep out garbage such as infinity, so that no page shows them."""
UNITS = {
    "m2ps3": "m²/s³", "mps2": "m/s²", "mps": "m/s", "m2": "m²", "m": "m", "px": "pixels", "rad": "rad",
    "rps2": "rad/s²", "rps": "rad/s", "deg": "degrees", "ns": "ns", "s": "s", "hz": "Hz", "1ps2": "1/s²", "1ps": "1/s",
    "kgm2": "kg m²", "kgpm3": "kg/m³", "kg": "kg", "pa": "Pa", "degc": "°C", "gauss": "G", "mah": "mAh", "ohm": "Ω",
    "v": "V", "a": "A", "nspm": "N s/m", "nms": "N m s", "npm": "N/m", "n": "N",
}  # fmt: skip
"""Units by the last part of a field's name."""
_SECTIONS = re.compile(r"^(?:Attributes|Raises):$", re.MULTILINE)
_SECTION = re.compile(r"^Attributes:\n((?:    .*\n|\n)*)", re.MULTILINE)
_ENTRY = re.compile(r"^    (\w+(?:, \w+)*): (.*(?:\n {8,}.*)*)", re.MULTILINE)
_SHORT_ENTRY = re.compile(r"(\w+(?:, \w+)*): (.*?)(?:; (?=\w+: )|$)", re.DOTALL)


@dataclass(frozen=True)
class Field:
    """One field of a struct.

    Attributes:
        name: name of the field.
        value: kind of value, with its unit.
        range: allowed values, "" for any.
        default: value of a field that is left out; "required" for one that must be given.
        meaning: description in the struct's docstring, "" without one.
        optional: the value may be none.
        structs: structs inside of the value.
    """

    name: str
    value: str
    range: str
    default: str
    meaning: str
    optional: bool
    structs: tuple[type, ...]


def fields_of(struct: Any) -> list[Field]:
    """All fields of a struct type, inherited ones first."""
    info = types.type_info(struct)
    assert isinstance(info, types.StructType)
    meanings = attributes_of(get_origin(info.cls) or info.cls)
    return [
        Field(
            name=field.name,
            value=_value_words(field.type, unit_of(field.name)),
            range=_range_words(field.type),
            default=_default_words(field),
            meaning=meanings.get(field.name, ""),
            optional=isinstance(field.type, types.UnionType) and field.type.includes_none,
            structs=tuple(_structs(field.type)),
        )
        for field in info.fields
    ]


def unit_of(name: str) -> str:
    """Unit of a field from its name, "" for one without a unit: `radius_m` is in m, `std_per_m` in 1/m."""
    match name.split("_"):
        case [*_, "per", last] if last in UNITS:
            return f"per {UNITS[last]}"
        case [_, *_, last]:
            return UNITS.get(last, "")
    return ""


def summary_of(struct: type) -> str:
    """First paragraph of a struct's docstring, "" when the docstring only describes fields."""
    first = inspect.cleandoc(struct.__doc__ or "").split("\n\n")[0].replace("\n", " ")
    entry = _SHORT_ENTRY.match(first)
    names = set(getattr(struct, "__struct_fields__", ())) | {"Attributes"}
    return "" if entry and set(entry[1].split(", ")) <= names else first


def description_of(struct: type) -> str:
    """All paragraphs of a struct's docstring but its fields and exceptions, "" when it only describes fields."""
    if not summary_of(struct):
        return ""
    text = _SECTIONS.split(inspect.cleandoc(struct.__doc__ or ""))[0]
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.strip().split("\n\n"))


def attributes_of(struct: type) -> dict[str, str]:
    """Descriptions of a struct's fields in its docstring and in those of its base classes."""
    meanings: dict[str, str] = {}
    for cls in reversed(struct.__mro__):
        if not issubclass(cls, msgspec.Struct) or cls is msgspec.Struct:
            continue
        text = inspect.cleandoc(cls.__dict__.get("__doc__") or "") + "\n"
        section = _SECTION.search(text)
        entries = _ENTRY.findall(section[1]) if section else [] if summary_of(cls) else _SHORT_ENTRY.findall(text)
        for names, meaning in entries:
            meanings |= dict.fromkeys(names.split(", "), " ".join(meaning.split()))
    return meanings


def json_words(value: Any) -> str:
    """A value as JSON in code quotes, as it is written in a goal and, but for a table, in a TOML file."""
    return f"`{msgspec.json.encode(value).decode().replace(',', ', ')}`"


def _value_words(kind: types.Type, unit: str) -> str:
    words = _words(kind)
    return f"{words}, {unit}" if unit and "number" in words else words


SIMPLE: dict[type[types.Type], str] = {
    types.BoolType: "true or false",
    types.IntType: "whole number",
    types.FloatType: "number",
    types.StrType: "text",
    types.BytesType: "bytes",
    types.AnyType: "anything",
}


def _words(kind: types.Type) -> str:
    """A type as a reader of JSON or TOML thinks of it."""
    words = SIMPLE.get(type(kind), "")
    match kind:
        case types.LiteralType() | types.EnumType():
            words = _choice(kind)
        case types.StructType():
            words = f"[{kind.cls.__name__}](#{kind.cls.__name__.lower()})"
        case types.DictType():
            words = f"table of {_plural(_words(kind.value_type))}"
        case types.TupleType():
            words = _several(str(len(kind.item_types)), _words(kind.item_types[0]))
        case types.VarTupleType() | types.ListType():
            words = _several("n", _words(kind.item_type))
        case types.UnionType():
            words = " or ".join(dict.fromkeys(map(_words, _without_none(kind))))
    if not words:
        raise TypeError(f"{kind} has no words yet")
    return words.replace("whole number or number", "number")


def _choice(kind: types.LiteralType | types.EnumType) -> str:
    values = kind.values if isinstance(kind, types.LiteralType) else [member.value for member in kind.cls]
    *others, last = (f"`{value}`" for value in values)
    return f"{', '.join(others)} or {last}" if others else last


def _several(count: str, item: str) -> str:
    """`3 numbers`; `n × 2 numbers` for a list of pairs, and so on."""
    if count == "n" and "number" not in item:
        return f"list of {item}"
    if re.match(r"[\dn] ", item):
        return f"{count} × {item}".replace("n × n", "k × n")
    return f"list of {_plural(item)}" if count == "n" else f"{count} {_plural(item)}"


def _plural(words: str) -> str:
    return f"{words}s" if words.endswith("number") else words


def _without_none(kind: types.UnionType) -> list[types.Type]:
    return [item for item in kind.types if not isinstance(item, types.NoneType)]


def _items(kind: types.Type) -> list[types.Type]:
    """Types directly inside a type."""
    match kind:
        case types.UnionType():
            return _without_none(kind)
        case types.TupleType():
            return list(kind.item_types)
        case types.VarTupleType() | types.ListType():
            return [kind.item_type]
        case types.DictType():
            return [kind.value_type]
    return []


def _structs(kind: types.Type) -> Iterator[type]:
    if isinstance(kind, types.StructType):
        yield kind.cls
    for item in _items(kind):
        yield from _structs(item)


def _range_words(kind: types.Type) -> str:
    match kind:
        case types.IntType() | types.FloatType():
            return _bounds(kind)
        case types.StrType(max_length=int(most)):
            return f"≤ {most} characters"
    words = [_range_words(item) for item in _items(kind)]
    if isinstance(kind, types.VarTupleType) and (kind.min_length or kind.max_length):
        words.append(f"{kind.min_length or 0} … {kind.max_length} entries")
    return "; ".join(dict.fromkeys(filter(None, words)))


def _bounds(kind: types.IntType | types.FloatType) -> str:
    def known(bound: float | None) -> bool:
        return bound is not None and abs(bound) < BOUND_MAX[type(kind)]

    if known(kind.ge) and known(kind.le):
        return f"{kind.ge:g} … {kind.le:g}"
    signs = {">": kind.gt, "≥": kind.ge, "<": kind.lt, "≤": kind.le}
    return ", ".join(f"{sign} {bound:g}" for sign, bound in signs.items() if known(bound))


def _default_words(field: types.Field) -> str:
    if field.required:
        return "required"
    if field.default is msgspec.NODEFAULT and field.default_factory is msgspec.NODEFAULT:
        return "left out"  # the default is msgspec.UNSET
    value = field.default_factory() if field.default is msgspec.NODEFAULT else field.default
    if value is None:
        return "none"
    if isinstance(value, Enum):
        value = value.value
    if isinstance(value, tuple) and any(isinstance(item, msgspec.Struct) for item in value):
        return f"{len(value)} tables"
    return json_words(value)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as a table, whose columns are the keys of the first row."""
    names = list(rows[0])
    lines = [names, ["---"] * len(names), *([escape(cell(row[name])) for name in names] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def cell(value: Any) -> str:
    """A value for people; a list that holds all of jezero's action servers names them, and all others, together."""
    if isinstance(value, list):
        if set(ACTIONS) <= set(value):
            value = [*(name for name in value if name not in action_names()), "actions"]
        return ", ".join(value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def escape(text: str) -> str:
    """Text within a table or a paragraph: `|` and, outside of code, `<` would be taken for Markdown."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part.startswith("`") else part.replace("<", "&lt;") for part in parts).replace("|", "\\|")
