"""`jezero uwb`: what the UWB ranges of a vehicle that stands still are worth, and where the anchors are."""

import csv
import sys
import time
from math import dist
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jezero.base.files import NOT_UTF8
from jezero.cli.options import FINITE, NUMBERS, CommandGroup, FiniteRange, common_options
from jezero.cli.terminal import Printer, connected, print_table

if TYPE_CHECKING:
    from jezero.base.frames import Vec3
    from jezero.client import Vehicle
    from jezero.schemas.sensors import Uwb
    from jezero.services.uwb.statistics import AnchorStatistics
    from jezero.services.uwb.survey import Located

NO_RANGES = 3
"""Exit code without any range."""
STD_WARN_M = 0.05
"""An anchor whose place is less certain needs more places of the tag."""
RESIDUAL_WARN_M = 0.1
SECONDS = click.option("--seconds", type=FiniteRange(1.0, 3600.0), default=10.0, show_default=True,
                       help="How long to measure.")  # fmt: skip
POINT = (FINITE, FINITE, FINITE)


@click.group(cls=CommandGroup)
def uwb() -> None:
    """Test the UWB ranges, and find the places of the anchors.

    Places are metres forward, right and down from the middle of the rover's platform. The place of the vehicle's tag is
    that of its antenna.
    """


@uwb.command(context_settings=NUMBERS)
@SECONDS
@click.option("--at", type=POINT, metavar="F R D", help="Place of the tag, for the bias of each anchor.")
@common_options
def test(seconds: float, at: "Vec3 | None", vehicle: str, router: str, as_json: bool) -> None:
    """Show what the ranges of each anchor are worth.

    Rate, spread and outliers, and with --at the bias. Vehicle and rover stand still meanwhile. A bias of one anchor
    says that its place in vehicle.toml is wrong, or that something is in the way; a bias of all that the module needs
    its antenna delay set.
    """
    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig

    printer = Printer(as_json)
    places = load_config(VehicleConfig, "vehicle").uwb.pos_anchors_rover_body_m
    with connected(vehicle, router, printer) as uav:
        found = _measured(uav, seconds)
    rows: list[tuple[str, ...]] = [("anchor", "ranges/s", "median m", "spread m", "outliers", "bias m")]
    for anchor in sorted({*found, *range(len(places))}):
        if (each := found.get(anchor)) is None:
            rows.append((str(anchor), "none", "-", "-", "-", "-"))
            printer_row = {"anchor": anchor, "count": 0}
        else:
            bias_m = None if at is None or anchor >= len(places) else each.median_m - dist(at, places[anchor])
            share = f"{each.outliers} of {each.count}"
            bias = "-" if bias_m is None else f"{bias_m:+.3f}"
            rows.append((str(anchor), f"{each.rate_hz:.1f}", f"{each.median_m:.3f}", f"{each.std_m:.3f}", share, bias))
            printer_row = {"anchor": anchor, "count": each.count, "rate_hz": each.rate_hz, "median_m": each.median_m,
                           "std_m": each.std_m, "outliers": each.outliers, "bias_m": bias_m}  # fmt: skip
        if as_json:
            printer.event("anchor", "", **printer_row)
    if not as_json:
        print_table(rows)
    if not found:
        _fail_without_ranges(printer)


@uwb.command(context_settings=NUMBERS)
@click.option("--place", "places", type=POINT, multiple=True, metavar="F R D",
              help="A place of the tag, measured by hand; four or more.")  # fmt: skip
@click.option("--between", type=click.Path(path_type=Path, exists=True, dir_okay=False),
              help="File of ranges between anchors: lines such as 0,1,0.91.")  # fmt: skip
@click.option("--known", type=click.IntRange(0, 63), multiple=True,
              help="Number of an anchor whose place in vehicle.toml was measured by hand; repeatable.")  # fmt: skip
@SECONDS
@common_options
def survey(
    places: tuple["Vec3", ...], between: Path | None, known: tuple[int, ...], seconds: float,
    vehicle: str, router: str, as_json: bool,
) -> None:  # fmt: skip
    """Find the places of the anchors from ranges.

    They are printed as vehicle.toml has them.

    You measure by hand, with a tape, where you hold the tag: at four places or more, better eight, around the platform
    at two heights that differ by a metre, each given by --place. The command asks for the tag at one after the other.

    Or you measure the places of three anchors or more, which do not stand on one line, write them into vehicle.toml and
    name them by --known; ranges between them and the others come from --between. Anchors that stand in one plane need
    --place too.
    """
    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig
    from jezero.services.uwb.survey import PLACES_MIN, Sighting, locate

    anchors = dict(enumerate(load_config(VehicleConfig, "vehicle").uwb.pos_anchors_rover_body_m))
    if strange := [each for each in known if each not in anchors]:
        raise click.UsageError(f"vehicle.toml has no anchor {strange[0]}: it has {len(anchors)}, from 0")
    if len(places) < PLACES_MIN and (between is None or len(set(known)) < 3):
        raise click.UsageError(
            f"give {PLACES_MIN} or more --place of the tag, or --between and three or more --known: "
            "the places of the anchors on the platform can't be found by ranges alone: measure some places by hand"
        )
    printer = Printer(as_json)
    ranges = {} if between is None else _ranges_between(between, len(anchors))
    sightings: list[Sighting] = []
    if places:
        with connected(vehicle, router, printer) as uav:
            for i, place in enumerate(places):
                _ask_for(i, place, len(places))
                found = {anchor: each.median_m for anchor, each in _measured(uav, seconds).items()}
                if not found:
                    _fail_without_ranges(printer)
                sightings.append(Sighting(place, found))
    fixed = {anchor: anchors[anchor] for anchor in known}
    _print_located(printer, locate(sightings, anchors, ranges, fixed), fixed, len(anchors))


