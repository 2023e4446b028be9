"""`jezero watch`: a vehicle's messages, live, for a viewer."""

import click

from jezero.cli.exit_codes import UNREACHABLE
from jezero.cli.shared import Printer, common_options
from jezero.router_address import is_loopback, shown_router

PORT = 8765
"""The port that Foxglove suggests."""
CONNECT_TIMEOUT_S = 3.0
POLL_PERIOD_S = 0.2
"""Longest time until images are sent to somebody who has just subscribed to them."""


@click.command()
@click.option("--foxglove", is_flag=True, help="Serve Foxglove, with the channels of a recording.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on; 0.0.0.0 for all networks.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=PORT,
    show_default=True,
    help="Port; 0 for a free one.",
)
@common_options
def watch(foxglove: bool, host: str, port: int, vehicle: str, router: str, as_json: bool) -> None:
    """Serve what the vehicle publishes to a viewer, until Ctrl+C.

    The viewer gets the channels of a recording, also the 3D scene. Images are encoded only while somebody looks.
    """
    if not foxglove:
        raise click.UsageError("choose the viewer: --foxglove")
    try:
        import foxglove as _  # noqa: F401
    except ModuleNotFoundError:
        raise click.ClickException("Foxglove's library is an extra: pip install 'jezero[foxglove]'") from None
    try:
        _serve(Printer(as_json), vehicle, router, host, port)
    except KeyboardInterrupt:
        return


def _serve(printer: Printer, vehicle: str, router: str, host: str, port: int) -> None:
    import zenoh

    from jezero.client.session import hidden_reason
    from jezero.keys.diagnosis import connection_problem
    from jezero.recording.live import LiveServer, ServeError, VehicleMessages
    from jezero.recording.viewer_scene import ViewerScene
    from jezero.runtime.config import load_config
    from jezero.vehicle_config import VehicleConfig
    from jezero.zenoh_client import client_config

    scene = ViewerScene(load_config(VehicleConfig, "vehicle"))
    try:
        session = zenoh.open(client_config(router, CONNECT_TIMEOUT_S))
    except zenoh.ZError:
        reason = connection_problem(router) or f"no router at {shown_router(router)}: is the stack up? (`jezero up`)"
        printer.fail("unreachable", f"unreachable: {reason}", UNREACHABLE, reason=reason)
    if reason := hidden_reason(session, router, vehicle):
        session.close()  # type: ignore[no-untyped-call]
        printer.fail("unreachable", f"unreachable: {reason}", UNREACHABLE, reason=reason)
    try:
        server = LiveServer(vehicle, host, port, scene)
    except ServeError as error:
        raise click.ClickException(f"{error}; choose another --port or --host") from None
    with session, server:
        url = f"ws://{host}:{server.port}"
        if not is_loopback(host):
            printer.warn(f"everybody who reaches {host} can see what {vehicle} publishes")
        text = f"{vehicle} is on {url}: in Foxglove, open a connection to this address. Ctrl+C ends it."
        printer.event("serving", text, url=url, port=server.port)
        messages = VehicleMessages(session, vehicle)
        while True:
            messages.want_images(server.wants_images)
            for arrival in messages.take(POLL_PERIOD_S):
                server.publish(*arrival)
