"""`jezero camera`: images of the vehicle's camera and of the simulated ground."""

from pathlib import Path

import click

from jezero.cli.shared import FINITE, NUMBERS, FiniteRange, Printer, common_options, connected
from jezero.os_errors import naming
from jezero.schemas.sensors import CameraPreview

PNG = click.Path(path_type=Path, dir_okay=False, writable=True)


@click.group()
def camera() -> None:
    """Save images of the vehicle's camera, or of the simulated ground from above."""


@camera.command()
@click.argument("file", type=PNG)
@click.option("--timeout", "timeout_s", type=FINITE, default=3.0, show_default=True, help="Seconds to wait.")
@common_options
def snap(file: Path, timeout_s: float, vehicle: str, router: str, as_json: bool) -> None:
    """Save the next image of the camera as FILE, a PNG.

    On another computer than the vehicle's, which its images don't reach, the next preview is saved.
    """
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        with naming(file):
            frame = uav.camera.snap(file, timeout_s)
        kind = ", a preview" if isinstance(frame, CameraPreview) else ""
        text = f"wrote {file}: {frame.width_px} x {frame.height_px} pixels{kind}, taken at {frame.t_ns / 1e9:.3f} s"
        printer.event("result", text, outcome="succeeded", file=str(file), t_ns=frame.t_ns)


@camera.command(context_settings=NUMBERS)
@click.argument("file", type=PNG)
@click.option("--middle", nargs=2, type=FINITE, default=(0.0, 0.0), show_default=True, help="North, east in m.")
@click.option("--side", "side_m", type=FiniteRange(0.1, 200.0), default=20.0, show_default=True, help="In m.")
@click.option("--resolution", type=FiniteRange(0.001, 10.0), default=0.02, show_default=True, help="Metres per pixel.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line, the result last.")
def orthophoto(file: Path, middle: tuple[float, float], side_m: float, resolution: float, as_json: bool) -> None:
    """Save the simulated ground, seen from straight above, as FILE, a PNG with north at the top.

    No running stack is needed. The vehicle starts at 0 0. Vehicle and rover are not in the image.
    """
    from jezero.client.png import png_of
    from jezero.runtime.config import load_config
    from jezero.services.simulator.camera.orthophoto import make_orthophoto
    from jezero.services.simulator.camera.service import NoEglError
    from jezero.services.simulator.config import SimulatorConfig
    from jezero.vehicle_config import VehicleConfig

    if side_m / resolution > 20_000:
        raise click.UsageError(f"{side_m:g} m at {resolution:g} m per pixel are more than 20,000 pixels across")
    try:
        place, vehicle = load_config(SimulatorConfig, "simulator"), load_config(VehicleConfig, "vehicle")
        picture = make_orthophoto(place, vehicle, middle, side_m, resolution)
    except NoEglError as error:
        raise click.ClickException(f"{error}: install libegl1, libgl1 and libgl1-mesa-dri") from None
    height_px, width_px, _ = picture.shape
    with naming(file):
        file.write_bytes(png_of(width_px, height_px, picture.tobytes()))
    text = f"wrote {file}: {width_px} x {height_px} pixels of {resolution:g} m"
    Printer(as_json).event("result", text, outcome="succeeded", file=str(file), m_per_px=resolution)
