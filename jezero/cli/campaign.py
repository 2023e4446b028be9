"""`jezero campaign`: missions in virtual time with faults drawn from a seed."""

import json
import re
from collections.abc import Iterable
from contextlib import closing
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jezero.cli.exit_codes import ABORTED

if TYPE_CHECKING:
    from jezero.trials.campaign.campaign import CampaignReport
    from jezero.trials.campaign.mission import MissionReport

LONGEST = 1_000_000
FAULTS_MAX = 200


def seed_range(ctx: click.Context, param: click.Parameter, value: str | None) -> range | None:
    """Parse `A..B`, both ends included, or one number."""
    if value is None:
        return None
    first, last = _two(value, "seeds", "1..100")
    if not first <= last < first + LONGEST:
        raise click.BadParameter(f"{value!r}: the last seed must follow the first, by less than {LONGEST}")
    return range(first, last + 1)


def fault_range(ctx: click.Context, param: click.Parameter, value: str | None) -> range | None:
    """Parse `A..B`, both ends included, or one number."""
    if value is None:
        return None
    least, most = _two(value, "faults", "30..50")
    if not 1 <= least <= most <= FAULTS_MAX:
        raise click.BadParameter(
            f"{value!r}: a mission has 1 to {FAULTS_MAX} faults, and the smaller number comes first"
        )
    return range(least, most + 1)


def _two(value: str, what: str, example: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,9})(?:\.\.(\d{1,9}))?", value)
    if match is None:
        raise click.BadParameter(f"{value!r} is not a range of {what}: write for example {example}, or one number")
    return int(match[1]), int(match[2] or match[1])


@click.command()
@click.option("--seeds", callback=seed_range, metavar="A..B", help="Seeds, both ends included [default: 1..10].")
@click.option("--commit", metavar="REV", help="Seeds of a commit, e.g. HEAD; needs --minutes.")
@click.option("--minutes", type=click.FloatRange(min=0.0), help="Start no mission after this time.")
@click.option(
    "--world",
    type=click.Choice(("physics", "point-mass")),
    default="physics",
    show_default=True,
    help="The point mass replaces simulator and autopilot, for many seeds in a short time.",
)
@click.option("--faults", callback=fault_range, metavar="A..B", help="Faults in each mission [default: 3..14].")
@click.option("--jobs", type=click.IntRange(1, 64), default=1, show_default=True, help="Number of processes.")
@click.option("--recordings", type=click.Path(path_type=Path, file_okay=False), default=Path("runs/campaign"),
              show_default=True, metavar="FOLDER", help="Where missions that break a rule are recorded.")  # fmt: skip
@click.option("-v", "--verbose", is_flag=True, help="Print every event; flies one mission at a time.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per mission, the sum last.")
def campaign(
    seeds: range | None,
    commit: str | None,
    minutes: float | None,
    world: str,
    faults: range | None,
    jobs: int,
    recordings: Path,
    verbose: bool,
    as_json: bool,
) -> None:
    """Fly missions with seeded faults and check the rules that must always hold.

    A mission that breaks a rule prints it, and is flown once more with a recording, for `jezero report`. The same seed
    breaks it again: `--seeds N -v` with the same --world and --faults shows all its events.
    """
    import msgspec

    from jezero.trials.campaign.campaign import CampaignReport, fly_campaign
    from jezero.trials.campaign.faults import FAULT_COUNTS
    from jezero.trials.campaign.mission import fly_mission
    from jezero.trials.campaign.seeds import seeds_for_minutes

    if commit is not None and (seeds is not None or minutes is None):
        raise click.UsageError("--commit replaces --seeds and needs --minutes: give --commit and --minutes only")
    chosen: Iterable[int] = range(1, 11) if seeds is None else seeds
    if commit is not None:
        chosen = _seeds_of(commit)
    if minutes is not None:
        chosen = seeds_for_minutes(chosen, minutes)

    def print_report(report: "MissionReport") -> None:
        if as_json:
            click.echo(json.dumps(msgspec.to_builtins(report)))
        else:
            _print_report(report)

    mission = partial(fly_mission, world=world, fault_counts=faults or FAULT_COUNTS, recordings=recordings)
    if verbose:
        mission = partial(mission, on_event=click.echo)
    result = CampaignReport()
    try:
        with closing(fly_campaign(chosen, 1 if verbose else jobs, mission)) as reports:
            for report in reports:
                result.add(report)
                print_report(report)
    finally:  # also after Ctrl-C
        click.echo(json.dumps(msgspec.to_builtins(result)) if as_json else _summary(result))
    if result.failed:
        raise SystemExit(ABORTED)


def _seeds_of(revision: str) -> Iterable[int]:
    """Endless seeds of a commit; the seeds from 0 on without a git checkout."""
    from jezero.trials.campaign.seeds import NoCheckoutError, commit_hash, first_seed

    first = 0
    try:
        commit = commit_hash(revision, Path.cwd())
        first = first_seed(commit)
        source = f"seeds of commit {commit[:12]}"
    except NoCheckoutError as error:
        source = f"no commit {revision} here ({error}): seeds from 0 on, of no commit"
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--commit") from None
    click.echo(f"{source}: {first}, {first + 1}, {first + 2}, …", err=True)
    return count(first)


def _print_report(report: "MissionReport") -> None:
    faults = ", ".join(kind if count == 1 else f"{count} x {kind}" for kind, count in report.faults.items())
    outcome = "FAILED" if report.violations else "ok"
    click.echo(f"seed {report.seed}: {outcome} after {report.sim_time_s:.0f} s; {faults}")
    for violation in report.violations:
        click.echo(f"    {violation}")
    if report.recording:
        click.echo(f"    recorded in {report.recording}")


def _summary(result: "CampaignReport") -> str:
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
