"""Forms for goals, from the JSON Schema that an action publishes: fields with units, ranges and defaults.

A goal takes two clicks: the first one plans it, the second one confirms what it would take.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, degrees, isfinite, radians
from typing import Any, Literal

from jezero.base.mistakes import missing, out_of_range, wrong_type
from jezero.schemas.actions import PlanReply
from jezero.services.ground_station.words import DEGREES, UNITS, duration, in_words, label_of

Kind = Literal["number", "integer", "switch", "choice", "choices", "vector", "area", "areas"]
LEFT_OUT = frozenset(
    {
        "goal_id", "issued_t_ns", "on_client_loss", "plan_id", "first_picture", "origin_deg", "plan_from_ned_m",
        "rally_points_ned_m", "charge", "charge_per_s",
    }
)  # fmt: skip
"""Fields that the ground station, the server, or the mission service fills in."""
BOUND_MAX = 1e4
"""Bounds from here on only keep out garbage such as infinity, so that no form shows them."""
CORNERS_MIN = 3
HEIGHT = "height"
AXES = ("north", "east", HEIGHT)
Z_NAMES = ("z_ned_m",)
AREA_WORDS: Mapping[str, tuple[str, ...]] = {
    "area": ("area", "polygon", "corner", "corners"),
    "areas": ("hole", "holes"),
}
"""Words of refusals that are about an area."""
CONFIRMATION_TIMEOUT_S = 60.0
"""A plan that is older may not hold any more: the vehicle has moved, and its battery is emptier."""
_IS_UP = re.compile(r"[;,] (?:a )?negative (?:z )?is up")
_ENTRY = re.compile(r"^ +(\w+): (.*(?:\n {9,}.*)*)", re.MULTILINE)


@dataclass(frozen=True, kw_only=True)
class FormField:
    """One field of a form.

    Attributes:
        name: name of the goal's field.
        label: its name for people, without frame and unit.
        unit: unit of a number, "" without one.
        kind: what is typed: a number, a switch, one or several of `choices`, numbers along the axes, or areas from the
            map.
        required: the goal needs it.
        default: value of a field that is left out; None lets the server choose.
        minimum: smallest number; None without a bound.
        maximum: largest number; None without a bound.
        choices: the values of one choice or of several.
        axes: names of a vector's numbers; the last one of a point in space is its height.
        help: what it means.
    """

    name: str
    label: str
    unit: str
    kind: Kind
    required: bool
    default: Any = None
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    axes: tuple[str, ...] = ()
    help: str = ""

    @property
    def has_height(self) -> bool:
        """Whether a height, positive up, is typed where the goal has a z, positive down."""
        return self.axes[-1:] == (HEIGHT,) or (self.kind == "number" and self.name.endswith(Z_NAMES))

    @property
    def in_radians(self) -> bool:
        """Whether the goal has radians where degrees are typed."""
        return self.unit == DEGREES and self.name.endswith("_rad")

    @property
    def range_words(self) -> str:
        """The range of a number, e.g. "0 to 0.95", or ""."""
        if self.minimum is not None and self.maximum is not None:
            return f"{self.minimum:g} to {self.maximum:g}"
        if self.minimum is not None:
            return f"from {self.minimum:g}"
        return "" if self.maximum is None else f"to {self.maximum:g}"


def form_of(schema: Mapping[str, Any]) -> tuple[str, list[FormField]]:
    """What a goal does in one sentence, and the fields of its form.

    Args:
        schema: the goal's JSON Schema, from the action's description. A field that no form can show is left out when
            it has a default.
    """
    struct = _resolved(schema, schema)
    text = struct.get("description", "")
    meanings = {name: _meaning(text) for name, text in _ENTRY.findall(text)}
    fields = []
    for name, kind_schema in struct["properties"].items():
        if name in LEFT_OUT:
            continue
        required = name in struct.get("required", ())
        field = _field(name, kind_schema, schema, required, meanings.get(name, ""))
        if field is not None:
            fields.append(field)
    return text.split("\n")[0], fields


def _meaning(text: str) -> str:
    """What a field means, for a person who types heights."""
    words = _IS_UP.sub("", " ".join(text.split())).replace("`", "")
    return in_words(re.sub(r"\bz\b", HEIGHT, words))


def _resolved(part: Mapping[str, Any], schema: Mapping[str, Any]) -> Mapping[str, Any]:
    """A part of a schema without references and without the alternative `null`."""
    if "$ref" in part:
        return _resolved(schema["$defs"][part["$ref"].rpartition("/")[2]], schema)
    if "anyOf" in part:
        return _resolved(next(kind for kind in part["anyOf"] if kind.get("type") != "null"), schema)
    return part


def _field(
    name: str, part: Mapping[str, Any], schema: Mapping[str, Any], required: bool, meaning: str
) -> FormField | None:
    kind_schema = _resolved(part, schema)
    words = name.split("_")
    unit = UNITS.get(words[-1], "") if len(words) > 1 else ""
    common: dict[str, Any] = {
        "name": name, "label": label_of(name), "required": required, "default": part.get("default"), "help": meaning,
    }  # fmt: skip
    items = _resolved(kind_schema.get("items") or {}, schema)
    if choices := tuple(str(choice) for choice in kind_schema.get("enum") or items.get("enum") or ()):
        return FormField(**common, unit="", kind="choice" if "enum" in kind_schema else "choices", choices=choices)
    match kind_schema.get("type"):
        case "boolean":
            return FormField(**common, unit="", kind="switch")
        case "number" | "integer" as kind:
            low, high = (_bound(kind_schema.get(bound), unit, name) for bound in ("minimum", "maximum"))
            if name.endswith(Z_NAMES):  # bounds of a z don't bound the height above the start
                low = high = None
                common["default"] = None if common["default"] is None else 0.0 - common["default"]
            if common["default"] is not None and name.endswith("_rad"):
                common["default"] = degrees(common["default"])
            return FormField(**common, unit=unit, kind=kind, minimum=low, maximum=high)
        case "array" if "prefixItems" in kind_schema:
            axes = AXES[: len(kind_schema["prefixItems"])]
            return FormField(**common, unit=unit, kind="vector", axes=axes)
        case "array":
            return FormField(**common, unit=unit, kind="area" if "prefixItems" in items else "areas")
    return None


def _bound(bound: float | None, unit: str, name: str) -> float | None:
    if bound is None or abs(bound) >= BOUND_MAX:
        return None
    return float(round(degrees(bound))) if unit == DEGREES and name.endswith("_rad") else bound


def goal_from(
    fields: Sequence[FormField], values: Mapping[str, Any], start_z_ned_m: float = 0.0
) -> tuple[dict[str, Any], dict[str, str]]:
    """The goal's fields from what was typed, and a sentence for each field that is wrong.

    Args:
        values: by field; numbers as numbers or text, a vector as a list of them, None or "" for an empty field.
        start_z_ned_m: z, in the goal's frame, of the place above which heights are typed.
    """
    goal: dict[str, Any] = {}
    problems: dict[str, str] = {}
    for field in fields:
        try:
            value = _value(field, values.get(field.name))
        except ValueError as error:
            problems[field.name] = str(error)
            continue
        if value is not None:
            goal[field.name] = _ned(field, value, start_z_ned_m)
        elif field.required or (field.name in values and _has_number(field)):
            problems[field.name] = _missing(field)
    return goal, problems


def _ned(field: FormField, value: Any, start_z_ned_m: float) -> Any:
    """A value with z where its height was typed."""
    if not field.has_height:
        return value
    if field.kind == "vector":
        return [*value[:-1], round(start_z_ned_m - value[-1], 3)]
    return round(start_z_ned_m - value, 3)


def _has_number(field: FormField) -> bool:
    """Whether a field that is left out stands for a number: emptied by a person, it must not fly with that."""
    return field.kind in ("number", "integer") and field.default is not None


def _missing(field: FormField) -> str:
    if field.kind == "area":
        return "Draw the area on the map: click its corners"
    return missing(field.label)


def _value(field: FormField, typed: Any) -> Any:
    """The value of a field; None for an empty one.

    Raises:
        ValueError: what was typed is no such value; the message says what is.
    """
    if field.kind in ("switch", "choice", "choices"):
        return typed or None if field.kind == "choices" else typed
    if field.kind == "vector":
        return _vector(field, list(typed or ()))
    if typed in (None, "") or (field.kind in ("area", "areas") and not typed):
        return None
    if field.kind == "area" and len(typed) < CORNERS_MIN:
        raise ValueError(f"the area has {len(typed)} corners; it needs three at least")
    if field.kind in ("area", "areas"):
        return [list(part) for part in typed]
    number = _number(field, typed)
    if field.kind == "integer" and number != int(number):
        raise ValueError(f"{field.label}: {wrong_type('a whole number', f'{number:g}')}")
    if field.in_radians:
        return radians(number)
    return int(number) if field.kind == "integer" else number


def _vector(field: FormField, parts: list[Any]) -> list[float] | None:
    if all(part in (None, "") for part in parts):
        return None
    if any(part in (None, "") for part in parts):
        raise ValueError(f"{field.label} needs all of {', '.join(field.axes)}")
    return [_number(field, part) for part in parts]


def _number(field: FormField, typed: Any) -> float:
    try:
        number = float(typed)
    except (TypeError, ValueError):
        kind = "a whole number" if field.kind == "integer" else "a number"
        raise ValueError(f"{field.label}: {wrong_type(kind, 'a text')}") from None
    low = field.minimum is not None and number < field.minimum
    high = field.maximum is not None and number > field.maximum
    if not isfinite(number) or low or high:
        whole = field.kind == "integer"
        raise ValueError(f"{field.label}: {out_of_range(field.minimum, field.maximum, whole=whole)}")
    return number


def named_field(reason: str, fields: Sequence[FormField]) -> str:
    """Name of the field that a refusal is about; "" when it names none.

    A refusal names a field as the decoder does (`$.altitude_m`), by its name, or by its label in words: "speed 20 m/s
    is not within 0.1 to 10 m/s". The word that stands first decides.
    """
    found: list[tuple[int, int, str]] = []
    for field in fields:
        for word in {field.name, field.label, *(("z",) if field.has_height else ()), *AREA_WORDS.get(field.kind, ())}:
            match = re.search(rf"(?<![\w.]){re.escape(word)}(?![\w])", reason.replace("$.", " "))
            if match is not None:
                found.append((match.start(), -len(word), field.name))
    return min(found)[2] if found else ""


@dataclass(frozen=True)
class Confirmation:
    """A goal that was planned and waits for the second click.

    Attributes:
        goal: its fields, as they were planned.
        typed: what was typed for it. The goal can't be compared: its z follows the estimate of the start's height.
        plan: its plan.
        t_s: time of the plan, on the clock that the caller uses.
    """

    goal: Mapping[str, Any]
    typed: Mapping[str, Any]
    plan: PlanReply
    t_s: float

    def holds_for(self, typed: Mapping[str, Any], now_s: float) -> bool:
        """Whether the second click may fly the plan of what the form has now."""
        return typed == self.typed and not self.is_old(now_s)

    def is_old(self, now_s: float) -> bool:
        """Whether it is too late for the second click."""
        return now_s - self.t_s > CONFIRMATION_TIMEOUT_S

    def words(self, start_z_ned_m: float) -> str:
        """What the goal would take, e.g. "Confirm: 34 s, 41 m, 5 % of the battery, up to 6 m".

        Args:
            start_z_ned_m: z of the place from which heights are counted.
        """
        plan, parts = self.plan, []
        if plan.duration_s is not None:
            parts.append(duration(plan.duration_s))
        if plan.distance_m is not None:
            parts.append(f"{plan.distance_m:.0f} m")
        if plan.battery_used is not None:
            parts.append(f"{ceil(round(100.0 * plan.battery_used, 3))} % of the battery")
        if plan.path_ned_m:
            height_max_m = start_z_ned_m - min(point[2] for point in plan.path_ned_m)
            parts.append(f"up to {round(height_max_m, 1):g} m")
        return f"Confirm: {', '.join(parts)}" if parts else "Confirm"
