"""The fault campaign: whole missions in virtual time under seeded faults."""

import json
import re
from functools import partial
from typing import TYPE_CHECKING

import click

from jezero.cli.exit_codes import ABORTED

if TYPE_CHECKING:
    from jezero.deploy.campaign.campaign import CampaignReport
    from jezero.deploy.campaign.mission import MissionReport

LONGEST = 1_000_000


def seed_range(ctx: click.Context, param: click.Parameter, value: str) -> range:
    """`A..B`, both included, or one number."""
    match = re.fullmatch(r"(\d{1,9})(?:\.\.(\d{1,9}))?", value)
    if match is None:
        raise click.BadParameter(f"{value!r} is no range of seeds: write 1..100, or one number")
    first, last = int(match[1]), int(match[2] or match[1])
    if not first <= last < first + LONGEST:
        raise click.BadParameter(f"{value!r}: the last seed must follow the first, by less than {LONGEST}")
    return range(first, last + 1)


@click.command()
@click.option(
    "--seeds", callback=seed_range, metavar="A..B", default="1..10", show_default=True, help="Both ends included."
)
@click.option("--jobs", type=click.IntRange(1, 64), default=1, show_default=True, help="Processes that fly at once.")
@click.option("-v", "--verbose", is_flag=True, help="Tell every event of every mission; flies one at a time.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per mission, the sum last.")
def campaign(seeds: range, jobs: int, verbose: bool, as_json: bool) -> None:
    """Fly missions under seeded faults and check what must always hold.

    A seed that fails prints what broke, and fails again in the same way with `--seeds N -v`.
    """
    import msgspec

    from jezero.deploy.campaign.campaign import fly_campaign
    from jezero.deploy.campaign.mission import fly_mission

    def tell(report: "MissionReport") -> None:
        if as_json:
            click.echo(json.dumps(msgspec.to_builtins(report)))
        else:
            _tell(report)

    mission = partial(fly_mission, tell=click.echo) if verbose else fly_mission
    result = fly_campaign(seeds, 1 if verbose else jobs, tell, mission)
    click.echo(json.dumps(msgspec.to_builtins(result)) if as_json else _words(result))
    if result.failed:
        raise SystemExit(ABORTED)


def _tell(report: "MissionReport") -> None:
    faults = ", ".join(kind if count == 1 else f"{count} x {kind}" for kind, count in report.faults.items())
    verdict = "FAILED" if report.violations else "ok"
    click.echo(f"seed {report.seed}: {verdict} after {report.sim_time_s:.0f} s; {faults}")
    for violation in report.violations:
        click.echo(f"    {violation}")


def _words(result: "CampaignReport") -> str:
    def table(title: str, counts: dict[str, int]) -> str:
        rows = "".join(f"\n  {count:7d}  {name}" for name, count in counts.items())
        return f"{title}{rows}"

    failed = ", ".join(map(str, result.failed)) or "none"
    return "\n".join(
        (
            table("faults", result.faults),
            table("states reached", result.states),
            table("goals", result.goals),
            f"{result.seeds} missions, {result.sim_time_s / 3600.0:.2f} h of flight; failed: {failed}",
        )
    )
