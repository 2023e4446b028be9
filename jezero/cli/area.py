"""The area of a coverage on the command line: its options, its file, and the world's origin that places it."""

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

if TYPE_CHECKING:
    from jezero.area_files import FilePolygon
    from jezero.schemas.goals import AreaCoverageGoal, Corners
    from jezero.schemas.state import Odometry

ROUTER_WAIT_S = 0.5
"""Longest wait for a stack that could make a plan without a flight."""


@dataclass(frozen=True)
class Origin:
    """The world's origin, and where it is known from.

    Attributes:
        position_deg: latitude and longitude.
        source: for people.
        altitude_m: above sea level; None where it is not known.
    """

    position_deg: tuple[float, float]
    source: str
    altitude_m: float | None = None

    @property
    def origin_deg(self) -> tuple[float, ...]:
        """Latitude and longitude, and the altitude where it is known."""
        return self.position_deg if self.altitude_m is None else (*self.position_deg, self.altitude_m)

    def __str__(self) -> str:
        return "{:.6f}, {:.6f}".format(*self.position_deg)


@dataclass(frozen=True)
class CoverageRequest:
    """A coverage whose area is not placed in the world yet.

    Attributes:
        polygon: the area as its file has it.
        fields: the goal's other fields.
    """

    polygon: "FilePolygon"
    fields: dict[str, Any]

    def goal(self, origin: Origin | None) -> "AreaCoverageGoal":
        """Place the area. Without an origin, it must be in metres."""
        from jezero.area_files import AreaFileError, place
        from jezero.schemas.goals import AreaCoverageGoal

        try:
            area = place(self.polygon, None if origin is None else origin.position_deg)
        except AreaFileError as error:
            raise click.ClickException(str(error)) from None
        return AreaCoverageGoal(
            polygon_ned_m=area.polygon_ned_m, holes_ned_m=area.holes_ned_m, origin_deg=area.origin_deg, **self.fields
        )


def area_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that name an area."""
    for option in (
        click.option("--origin", nargs=2, type=float, callback=checked_origin, metavar="LAT LON", help=ORIGIN_HELP),
        click.option("--metres", is_flag=True, help="The file is in metres: [north, east], or by its headings."),
        click.option("--feature", metavar="NAME|N", help="The area of this name or number, if the file has several."),
        click.option("--polygon", "file", type=FILE, help="File of the area, see above."),
    ):
        command = option(command)
    return command


FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
ORIGIN_HELP = "Degrees of the world's origin for --plan-only without a stack [the simulator's]."


def checked_origin(
    context: click.Context, parameter: click.Parameter, value: tuple[float, float] | None
) -> Origin | None:
    if value is None:
        return None
    if not (all(map(isfinite, value)) and abs(value[0]) <= 90.0 and abs(value[1]) <= 180.0):
        raise click.BadParameter("expected a latitude within ±90 and a longitude within ±180 degrees")
    return Origin(value, "--origin")


def read_polygon_file(file: Path, feature: str | None, *, metres: bool, frame: str) -> "FilePolygon":
    """Read the polygon of an area; in the rover's frame it must be in metres."""
    from jezero.area_files import AreaFileError, read_polygon

    try:
        polygon = read_polygon(file, feature=feature, metres=metres)
    except AreaFileError as error:
        raise click.ClickException(str(error)) from None
    if frame == "rover" and not polygon.in_metres:
        raise click.ClickException(
            f"{polygon.place} is in degrees, which are never relative to the rover: leave out `rover`, or add --metres "
            "to a file in metres"
        )
    return polygon


def vehicle_origin(odometry: "Odometry | None") -> Origin | None:
    """The world's origin as the vehicle's autopilot has it; None until it sends it."""
    if odometry is None or odometry.origin_deg is None:
        return None
    return Origin(odometry.origin_deg[:2], "the vehicle's", odometry.origin_deg[2])


def around_origin(goal: "AreaCoverageGoal", origin: Origin | None) -> "AreaCoverageGoal":
    """The goal of an earlier flight around the vehicle's present origin, which an autopilot places where it starts.

    The area is moved as a whole, so that it keeps its plan and the numbers of its images. An area in metres stays.
    """
    from jezero.frames import ned_from_geodetic

    if origin is None or goal.origin_deg is None or goal.origin_deg == origin.position_deg:
        return goal
    by_north_m, by_east_m, _ = ned_from_geodetic((*goal.origin_deg, 0.0), (*origin.position_deg, 0.0))

    def moved(corners_m: "Corners") -> "Corners":
        return tuple((north_m + by_north_m, east_m + by_east_m) for north_m, east_m in corners_m)

    return msgspec.structs.replace(
        goal,
        origin_deg=origin.position_deg,
        polygon_ned_m=moved(goal.polygon_ned_m),
        holes_ned_m=tuple(map(moved, goal.holes_ned_m)),
        start_ned_m=None if goal.start_ned_m is None else moved((goal.start_ned_m,))[0],
    )


def place_in_words(goal: "AreaCoverageGoal", origin: Origin | None) -> str:
    """Where the area of a goal lies."""
    norths_m, easts_m = zip(*goal.polygon_ned_m, strict=True)
    ends_m = (round(end_m) for end_m in (min(norths_m), max(norths_m), min(easts_m), max(easts_m)))
    where = "north {} to {} m, east {} to {} m".format(*ends_m)
    if goal.frame == "rover":
        return f"{where} from the rover's platform"
    at = "" if origin is None else f" at {origin} ({origin.source})"
    return f"{where} from the world's origin{at}"


def simulator_origin() -> Origin:
    """The origin of the simulator's world, for plans that no stack flies."""
    from jezero.runtime.config import load_config
    from jezero.services.simulator.config import SimulatorConfig

    latitude_deg, longitude_deg, altitude_m = load_config(SimulatorConfig, "simulator").origin.origin_deg
    return Origin((latitude_deg, longitude_deg), "the simulator's settings", altitude_m)
