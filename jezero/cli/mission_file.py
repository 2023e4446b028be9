"""Files of missions and fences on the command line: one with mistakes ends the command and names each of them."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from jezero.cli.exit_codes import FAILED
from jezero.cli.shared import Printer

if TYPE_CHECKING:
    from jezero.mission_files import MissionFile
    from jezero.schemas.fence import Fence

T = TypeVar("T")


def read_mission_file(file: str, origin_deg: "Sequence[float] | None", printer: Printer) -> "MissionFile":
    """Read a mission file, or one that comes with jezero."""
    from jezero.mission_files import read_mission, shipped_file, shipped_names

    shipped = file in shipped_names() and not Path(file).exists()
    return _read(lambda: read_mission(shipped_file(file) if shipped else file, origin_deg), printer)


def read_fence_file(file: str, printer: Printer) -> "Fence":
    """Read a fence file, or the geofence of a plan."""
    from jezero.mission_files import read_fence

    return _read(lambda: read_fence(file), printer)


def _read(read: Callable[[], T], printer: Printer) -> T:
    from jezero.mission_files import MissionFileError

    try:
        return read()
    except MissionFileError as error:
        problems = [{"line": problem.line, "text": problem.text} for problem in error.problems]
        printer.fail("mistakes", str(error), FAILED, problems=problems)
