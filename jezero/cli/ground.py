"""`jezero ground`: the ground station alone, for a vehicle whose stack runs here or elsewhere."""

from contextlib import suppress

import click

from jezero.cli.flight import Router


@click.command()
@click.option(
    "--connect",
    "router",
    envvar="JEZERO_ROUTER",
    type=Router(),
    default="tcp/127.0.0.1:7447",
    show_default=True,
    help="Endpoint of the vehicle's router.",
)
@click.option("--vehicle", envvar="JEZERO_VEHICLE", default="uav1", show_default=True, help="Vehicle's name.")
@click.option("--port", type=click.IntRange(1, 65535), help="Port of the pages [default: as in ground_station.toml].")
def ground(router: str, vehicle: str, port: int | None) -> None:
    """Serve the ground station's pages to browsers on this machine, until Ctrl+C.

    `jezero up` starts a ground station too. This command is for a laptop beside the vehicle. When the port is busy, the
    next free one is taken.
    """
    import msgspec

    from jezero.runtime.config import load_config
    from jezero.services.ground_station.config import GroundStationConfig
    from jezero.vehicle_config import VehicleConfig

    try:
        from jezero.services.ground_station.web.server import PageServer
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] == "jezero":
            raise
        raise click.ClickException("the ground station is an extra: pip install 'jezero[ground]'") from None
    config = load_config(GroundStationConfig, "ground_station")
    if port is not None:
        config = msgspec.structs.replace(config, port=port)
    server = PageServer(config, load_config(VehicleConfig, "vehicle"), vehicle, router)
    with suppress(KeyboardInterrupt):  # uvicorn raises Ctrl+C anew after its own shutdown
        click.echo(f"the pages of {vehicle} are on {server.address}. Ctrl+C ends them.")
        server.run()