def _measured(uav: "Vehicle", seconds: float) -> dict[int, "AnchorStatistics"]:
    """Statistics of each anchor's ranges that arrive now."""
    from jezero.schemas.topics import UWB
    from jezero.services.uwb.statistics import statistics_of

    messages: list[Uwb] = []
    with uav.subscribe(UWB, messages.append):
        time.sleep(seconds)
    ranges: dict[int, list[float]] = {}
    for message in messages:
        for each in message.ranges:
            ranges.setdefault(each.anchor, []).append(each.range_m)
    return {anchor: statistics_of(ranges_m, int(1e9 * seconds)) for anchor, ranges_m in ranges.items()}


def _fail_without_ranges(printer: Printer) -> None:
    text = "no UWB ranges came: `jezero ps` shows what the service uwb says, or the simulator in a simulation"
    printer.fail("result", text, NO_RANGES, outcome="aborted", reason=text)


def _ask_for(i: int, place: "Vec3", count: int) -> None:
    """Wait until the person says that the tag is there."""
    forward_m, right_m, down_m = place
    text = f"place {i + 1} of {count}: hold the tag at {forward_m:g} {right_m:g} {down_m:g} and press Enter"
    click.echo(text, err=True)
    if not sys.stdin.readline():
        raise click.ClickException(f"the input has ended before the tag was at place {i + 1}")


def _ranges_between(path: Path, anchors: int) -> dict[tuple[int, int], float]:
    """Ranges between two anchors, from a file."""
    found: dict[tuple[int, int], float] = {}
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        raise click.UsageError(f"{path} {NOT_UTF8}") from None
    for number, row in enumerate(csv.reader(lines), 1):
        if not row or row[0].lstrip().startswith("#"):
            continue
        try:
            a, b, range_m = int(row[0]), int(row[1]), float(row[2])
            if a == b or not (0 <= a < anchors and 0 <= b < anchors and 0.0 < range_m < 1e4):
                raise ValueError
        except (ValueError, IndexError):
            raise click.UsageError(
                f"{path}, line {number}: expected two different anchors from 0 to {anchors - 1} and their range in "
                f"metres, such as 0,1,0.91; it is {','.join(row)!r}"
            ) from None
        found[min(a, b), max(a, b)] = range_m
    return found


def _print_located(printer: Printer, located: "Located", known: dict[int, "Vec3"], count: int) -> None:
    uncertain: list[int] = []
    places: list[Vec3] = []
    for anchor in range(count):
        found = located.anchors.get(anchor)
        pos_m = known[anchor] if found is None else found.pos_rover_body_m
        places.append(pos_m)
        if found is not None:
            stds = ", ".join(f"{std:.3f}" for std in found.std_m)
            where = ", ".join(f"{axis:.3f}" for axis in pos_m)
            printer.event("anchor", f"anchor {anchor}  [{where}] m, standard deviations {stds} m", anchor=anchor,
                          pos_rover_body_m=pos_m, std_m=found.std_m)  # fmt: skip
            if max(found.std_m) > STD_WARN_M:
                uncertain.append(anchor)
    lines = ", ".join("[" + ", ".join(f"{axis:.3f}" for axis in place) + "]" for place in places)
    text = f"the ranges fit within {located.residual_m:.3f} m; for [uwb] of vehicle.toml:\n"
    printer.event("result", f"{text}pos_anchors_rover_body_m = [{lines}]", outcome="succeeded",
                  residual_m=located.residual_m, pos_anchors_rover_body_m=places)  # fmt: skip
    if uncertain:
        named = ", ".join(map(str, uncertain))
        printer.warn(
            f"the place of anchor {named} is uncertain by more than {STD_WARN_M:g} m: add places of the tag on other "
            "sides, and higher or lower ones; from places in one plane the "
            "distance of an anchor to that plane can't be found"
        )
    if located.residual_m > RESIDUAL_WARN_M:
        printer.warn("the ranges don't fit together well: check the places, and what may be in the way")
