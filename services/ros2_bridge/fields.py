"""The rules by which a field of a goal, a feedback or a result becomes a field in ROS, and back. Needs no ROS.

`deploy/ros2/jezero_interfaces` has the fields of all actions by these rules; the bridge converts by them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import pi
from typing import Any

import msgspec
from msgspec import inspect as types

from jezero.base.frames import enu_from_ned, ned_from_enu, wrap_pi
from jezero.schemas.topics import ACTIONS
from jezero.services.ros2_bridge.geometry import point

ROS_ACTIONS = {name: action for name, action in ACTIONS.items() if action.steered_by is None}
"""The actions of ROS: all but those that a client steers, for which there is `cmd_vel`."""
LEFT_OUT = ("goal_id", "issued_t_ns", "plan_from_ned_m")
"""Fields of a goal that ROS does not have: its goals have ids of their own, and the client sets the time."""
HEADINGS = ("yaw_rad", "angle_rad")
"""Directions in the horizontal plane."""
NED = "_ned_m"
POINT = "geometry_msgs/Point"
TWO, THREE = 2, 3


def _same(value: Any) -> Any:
    return value


def _negative(value: float) -> float:
    return 0.0 - value


def _turned(angle_rad: float) -> float:
    """Clockwise from north, from anticlockwise from east; its own inverse."""
    return wrap_pi(0.5 * pi - angle_rad)


@dataclass(frozen=True)
class Rule:
    """How one kind of field becomes a field in ROS.

    Attributes:
        fits: whether a field of this name and type is of this kind.
        jezero: the kind, for people.
        type: of the field in ROS.
        suffix: end of the field's name, in jezero and in ROS.
        to_ros: converts a value.
        from_ros: converts a value back into what JSON has.
        about: what the value is in ROS, where it is another one than in jezero.
    """

    fits: Callable[[str, types.Type], bool]
    jezero: str
    type: str
    suffix: tuple[str, str] = ("", "")
    to_ros: Callable[[Any], Any] = _same
    from_ros: Callable[[Any], Any] = _same
    about: str = ""

    def ros_name(self, name: str) -> str:
        """Name of a field in ROS."""
        ned, ros = self.suffix
        return name.removesuffix(ned) + ros


def _is_tuple(kind: types.Type, length: int) -> bool:
    return (
        isinstance(kind, types.TupleType)
        and len(kind.item_types) == length
        and all(isinstance(item, types.FloatType) for item in kind.item_types)
    )


def _is_text(kind: types.Type) -> bool:
    return isinstance(kind, types.StrType) or (
        isinstance(kind, types.LiteralType) and all(isinstance(value, str) for value in kind.values)
    )


def _json(value: Any) -> str:
    return msgspec.json.encode(value).decode()


RULES: tuple[Rule, ...] = (
    Rule(lambda name, kind: isinstance(kind, types.BoolType), "true or false", "bool"),
    Rule(lambda name, kind: isinstance(kind, types.IntType), "whole number", "int64"),
    Rule(lambda name, kind: _is_text(kind), "text, or one of several words", "string"),
    Rule(
        lambda name, kind: isinstance(kind, types.FloatType) and name.endswith(f"z{NED}"),
        "height `z_ned_m`, positive down",
        "float64",
        (NED, "_m"),
        _negative,
        _negative,
        "height in metres, positive up",
    ),
    Rule(
        lambda name, kind: isinstance(kind, types.FloatType) and name in HEADINGS,
        f"{' or '.join(f'`{name}`' for name in HEADINGS)}, clockwise from north",
        "float64",
        ("", ""),
        _turned,
        _turned,
        "angle in radians, anticlockwise from east",
    ),
    Rule(lambda name, kind: isinstance(kind, types.FloatType), "any other number", "float64"),
    Rule(
        lambda name, kind: _is_tuple(kind, THREE) and name.endswith(NED),
        "position `x_ned_m`: north, east, down",
        POINT,
        (NED, "_m"),
        lambda v: point(enu_from_ned(v)),
        lambda p: ned_from_enu((p.x, p.y, p.z)),
        "x east, y north, z up, in metres",
    ),
    Rule(
        lambda name, kind: _is_tuple(kind, TWO) and name.endswith(NED),
        "place `x_ned_m`: north and east",
        POINT,
        (NED, "_m"),
        lambda v: point((v[1], v[0], 0.0)),
        lambda p: (p.y, p.x),
        "x east, y north, in metres; z is not used",
    ),
)
"""The rules, of which the first that fits applies."""
AS_JSON = Rule(
    lambda name, kind: True,
    "anything else, such as images or a goal",
    "string",
    ("", "_json"),
    _json,
    about="JSON as jezero has it, with its axes and signs",
)
"""The rule for a field that no other fits."""


@dataclass(frozen=True)
class RosField:
    """A field in ROS.

    Attributes:
        source: its name in jezero.
        rule: by which it is converted.
        many: a sequence, of any length.
        optional: a sequence of at most one: it is empty for none. In JSON "" is none.
        default: value in jezero of a field that is left out; `msgspec.NODEFAULT` for one that must be given.
    """

    source: str
    rule: Rule
    many: bool
    optional: bool
    default: Any

    @property
    def name(self) -> str:
        return self.rule.ros_name(self.source)

    @property
    def type(self) -> str:
        """As in a definition, such as "float64[<=1]"."""
        as_sequence = "[]" if self.many else "[<=1]" if self.optional and self.rule is not AS_JSON else ""
        return self.rule.type + as_sequence

    def to_ros(self, value: Any) -> Any:
        """A value in ROS: numbers, strings, `RosMessage`, and lists of these."""
        if self.rule is AS_JSON:
            return "" if value is None else _json(value)
        if self.many:
            return [self.rule.to_ros(each) for each in value]
        if self.optional:
            return [] if value is None else [self.rule.to_ros(value)]
        return self.rule.to_ros(value)

    def from_ros(self, value: Any) -> Any:
        """A value as JSON has it; `msgspec.UNSET` for one that is left out.

        Raises:
            ValueError: text that should be JSON is none.
        """
        if self.rule is AS_JSON:
            return self._read_json(value)
        if self.many:
            return [self.rule.from_ros(each) for each in value]
        if self.optional:
            return self.rule.from_ros(value[0]) if len(value) else msgspec.UNSET
        return self.rule.from_ros(value)

    def _read_json(self, text: str) -> Any:
        try:
            return msgspec.json.decode(text) if text else msgspec.UNSET
        except msgspec.DecodeError as error:
            raise ValueError(f"{self.name} is not JSON: {error}") from None


@lru_cache
def ros_fields(struct: Any) -> tuple[RosField, ...]:
    """The fields in ROS of a struct of the contract."""
    info = types.type_info(struct)
    assert isinstance(info, types.StructType)
    return tuple(_ros_field(field) for field in info.fields if field.name not in LEFT_OUT)


def _ros_field(field: types.Field) -> RosField:
    kind, name = field.type, field.name
    optional = isinstance(kind, types.UnionType) and kind.includes_none
    if isinstance(kind, types.UnionType):
        kinds = [each for each in kind.types if not isinstance(each, types.NoneType)]
        kind = kinds[0] if len(kinds) == 1 else kind
    many = isinstance(kind, types.VarTupleType) and not optional
    item = kind.item_type if many and isinstance(kind, types.VarTupleType) else kind
    rule = next((rule for rule in RULES if rule.fits(name, item)), AS_JSON)
    return RosField(name, rule, many and rule is not AS_JSON, optional, field.default)


def to_ros(value: msgspec.Struct) -> dict[str, Any]:
    """Fields in ROS of a feedback or a result."""
    return {field.name: field.to_ros(getattr(value, field.source)) for field in ros_fields(type(value))}


def from_ros(struct: Any, message: Any) -> Mapping[str, Any]:
    """Fields of a goal from a message of ROS, as `Vehicle.send` takes them.

    Args:
        struct: type of the goal.
        message: with the fields of `ros_fields(struct)` as attributes.

    Raises:
        ValueError: text that should be JSON is none.
    """
    found = {field.source: field.from_ros(getattr(message, field.name)) for field in ros_fields(struct)}
    return {name: value for name, value in found.items() if value is not msgspec.UNSET}


def interface_name(action: str) -> str:
    """Name of an action's type in ROS: `GoTo` for `go_to`."""
    return "".join(word.capitalize() for word in action.split("_"))
