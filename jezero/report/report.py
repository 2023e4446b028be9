"""All figures of recorded flights: of runs' folders and of files of the landing benchmark."""

from collections.abc import Sequence
from os.path import commonpath
from pathlib import Path

import msgspec
import numpy as np

from jezero.recording import RecordingError, open_recording
from jezero.recording.writer import RECORDING
from jezero.report.coverage_plot import draw_coverage
from jezero.report.landing_plots import draw_landing
from jezero.report.landings import Landing, landings
from jezero.report.pictures import draw_contact_sheet, draw_orbits
from jezero.report.plots import draw_flight
from jezero.report.style import Format
from jezero.report.touchdowns import Touchdowns, draw_touchdown, draw_touchdowns
from jezero.schemas.images import LISTING


class ReportError(ValueError):
    """A file can't be drawn; the text names it and the reason."""


class _Case(msgspec.Struct, frozen=True):
    """Fields of a line of `jezero bench landing --json` that are drawn."""

    case: str
    rover: str
    n: int
    touchdowns_m: list[tuple[float, float]]


def draw_report(paths: Sequence[Path], form: Format = "png") -> list[Path]:
    """Draw runs' folders, or their recordings, and files of the landing benchmark.

    Each run's figures go into its folder. The touchdowns of several runs together, and those of the benchmark, go
    beside them, as `touchdowns`.

    Returns:
        The files written.

    Raises:
        ReportError: a path is neither of these, or is invalid.
    """
    files: list[Path] = []
    kinds: list[Touchdowns] = []
    flown: list[Landing] = []
    folders: list[Path] = []
    for path in paths:
        if path.is_dir() or path.suffix == ".mcap":
            folder = path if path.is_dir() else path.parent
            drawn, found = draw_run(path, form)
            files += drawn
            flown += found
            folders.append(folder.resolve().parent)
        else:
            kinds += _read_benchmark(path)
            folders.append(path.resolve().parent)
    over_rover = [landing for landing in flown if landing.by_estimate]
    if len(over_rover) > 1:
        kinds.append(_combined(over_rover))
    if kinds:
        files.append(draw_touchdowns(kinds, Path(commonpath(folders)) / f"touchdowns.{form}"))
    return files


def draw_run(path: Path, form: Format = "png") -> tuple[list[Path], list[Landing]]:
    """Draw the recording and the images of a run into the run's folder; either may be missing.

    Figures of images that are in folders of their own go into these folders.

    Args:
        path: the run's folder, or a recording. The figures of a recording with another name than flight.mcap go into
            a folder with its name, beside it.

    Returns:
        The files written, and the landings of the recording.

    Raises:
        ReportError: the folder has neither a recording nor images, or one of them is invalid.
    """
    folder = path
    if path.suffix == ".mcap":
        folder = path.parent if path.name == RECORDING else path.with_suffix("")
    files: list[Path] = []
    for listing in sorted((*folder.glob(LISTING), *folder.glob(f"*/{LISTING}"))):
        dataset = listing.parent.parent
        try:
            files += [*draw_contact_sheet(dataset, form), *draw_coverage(dataset, form)]
        except (msgspec.DecodeError, ValueError, OSError) as error:
            raise ReportError(f"{listing} can't be drawn: {error}") from error
    try:
        recording = open_recording(path)
    except RecordingError as error:
        if files:  # a run may be images alone
            return files, []
        raise ReportError(f"{error}; give the folder of a run, such as runs/<time>, or a recording") from error
    try:
        entries = list(recording.messages())
        folder.mkdir(parents=True, exist_ok=True)
        files += draw_flight(entries, folder, form)
    except RecordingError as error:
        raise ReportError(str(error)) from error
    except ValueError as error:
        raise ReportError(f"{recording.path} can't be drawn: {error}") from error
    files += draw_orbits(entries, folder, form)
    found = landings(entries)
    for number, landing in enumerate(found, 1):
        suffix = f"_{number}" if number > 1 else ""
        files += draw_landing(landing, folder, suffix, form)
        files += draw_touchdown(landing, folder, suffix, form)
    return files, found


def _combined(flown: Sequence[Landing]) -> Touchdowns:
    touchdowns_m = [landing.touchdown_rover_body_m for landing in flown]
    ended = [place_m for place_m in touchdowns_m if place_m is not None]
    return Touchdowns("flights", np.array(ended).reshape(-1, 2), failed=len(touchdowns_m) - len(ended))


def _read_benchmark(path: Path) -> list[Touchdowns]:
    try:
        lines = path.read_bytes().split(b"\n")
        cases = [msgspec.json.decode(text, type=_Case) for text in lines if text.strip()]
    except OSError as error:
        raise ReportError(f"{path} can't be read: {error.strerror}") from error
    except msgspec.DecodeError as error:
        neither = "neither the folder of a run nor a file of `jezero bench landing --json`"
        raise ReportError(f"{path} is {neither}: {error}") from error
    if not cases:
        raise ReportError(f"{path} is empty")
    return [
        Touchdowns(
            case.case if case.rover == "still" else f"{case.case}, rover: {case.rover}",
            np.array(case.touchdowns_m, dtype=float).reshape(-1, 2),
            on_platform=case.case != "none",
            failed=case.n - len(case.touchdowns_m),
        )
        for case in cases
    ]
