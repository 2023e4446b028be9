"""Extreme messages: valid ones with a number at the end of its range, at zero, or tiny."""

import math
from collections.abc import Iterator
from typing import Any

import msgspec
from msgspec import inspect

TINY = 1e-300
Change = tuple[tuple[str | int, ...], Any]
"""Path to a value within a message as plain dictionaries and lists, and the value that replaces the one there."""


def extreme_messages(kind: Any, example: bytes, *, keep: tuple[str, ...] = ("t_ns", "epoch_id")) -> Iterator[bytes]:
    """Valid variants of a message of a topic, each with one extreme field.

    Args:
        kind: type of the message.
        example: the encoded message, without an attachment.
        keep: fields that stay as they are.
    """
    plain, decoder = msgspec.json.decode(example), msgspec.json.Decoder(kind)
    for path, value in _changes(inspect.type_info(kind)):
        if path[0] in keep:
            continue
        data = msgspec.json.encode(_changed(plain, path, value))
        try:
            decoder.decode(data)
        except msgspec.ValidationError:
            continue
        yield data


def _changed(plain: Any, path: tuple[str | int, ...], value: Any) -> Any:
    """Copy with another value at a path; the value itself where the path leads nowhere."""
    if not path:
        return value
    first, rest = path[0], path[1:]
    if isinstance(plain, dict) and (not rest or plain.get(str(first)) is not None):
        return {**plain, first: _changed(plain.get(str(first)), rest, value)}
    if isinstance(plain, list) and isinstance(first, int) and first < len(plain):
        return [*plain[:first], _changed(plain[first], rest, value), *plain[first + 1 :]]
    return plain


def _changes(kind: Any, deep: int = 0) -> Iterator[Change]:
    if isinstance(kind, inspect.StructType) and deep < 4:
        for field in kind.fields:
            yield from (((field.encode_name, *path), value) for path, value in _changes(field.type, deep + 1))
    elif isinstance(kind, inspect.UnionType):
        for part in kind.types:
            yield from _changes(part, deep)
    elif isinstance(kind, inspect.TupleType):
        yield from _changes_of_items(list(kind.item_types), deep)
    elif isinstance(kind, inspect.VarTupleType):
        yield (), []
        for path, value in _changes(kind.item_type, deep):
            yield (0, *path), value
    else:
        yield from (((), value) for value in _values(kind))


def _changes_of_items(items: list[Any], deep: int) -> Iterator[Change]:
    """All items of a tuple at once, then one at a time."""
    if len({str(item) for item in items}) == 1:
        for value in _values(items[0]):
            yield (), [value] * len(items)
    for number, item in enumerate(items[:6]):
        yield from (((number, *path), value) for path, value in _changes(item, deep))


def _values(kind: Any) -> list[Any]:
    """Extreme values of one field."""
    values: list[Any] = []
    if isinstance(kind, inspect.NoneType):
        values = [None]
    elif isinstance(kind, inspect.BoolType):
        values = [False, True]
    elif isinstance(kind, inspect.StrType):
        values = ["", "x" * (kind.max_length or 300)]
    elif isinstance(kind, inspect.LiteralType):
        values = list(kind.values)
    elif isinstance(kind, inspect.EnumType):
        values = [item.value for item in kind.cls]
    elif isinstance(kind, inspect.IntType):
        values = [-(2**62) if kind.ge is None else kind.ge, 0, 1, 2**62 if kind.le is None else kind.le]
    elif isinstance(kind, inspect.FloatType):
        low = kind.ge if kind.gt is None else math.nextafter(kind.gt, math.inf)
        high = kind.le if kind.lt is None else math.nextafter(kind.lt, -math.inf)
        values = [-1e308 if low is None else low, 0.0, TINY, -TINY, 1e-9, 1.0, 1e308 if high is None else high]
    return values


def example_of(kind: Any) -> bytes:
    """A valid message of a type, in which every number is 1 or near it, with all optional fields but None."""
    return msgspec.json.encode(_example(inspect.type_info(kind)))


def _example(kind: Any) -> Any:
    value: Any = "a"
    if isinstance(kind, inspect.StructType):
        value = {} if kind.tag is None else {kind.tag_field: kind.tag}
        value |= {field.encode_name: _example(field.type) for field in kind.fields if _is_given(field)}
        value |= {field.name: (1.0, 0.0, 0.0, 0.0) for field in kind.fields if field.name.startswith("q_")}
    elif isinstance(kind, inspect.UnionType):
        value = _example(next(part for part in kind.types if not isinstance(part, inspect.NoneType)))
    elif isinstance(kind, inspect.TupleType):
        value = [_example(item) for item in kind.item_types]
    elif isinstance(kind, inspect.VarTupleType):
        value = [_example(kind.item_type)] * max(1, kind.min_length or 0)
    elif isinstance(kind, inspect.FloatType | inspect.IntType):
        number = 1 if kind.le is None else min(1, kind.le)
        value = number if kind.ge is None else max(number, kind.ge)
    elif isinstance(kind, inspect.DictType | inspect.AnyType):
        value = {}
    elif not isinstance(kind, inspect.StrType):
        value = _values(kind)[-1]
    return value


def _is_given(field: inspect.Field) -> bool:
    """Whether a field is in an example: a required one, and one that may be left out but is worth a lie."""
    return field.required or field.default is None
