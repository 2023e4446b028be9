"""`jezero twin`: simulator and autopilot behind the plugs that real hardware has."""

from pathlib import Path

import click

from jezero.base.extras import require
from jezero.cli.options import world_option


@click.command()
@click.option("--baud", type=click.IntRange(9600, 4_000_000), default=921_600, show_default=True,
              help="Baud rate of the flight controller's line.")  # fmt: skip
@click.option("--drift-ppm", type=click.FloatRange(-100_000, 100_000), default=50.0, show_default=True,
              help="How much faster its clock runs than this computer's.")  # fmt: skip
@click.option("--folder", type=click.Path(path_type=Path, file_okay=False), default=Path("runs/twin"),
              show_default=True, help="Folder of its devices, settings and logs.")  # fmt: skip
@world_option
def twin(baud: int, drift_ppm: float, folder: Path) -> None:
    """Run a simulated vehicle as hardware would be, to rehearse on it before the first propeller turns.

    Its flight controller is at the end of a serial line with a baud rate, and has a clock of its own. Nothing else of
    the simulator reaches the stack that flies it. It runs until Ctrl+C, and prints the command that flies it.
    """
    require("`jezero twin`", "pybullet", "serial")
    from jezero.deploy.twin.twin import TwinError, run_twin

    try:
        run_twin(folder, baud, drift_ppm)
    except TwinError as error:
        raise click.ClickException(str(error)) from None
