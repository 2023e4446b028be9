"""All figures of recorded flights: of runs' folders and of files of the landing benchmark."""

from collections.abc import Callable, Sequence
from os.path import commonpath
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from jezero.base.files import describe_os_error
from jezero.recording import RecordingError, open_recording
from jezero.recording.folder import recordings_in
from jezero.recording.writer import RECORDING
from jezero.report.coverage_plot import draw_coverage
from jezero.report.coverage_track import draw_coverage_tracks
from jezero.report.landing_plots import draw_landing
from jezero.report.landings import RecordedLanding, landings
from jezero.report.pictures import draw_contact_sheet, draw_orbits
from jezero.report.plots import draw_flight
from jezero.report.style import Format
from jezero.report.touchdowns import Touchdowns, draw_touchdown, draw_touchdowns
from jezero.schemas import topics
from jezero.schemas.images import LISTING
from jezero.schemas.rows import Topic

DRAWN: tuple[Topic[Any], ...] = (
    topics.STATUS,
    topics.ODOMETRY,
    topics.SETPOINT,
    topics.TRUTH,
    topics.RELATIVE,
    topics.ROVER_ESTIMATE,
    topics.ESTIMATE_TAG,
    topics.UWB,
    topics.ROVER_ODOMETRY,
    topics.feedback_of(topics.GET_IMAGES),
    topics.feedback_of(topics.AREA_COVERAGE),
    topics.feedback_of(topics.LAND_ON_SPOT),
)
"""Topics of a recording that figures show; the other ones, which are most of a recording, are not decoded."""


class ReportError(ValueError):
    """A file can't be drawn; the text names it and the reason."""


class _Case(msgspec.Struct, frozen=True):
    """Fields of a line of `jezero bench landing --json` that are drawn."""

    case: str
    rover: str
    n: int
    touchdowns_m: list[tuple[float, float]]


def draw_report(
    paths: Sequence[Path], form: Format = "png", on_problem: Callable[[str], None] = lambda text: None
) -> list[Path]:
    """Draw runs' folders, or their recordings, and files of the landing benchmark.

    Each run's figures go into its folder. The touchdowns of several runs together, and those of the benchmark, go
    beside them, as `touchdowns`.

    Args:
        on_problem: called with a sentence for each recording of a stack's run folder that can't be drawn, while
            others can.

    Returns:
        The files written.

    Raises:
        ReportError: a path is neither of these, or is invalid.
    """
    files: list[Path] = []
    kinds: list[Touchdowns] = []
    flown: list[RecordedLanding] = []
    folders: list[Path] = []
    for path in paths:
        if path.is_dir() or path.suffix == ".mcap":
            folder = path if path.is_dir() else path.parent
            drawn, found = draw_run(path, form, on_problem)
            files += drawn
            flown += found
            folders.append(folder.resolve() if len(paths) == 1 else folder.resolve().parent)
        else:
            kinds += _read_benchmark(path)
            folders.append(path.resolve().parent)
    over_rover = [landing for landing in flown if landing.by_estimate]
    if len(over_rover) > 1:
        kinds += _combined(over_rover)
    if kinds:
        files.append(draw_touchdowns(kinds, Path(commonpath(folders)) / f"touchdowns.{form}"))
    return files


def draw_run(
    path: Path, form: Format = "png", on_problem: Callable[[str], None] = lambda text: None
) -> tuple[list[Path], list[RecordedLanding]]:
    """Draw the recordings and the images of a run into the run's folder; either may be missing.

    Figures of images that are in folders of their own go into these folders.

    Args:
        path: the run's folder, or a recording. The figures of a recording with another name than flight.mcap go into
            a folder with its name, beside it.
        on_problem: called with a sentence for each of several recordings that can't be drawn, while others can.

    Returns:
        The files written, and the landings of the recordings.

    Raises:
        ReportError: the folder has neither a recording nor images, or none that is valid.
    """
    files = _draw_datasets(path if path.is_dir() else _figures_folder(path), form)
    file = path / RECORDING
    paths = recordings_in(path) if path.is_dir() and not file.exists() else []
    found: list[RecordedLanding] = []
    problems: list[str] = []
    for recording in paths or [file if file.exists() else path]:
        try:
            drawn, landed = _draw_recording(recording, form)
        except ReportError as error:
            problems.append(str(error))
            continue
        files += drawn
        found += landed
    if not files:
        raise ReportError(f"{problems[0]}; give the folder of a run, such as runs/<time>, or a recording of a flight")
    for problem in problems:
        if paths:  # a run without a recording may be images alone
            on_problem(problem)
    return files, found


def _figures_folder(recording: Path) -> Path:
    return recording.parent if recording.name == RECORDING else recording.with_suffix("")


def _draw_datasets(folder: Path, form: Format) -> list[Path]:
    files: list[Path] = []
    for listing in sorted((*folder.glob(LISTING), *folder.glob(f"*/{LISTING}"))):
        dataset = listing.parent.parent
        try:
            files += [*draw_contact_sheet(dataset, form), *draw_coverage(dataset, form)]
        except (msgspec.DecodeError, ValueError, OSError) as error:
            raise ReportError(f"{listing} can't be drawn: {error}") from error
    return files


def _draw_recording(path: Path, form: Format) -> tuple[list[Path], list[RecordedLanding]]:
    folder = _figures_folder(path)
    try:
        entries = list(open_recording(path).messages(*DRAWN))
        folder.mkdir(parents=True, exist_ok=True)
        files = draw_flight(entries, folder, form)
    except RecordingError as error:
        raise ReportError(str(error)) from error
    except OSError as error:
        raise ReportError(describe_os_error(error)) from error
    except ValueError as error:
        raise ReportError(f"{path} can't be drawn: {error}") from error
    files += draw_orbits(entries, folder, form)
    files += draw_coverage_tracks(entries, folder, form)
    found = landings(entries)
    for number, landing in enumerate(found, 1):
        suffix = f"_{number}" if number > 1 else ""
        files += draw_landing(landing, folder, suffix, form)
        files += draw_touchdown(landing, folder, suffix, form)
    return files, found


def _combined(flown: Sequence[RecordedLanding]) -> list[Touchdowns]:
    """The touchdowns of several landings; those without truth, which are estimates, are a kind of their own."""
    kinds = []
    for title, has_truth in (("flights", True), ("flights, by the estimate", False)):
        touchdowns_m = [landing.touchdown_rover_body_m for landing in flown if landing.has_truth is has_truth]
        ended = [place_m for place_m in touchdowns_m if place_m is not None]
        if touchdowns_m:
            kinds.append(Touchdowns(title, np.array(ended).reshape(-1, 2), failed=len(touchdowns_m) - len(ended)))
    return kinds


def _read_benchmark(path: Path) -> list[Touchdowns]:
    try:
        lines = path.read_bytes().split(b"\n")
        cases = [msgspec.json.decode(text, type=_Case) for text in lines if text.strip()]
    except OSError as error:
        raise ReportError(f"{path} can't be read: {error.strerror}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
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
