"""The file of a mission on the command line."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jezero.cli.exit_codes import FAILED
from jezero.cli.flight import Printer

if TYPE_CHECKING:
    from jezero.mission_files import MissionFile


def read_file(file: str, origin_deg: "Sequence[float] | None", printer: Printer) -> "MissionFile":
    """Read a mission file, or one that comes with jezero; one with mistakes ends the command."""
    from jezero.mission_files import MissionFileError, read_mission, shipped_file, shipped_names

    shipped = file in shipped_names() and not Path(file).exists()
    try:
        return read_mission(shipped_file(file) if shipped else file, origin_deg)
    except MissionFileError as error:
        problems = [{"line": problem.line, "text": problem.text} for problem in error.problems]
        printer.fail("mistakes", str(error), FAILED, problems=problems)
