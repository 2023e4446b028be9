"""A mission that another program's file has become, and its text as a mission file."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from textwrap import indent
from typing import Any

import yaml

from jezero.area_files.polygon import FilePolygon

WIDTH, LINE_MAX = 110, 1_000_000
NAME_MAX = 64


@dataclass
class ImportedMission:
    """Parts of a mission file.

    Attributes:
        name: name of the mission.
        points: points by name, as a mission file has them.
        areas: areas by name, as a mission file has them.
        steps: steps, each a name with its fields.
        notes: a sentence for each part of the other file that the mission doesn't have, or has in another way.
    """

    name: str
    points: dict[str, Any] = field(default_factory=dict)
    areas: dict[str, Any] = field(default_factory=dict)
    steps: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def to_yaml(self) -> str:
        """Text of the mission file."""
        lines = [f"mission: {_inline(mission_name(self.name))}"]
        if self.points:
            lines += ["points:", *(f"  {name}: {_inline(point)}" for name, point in self.points.items())]
        if self.areas:
            text = yaml.safe_dump(self.areas, sort_keys=False, default_flow_style=None, width=WIDTH, allow_unicode=True)
            lines += ["areas:", indent(text.rstrip(), "  ")]
        lines.append("steps:")
        for name, fields in (next(iter(step.items())) for step in self.steps):
            lines.append(f"  - {name}" if fields == {} else f"  - {name}: {_inline(fields)}")
        return "\n".join([*lines, ""])


def _inline(value: Any) -> str:
    """A value on one line."""
    text = str(yaml.safe_dump(value, sort_keys=False, default_flow_style=True, width=LINE_MAX, allow_unicode=True))
    return text.removesuffix("...\n").strip()


def mission_name(text: str) -> str:
    """A name that a mission may have, close to a text."""
    kept = "".join(letter if letter.isascii() and (letter.isalnum() or letter in "_-.") else "-" for letter in text)
    return kept[:NAME_MAX] or "mission"


def import_polygons(polygons: Sequence[FilePolygon], name: str, altitude_m: float, overlap: float) -> ImportedMission:
    """Make a mission of areas: a takeoff, a coverage of each, and a landing on the rover.

    Args:
        polygons: the areas, in the order in which they are flown.
        altitude_m: altitude of the coverages over the take-off point.
        overlap: fraction of each image that the next one, and that of the next line, shows again.
    """
    made = ImportedMission(name)
    made.steps.append({"takeoff": {"altitude_m": altitude_m}})
    for number, polygon in enumerate(polygons, 1):
        area = mission_name(polygon.name).strip("-") or f"area_{number}"
        area = f"{area}_{number}" if area in made.areas else area
        outline, *holes = ([list(corner) for corner in ring] for ring in polygon.rings)
        if polygon.in_metres:
            raise ValueError("polygons of a mission are in degrees")
        made.areas[area] = {"degrees": outline} | ({"holes": holes} if holes else {})
        fields = {"polygon_ned_m": area, "z_ned_m": -altitude_m, "overlap": overlap, "sidelap": overlap}
        made.steps.append({"area_coverage": fields})
    made.steps.append({"land_on_spot": {}})
    return made
