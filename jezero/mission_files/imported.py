"""A mission that another program's file has become, and its text as a mission file."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from textwrap import indent
from typing import Any

import yaml

from jezero.area_files.polygon import FilePolygon
from jezero.mission_files.goals import HEIGHTS
from jezero.schemas.fence import Fence, Zone

DECIMALS_DEG = 8
"""A millimetre."""
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
        rally_points: names of points at which the vehicle may land.
        fence: the geofence of the other file; None without one.
        notes: a sentence for each part of the other file that the mission has in another way.
        lost: a sentence for each part of the other file that the mission doesn't have.
        home_altitude_m: altitude above sea level of the home position of the other file; None without one.
    """

    name: str
    points: dict[str, Any] = field(default_factory=dict)
    areas: dict[str, Any] = field(default_factory=dict)
    steps: list[dict[str, Any]] = field(default_factory=list)
    rally_points: list[str] = field(default_factory=list)
    fence: Fence | None = None
    notes: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    home_altitude_m: float | None = None

    def to_yaml(self) -> str:
        """Text of the mission file."""
        lines = [f"mission: {_inline(mission_name(self.name))}"]
        if self.points:
            lines += ["points:", *(f"  {name}: {_inline(point)}" for name, point in self.points.items())]
        if self.areas:
            text = yaml.safe_dump(self.areas, sort_keys=False, default_flow_style=None, width=WIDTH, allow_unicode=True)
            lines += ["areas:", indent(text.rstrip(), "  ")]
        if self.rally_points:
            lines.append(f"rally_points: {_inline(self.rally_points)}")
        lines.append("steps:")
        for name, fields in (next(iter(step.items())) for step in self.steps):
            lines.append(f"  - {name}" if fields == {} else f"  - {name}: {_inline(fields)}")
        return "\n".join([*lines, ""])

    @property
    def has_heights_above_sea_level(self) -> bool:
        """Whether the vehicle's origin needs an altitude to fly the mission."""
        return any(isinstance(up, dict) for up in self._heights())

    @property
    def some_origin_deg(self) -> tuple[float, float, float]:
        """An origin around which the mission can be read: at its first place, below all its heights."""
        places: list[list[float]] = [point["degrees"] for point in self.points.values()]
        places += [area["degrees"][0] for area in self.areas.values()]
        heights_m = [up["amsl_m"] for up in self._heights() if isinstance(up, dict)]
        latitude_deg, longitude_deg = places[0] if places else (0.0, 0.0)
        altitude_m = 0.0 if self.home_altitude_m is None else self.home_altitude_m
        return latitude_deg, longitude_deg, min(altitude_m, *heights_m) if heights_m else altitude_m

    def _heights(self) -> list[Any]:
        goals = [fields for step in self.steps for fields in step.values() if isinstance(fields, dict)]
        return [fields.get(name) for fields in (*self.points.values(), *goals) for name in HEIGHTS]


def fence_yaml(fence: Fence) -> str:
    """Text of the fence file of a fence in degrees."""
    lines = [f"fence: {_inline(fence.name)}", "degrees: true"]
    if fence.keep_in is not None:
        lines.append(f"keep_in: {_inline({fence.keep_in.name: _corners(fence.keep_in)})}")
    if fence.keep_out:
        lines += ["keep_out:", *(f"  {_inline(zone.name)}: {_inline(_corners(zone))}" for zone in fence.keep_out)]
    return "\n".join([*lines, ""])


def _corners(zone: Zone) -> list[list[float]]:
    return [
        [round(latitude_deg, DECIMALS_DEG), round(longitude_deg, DECIMALS_DEG)]
        for latitude_deg, longitude_deg in zone.corners_deg
    ]


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
