"""`jezero camera board`, `calibrate`, `intrinsics` and `delay`: a real camera is made known to the stack."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jezero.base.extras import require
from jezero.base.files import naming
from jezero.cli.flight import camera
from jezero.cli.options import vehicle_options
from jezero.cli.terminal import Printer, connected

if TYPE_CHECKING:
    from jezero.calibration.board import Board, View
    from jezero.calibration.guide import Guide
    from jezero.calibration.intrinsics import CameraIntrinsics
    from jezero.schemas.sensors import CameraFrame, DistortionModel

__all__ = ["camera"]
MODELS = ("plumb_bob", "rational_polynomial", "equidistant")
FILE = click.Path(path_type=Path, dir_okay=False)
FOLDER = click.Path(path_type=Path, file_okay=False)
FRAME_TIMEOUT_S = 5.0


@camera.command()
@click.option("--out", "file", type=FILE, default=Path("board.pdf"), show_default=True, help="File to write, a PDF.")
def board(file: Path) -> None:
    """Write the calibration board as a page of A4, to be printed in true size (100 %)."""
    require("`jezero camera board`", "cv2", "matplotlib")
    from jezero.calibration.board import COLUMNS, ROWS, SQUARE_MM, Board

    with naming(file):
        Board().write_pdf(file)
    click.echo(f"wrote {file}: {COLUMNS} x {ROWS} squares of {SQUARE_MM:g} mm; print it at 100 %, and check the ruler")


@camera.command()
@click.option("--pictures", "folder", type=FOLDER, default=Path("runs/calibration"),
              show_default=True, help="Folder of the pictures that are kept.")  # fmt: skip
@click.option("--from-pictures", is_flag=True, help="Use the pictures in that folder, and no camera.")
@click.option("--square-mm", type=click.FloatRange(1.0, 1000.0), default=None, help="Side of a square, as measured.")
@click.option("--model", type=click.Choice(MODELS), default="plumb_bob", show_default=True,
              help="Model of the lens; equidistant for a fisheye.")  # fmt: skip
@click.option(
    "--out", "file", type=FILE, default=Path("camera.yaml"), show_default=True, help="File to write, as ROS'."
)
@vehicle_options
def calibrate(
    folder: Path,
    from_pictures: bool,
    square_mm: float | None,
    model: "DistortionModel",
    file: Path,
    vehicle: str,
    router: str,
) -> None:
    """Calibrate the lens with the printed board: follow what the line says, until all is covered.

    It reads the pictures of the running stack, on the vehicle's own computer. Ctrl+C ends it earlier.
    """
    require("`jezero camera calibrate`", "cv2")
    from jezero.calibration.board import SQUARE_MM, Board
    from jezero.calibration.fit import FitError, fit_camera
    from jezero.calibration.intrinsics import ros_yaml

    made = Board(1e-3 * (square_mm or SQUARE_MM))
    if from_pictures:
        views, size_px = _views_of_folder(folder, made)
    else:
        views, size_px = _views_of_camera(folder, made, vehicle, router)
    try:
        fit = fit_camera(views, size_px, model)
    except FitError as error:
        raise click.ClickException(str(error)) from None
    with naming(file):
        file.write_text(ros_yaml(fit.intrinsics, "camera"), encoding="utf-8")
    (fx, fy), sure = fit.intrinsics.focal_px, f" (± {fit.std_focal_px:.1f})" if fit.std_focal_px > 0.0 else ""
    click.echo(f"{fit.views} views: error {fit.reprojection_px:.2f} px, of the worst view {fit.worst_px:.2f} px")
    click.echo(f"focal length {fx:.1f}{sure} and {fy:.1f} px; wrote {file}")
    _print_lines(fit.intrinsics)


def _views_of_folder(folder: Path, made: "Board") -> "tuple[list[View], tuple[int, int]]":
    """The board in each picture of a folder, and the size of the pictures."""
    import cv2
    import numpy as np

    views, sizes = [], set()
    files = sorted(file for kind in ("png", "jpg", "jpeg") for file in folder.glob(f"*.{kind}"))
    if not files:
        raise click.ClickException(f"there is no picture (png, jpg) in {folder}")
    for file in files:
        grey = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        if grey is None:
            click.echo(f"{file} can't be read and is left out", err=True)
            continue
        sizes.add((int(grey.shape[1]), int(grey.shape[0])))
        if (view := made.find(np.asarray(grey, np.uint8))) is None:
            click.echo(f"{file} does not show enough of the board and is left out", err=True)
        else:
            views.append(view)
    if len(sizes) != 1:
        shown = ", ".join(f"{width} x {height}" for width, height in sorted(sizes)) or "none"
        raise click.ClickException(
            f"the pictures in {folder} have not one size ({shown}): calibrate one camera at a time"
        )
    return views, sizes.pop()


def _views_of_camera(folder: Path, made: "Board", vehicle: str, router: str) -> "tuple[list[View], tuple[int, int]]":
    """The views that a person shows to the camera, guided, and the size of the pictures; kept pictures are saved."""
    from jezero.calibration.guide import Guide
    from jezero.schemas import topics

    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
    if any(folder.glob("*.png")):
        raise click.ClickException(
            f"{folder} has pictures already: choose another folder, or --from-pictures to use them"
        )
    guide: Guide | None = None
    size_px = (0, 0)
    with connected(vehicle, router, Printer(False)) as uav:
        frame = uav.camera.frame(FRAME_TIMEOUT_S)
        size_px = (frame.width_px, frame.height_px)
        guide = Guide(size_px)
        click.echo("show the board to the camera; `jezero ground` or the ground station shows what the camera sees")
        try:
            with uav.subscribe(topics.CAMERA) as stream:
                while not guide.done:
                    _look(guide, made, stream.next(FRAME_TIMEOUT_S), folder)
        except KeyboardInterrupt:
            click.echo("ended early")
    return guide.views, size_px


def _look(guide: "Guide", made: "Board", frame: "CameraFrame", folder: Path) -> None:
    """Take in a picture, save it where it is kept, and say what to do next."""
    import cv2
    import numpy as np

    rgb = np.frombuffer(frame.pixels, np.uint8).reshape(frame.height_px, frame.width_px, 3)
    said = guide.said
    if guide.update(made.find(np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8))):
        cv2.imwrite(str(folder / f"{len(guide.views):03}.png"), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    if guide.said != said:
        click.echo(f"{len(guide.views)} kept; {guide.said}")


@camera.command()
@click.argument("file", type=FILE)
@click.option("--camera", "name", default="cam0", show_default=True, help="Camera in a file of Kalibr.")
@click.option("--write", is_flag=True, help="Write them into vehicle.toml of the settings (JEZERO_CONFIG_DIR).")
def intrinsics(file: Path, name: str, write: bool) -> None:
    """Read the lens from FILE, a camera_info YAML of ROS or a camchain YAML of Kalibr, for vehicle.toml."""
    from jezero.calibration.intrinsics import IntrinsicsError, read_intrinsics, with_intrinsics

    try:
        found = read_intrinsics(file, name)
        if not write:
            _print_lines(found)
            return
        from jezero.base.config import config_directory

        path = config_directory() / "vehicle.toml"
        with naming(path):
            path.write_text(with_intrinsics(path.read_text(encoding="utf-8"), found), encoding="utf-8")
    except IntrinsicsError as error:
        raise click.ClickException(str(error)) from None
    click.echo(f"wrote {path}; `jezero down` and `jezero up` make the stack read it")


def _print_lines(found: "CameraIntrinsics") -> None:
    from jezero.calibration.intrinsics import toml_lines

    click.echo("for the table [camera] of vehicle.toml, or `jezero camera intrinsics FILE --write`:\n")
    click.echo("\n".join(toml_lines(found)))


@camera.command()
@click.option("--seconds", "duration_s", type=click.FloatRange(10.0, 300.0), default=30.0, show_default=True,
              help="Time of the measurement.")  # fmt: skip
@vehicle_options
def delay(duration_s: float, vehicle: str, router: str) -> None:
    """Measure how old the pictures are on arrival: turn the vehicle by hand, to and fro, while it runs.

    The motors are off. Turn it about all axes, twice a second, over ground with many details, not over a moving thing.
    """
    require("`jezero camera delay`", "cv2")
    from jezero.base.config import ConfigError, load_config
    from jezero.calibration.delay import DelayError, measure_delay
    from jezero.services.camera.config import CameraDriverConfig

    try:
        set_s = load_config(CameraDriverConfig, "camera_driver").exposure_delay_s
        steps, gyro_s, gyro_rps = _turns(duration_s, vehicle, router)
        found = measure_delay(steps, gyro_s, gyro_rps)
    except (ConfigError, DelayError) as error:
        raise click.ClickException(str(error)) from None
    total_s = set_s + found.shift_s
    click.echo(
        f"the pictures are {1e3 * total_s:.0f} ms old on arrival (± {1e3 * found.spread_s:.0f} ms): "
        f"{1e3 * found.shift_s:+.0f} ms against the setting; {found.steps} pairs, correlation {found.correlation:.2f}"
    )
    if total_s < 0.0:
        raise click.ClickException("a picture can't be older than 0 ms: is the setting on this computer the camera's?")
    click.echo(f"for camera_driver.toml:\n\nexposure_delay_s = {total_s:.3f}")


def _turns(duration_s: float, vehicle: str, router: str) -> tuple[Any, Any, Any]:
    """Rotations by the pictures, and times and rates of the gyro, while a person turns the vehicle."""
    import time

    import cv2
    import numpy as np

    from jezero.base.frames import frd_from_camera
    from jezero.calibration.delay import TurnStep, TurnTracker
    from jezero.schemas import topics

    steps: list[TurnStep] = []
    rates: list[tuple[float, tuple[float, float, float]]] = []
    with connected(vehicle, router, Printer(False)) as uav:
        with uav.subscribe(topics.CAMERA_INFO) as infos:
            info = infos.next(FRAME_TIMEOUT_S)
        tracker = TurnTracker(info)
        with uav.subscribe(topics.CAMERA) as frames, uav.subscribe(topics.ODOMETRY) as odometry:
            end_s = time.monotonic() + duration_s
            while (left_s := end_s - time.monotonic()) > 0.0:
                frame = frames.next(FRAME_TIMEOUT_S)
                rgb = np.frombuffer(frame.pixels, np.uint8).reshape(frame.height_px, frame.width_px, 3)
                axes = [
                    frd_from_camera(axis, frame.pitch_camera_rad, frame.roll_camera_rad, info.turn_camera_rad)
                    for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
                ]
                grey = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)
                if (step := tracker.update(grey, frame.t_ns * 1e-9, np.array(axes).T)) is not None:
                    steps.append(step)
                rates += _waiting(odometry.next)
                click.echo(f"\rturn the vehicle: {left_s:3.0f} s left, {len(steps)} pairs of pictures", nl=False)
    click.echo()
    return steps, np.array([t_s for t_s, _ in rates]), np.array([rate for _, rate in rates]).reshape(-1, 3)


def _waiting(next_message: Callable[[float], Any]) -> list[tuple[float, tuple[float, float, float]]]:
    """Times and rates of the odometry that has arrived."""
    from jezero.client import TimedOut

    found: list[tuple[float, tuple[float, float, float]]] = []
    while True:
        try:
            message = next_message(0.0)
        except TimedOut:
            return found
        found.append((message.t_ns * 1e-9, message.rates_uav_frd_rps))
