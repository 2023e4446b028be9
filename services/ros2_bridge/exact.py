"""The rules by which a whole message of jezero becomes one of `jezero_interfaces`, and back without any loss.

Its fields have the names, axes and units of jezero: what a message of ROS that everybody knows can't carry, such as
the anchor of a range or the resets of a position. Needs no ROS.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import msgspec
from msgspec import inspect as types

from jezero.services.ros2_bridge.geometry import RosMessage, time, time_ns

PACKAGE = "jezero_interfaces"
TIME_FIELD, STAMP = "t_ns", "stamp"
"""The time of a message in jezero, and in ROS."""
PLAIN: dict[type, tuple[str, Callable[[Any], Any]]] = {
    types.BoolType: ("bool", bool),
    types.IntType: ("int64", int),
    types.FloatType: ("float64", float),
    types.StrType: ("string", str),
}
"""Type in ROS of plain values, and what makes such a value of one of numpy."""


class NotExactError(TypeError):
    """A field has a type for which there is no rule."""


@dataclass(frozen=True)
class ExactField:
    """A field in ROS.

    Attributes:
        source: its name in jezero.
        name: its name in ROS.
        type: as in a definition, such as "float64[3]".
        struct: struct of its values, where these are structs.
        many: whether it has several values.
        optional: a sequence that is empty for none.
        to_ros: converts one value.
        from_ros: converts one value back into what JSON has.
    """

    source: str
    name: str
    type: str
    struct: Any
    many: bool
    optional: bool
    to_ros: Callable[[Any], Any]
    from_ros: Callable[[Any], Any]

    def value_to_ros(self, value: Any) -> Any:
        """The value in ROS: numbers, texts, `RosMessage`, and lists of these."""
        if value is None:
            return []
        if self.many:
            return [self.to_ros(each) for each in value]
        return [self.to_ros(value)] if self.optional else self.to_ros(value)

    def value_from_ros(self, value: Any) -> Any:
        """The value as JSON has it."""
        if not (self.many or self.optional):
            return self.from_ros(value)
        values = [self.from_ros(each) for each in value]
        if self.optional and not values:
            return None
        return values if self.many else values[0]


@lru_cache
def exact_fields(struct: Any) -> tuple[ExactField, ...]:
    """The fields in ROS of a struct of the contract.

    Raises:
        NotExactError: a field of the struct has a type for which there is no rule.
    """
    info = types.type_info(struct)
    assert isinstance(info, types.StructType)
    return tuple(_field(field.name, field.type) for field in info.fields)


def _field(name: str, kind: types.Type) -> ExactField:
    if name == TIME_FIELD:
        return ExactField(name, STAMP, "builtin_interfaces/Time", None, False, False, time, time_ns)
    optional = isinstance(kind, types.UnionType) and kind.includes_none
    if isinstance(kind, types.UnionType):
        kinds = [each for each in kind.types if not isinstance(each, types.NoneType)]
        kind = kinds[0] if len(kinds) == 1 else kind
    length: int | None = None
    many = isinstance(kind, types.TupleType | types.VarTupleType)
    if isinstance(kind, types.TupleType):
        length, kind = len(kind.item_types), kind.item_types[0]
    elif isinstance(kind, types.VarTupleType):
        kind = kind.item_type
    bound = f"[<={length or 1}]" if optional else f"[{length or ''}]" if many else ""
    ros, struct, to_ros, from_ros = _rule(name, kind)
    return ExactField(name, name, ros + bound, struct, many, optional, to_ros, from_ros)


def _rule(name: str, kind: types.Type) -> tuple[str, Any, Callable[[Any], Any], Callable[[Any], Any]]:
    """Type in ROS of one value, its struct, and the conversions there and back."""
    if isinstance(kind, types.StructType):
        struct = kind.cls
        return struct.__name__, struct, to_exact, lambda part: _values(struct, part)
    if type(kind) in PLAIN:
        ros, convert = PLAIN[type(kind)]
        return ros, None, convert, convert
    raise NotExactError(f"{name}: there is no rule for {kind}")


def type_name(struct: Any) -> str:
    """Type in ROS of a struct, such as "jezero_interfaces/msg/Uwb"."""
    return f"{PACKAGE}/msg/{struct.__name__}"


def to_exact(message: msgspec.Struct) -> RosMessage:
    """A message of jezero in ROS."""
    fields = {f.name: f.value_to_ros(getattr(message, f.source)) for f in exact_fields(type(message))}
    return RosMessage(type_name(type(message)), fields)


def from_exact(struct: Any, message: Any) -> Any:
    """A message of jezero.

    Args:
        struct: its type.
        message: with the fields of `exact_fields(struct)` as attributes.

    Raises:
        ValueError: a value is out of its range.
    """
    return msgspec.convert(_values(struct, message), struct)


def _values(struct: Any, message: Any) -> dict[str, Any]:
    return {f.source: f.value_from_ros(getattr(message, f.name)) for f in exact_fields(struct)}


def with_parts(structs: Iterable[Any]) -> dict[str, Any]:
    """Structs by their names in ROS, with the structs inside of them."""
    found: dict[str, Any] = {}
    for struct in structs:
        parts = (field.struct for field in exact_fields(struct) if field.struct is not None)
        found |= with_parts(parts) | {struct.__name__: struct}
    return found


def definition(struct: Any) -> str:
    """The definition of a message in ROS, without comments."""
    return "".join(f"{field.type} {field.name}\n" for field in exact_fields(struct))
