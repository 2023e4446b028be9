"""`jezero preflight`."""

import shutil
import textwrap
from typing import TYPE_CHECKING, get_args

import click

from jezero.cli.exit_codes import REFUSED
from jezero.cli.shared import Printer, common_options, connected

if TYPE_CHECKING:
    from jezero.schemas.preflight import PreflightReport

COLORS = {"passed": "green", "warning": "yellow", "failed": "red"}
INDENT = 20


@click.command()
@common_options
def preflight(vehicle: str, router: str, as_json: bool) -> None:
    """Check what a pilot checks before a takeoff: services, sensors, position, compasses, battery, fence, storage.

    It takes a second and a half. The exit code is 3 when a check has failed, for which a takeoff is refused.
    """
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        report = uav.preflight()
    if as_json:
        import msgspec

        click.echo(msgspec.json.encode(report).decode())
    else:
        _print_report(report)
    if report.failed():
        raise SystemExit(REFUSED)


def _print_report(report: "PreflightReport") -> None:
    width = max(min(shutil.get_terminal_size().columns, 120), 2 * INDENT)
    for check in report.checks:
        lines = textwrap.wrap(check.text, width - INDENT) or [""]
        verdict = click.style(f"{check.verdict:<9}", fg=COLORS[check.verdict], bold=check.verdict != "passed")
        click.echo(f"{check.name:<11}{verdict}{lines[0]}")
        for line in lines[1:]:
            click.echo(" " * INDENT + line)
    from jezero.schemas.preflight import Override

    failed, warned = ([c.name for c in report.checks if c.verdict == verdict] for verdict in ("failed", "warning"))
    warnings = f"; warnings: {', '.join(warned)}" if warned else ""
    if not failed:
        click.echo(f"ready for a takeoff{warnings}")
        return
    click.echo(f"a takeoff would be refused: {', '.join(failed)}{warnings}")
    if set(failed) <= set(get_args(Override)):
        click.echo("to take off all the same: jezero takeoff " + " ".join(f"--override {name}" for name in failed))
