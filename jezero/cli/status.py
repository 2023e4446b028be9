"""`jezero status`."""

from math import atan2, degrees, hypot
from typing import TYPE_CHECKING, Any

import click

from jezero.cli.shared import Printer, common_options, connected, point_in_words

if TYPE_CHECKING:
    from jezero.frames import Vec3


@click.command()
@click.option("--watch", is_flag=True, help="Print each change until Ctrl+C.")
@common_options
def status(watch: bool, vehicle: str, router: str, as_json: bool) -> None:
    """Show what the vehicle does, where it is, and why it is not ready."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        if not watch:
            _print_status(printer, uav.status())
            return
        last = None
        try:
            for latest in uav.watch_status():
                shown = (
                    latest.code,
                    latest.armed,
                    latest.landed,
                    latest.autopilot_mode,
                    latest.in_charge,
                    latest.ready,
                    latest.text,
                )
                if as_json or shown != last:
                    _print_status(printer, latest)
                last = shown
        except KeyboardInterrupt:
            return


def wind_text(wind_ned_mps: "Vec3", std_gust_mps: float | None) -> str:
    north_mps, east_mps, _ = wind_ned_mps
    from_deg = round(degrees(atan2(-east_mps, -north_mps))) % 360
    gusts = "" if std_gust_mps is None else f", gusts of {std_gust_mps:.1f} m/s (standard deviation)"
    return f"{hypot(north_mps, east_mps):.1f} m/s from {from_deg} degrees{gusts}"


def _print_status(printer: Printer, latest: Any) -> None:
    import msgspec

    if printer.as_json:
        click.echo(msgspec.json.encode(latest).decode())
        return
    rows = [
        ("status", f"{latest.code} {latest.name}{', paused' if latest.paused else ''}"),
        ("in charge", latest.in_charge + (f" (goal {latest.goal_id})" if latest.goal_id else "")),
        ("autopilot", f"{latest.autopilot_mode or 'no link'}, {'armed' if latest.armed else 'disarmed'}"),
        ("vehicle", "on the ground" if latest.landed else "in the air"),
        ("ready", "yes" if latest.ready else f"no: {latest.not_ready_reason}"),
    ]
    if latest.odometry is not None:
        rows.append(("position", f"{point_in_words(latest.odometry.pos_uav_ned_m)} m, NED"))
        if latest.odometry.origin_deg is not None:
            rows.append(("origin", "latitude {:.7f}, longitude {:.7f}, {:.1f} m".format(*latest.odometry.origin_deg)))
        rows.append(("velocity", f"{point_in_words(latest.odometry.vel_uav_ned_mps)} m/s"))
    if latest.wind_ned_mps is not None:
        rows.append(("wind", wind_text(latest.wind_ned_mps, latest.std_gust_mps)))
    if latest.battery is not None and latest.battery.remaining is not None:
        rows.append(("battery", f"{100.0 * latest.battery.remaining:.0f} %"))
    if latest.text:
        rows.append(("last event", latest.text))
    for name, value in rows:
        click.echo(f"{name:<11}{value}")
