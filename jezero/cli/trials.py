"""The commands of the section "Tests": missions with faults drawn from a seed, and benchmarks, in virtual time."""

import json
import re
from collections.abc import Iterable
from contextlib import closing
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from jezero.cli.options import CommandGroup, world_option
from jezero.cli.terminal import ABORTED, FAILED

if TYPE_CHECKING:
    from jezero.trials.campaign.campaign import CampaignReport
    from jezero.trials.campaign.mission import MissionReport
    from jezero.trials.landing.benchmark import LandingReport
    from jezero.trials.landing.flight import Landing
    from jezero.trials.landing.trial import CaseName

LONGEST = 1_000_000
FAULTS_MAX = 200
BIAS_MAX_M = 10.0
CASES = ("uwb+tag", "uwb", "tag", "none")


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
    "--model",
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
    model: str,
    faults: range | None,
    jobs: int,
    recordings: Path,
    verbose: bool,
    as_json: bool,
) -> None:
    """Fly missions with seeded faults and check the rules that must always hold.

    A mission that breaks a rule prints it, and is flown once more with a recording, for `jezero report`. The same seed
    breaks it again: `--seeds N -v` with the same --model and --faults shows all its events.
    """
    import msgspec

    from jezero.trials.campaign.campaign import CampaignReport, fly_campaign, seeds_for_minutes
    from jezero.trials.campaign.faults import FAULT_COUNTS
    from jezero.trials.campaign.mission import fly_mission

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

    mission = partial(fly_mission, model=model, fault_counts=faults or FAULT_COUNTS, recordings=recordings)
    if verbose:
        mission = partial(mission, on_event=click.echo)
    result, finished = CampaignReport(), False
    try:
        with closing(fly_campaign(chosen, 1 if verbose else jobs, mission)) as reports:
            for report in reports:
                result.add(report)
                print_report(report)
        finished = True
    finally:
        if finished or result.seeds:  # also after Ctrl-C
            click.echo(json.dumps(msgspec.to_builtins(result)) if as_json else _summary(result))
    if result.failed:
        raise SystemExit(ABORTED)


def _seeds_of(revision: str) -> Iterable[int]:
    """Endless seeds of a commit; the seeds from 0 on without a git checkout."""
    from jezero.trials.campaign.campaign import NoCheckoutError, commit_hash, first_seed

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


class _Bias(click.ParamType[tuple[float, ...]]):
    """Numbers in metres, separated by commas."""

    name = "bias"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        try:
            biases_m = tuple(float(part) for part in value.split(","))
        except ValueError:
            self.fail(f"{value!r}: expected metres separated by commas, as 0.3 or 0.3,0,0,0", param, ctx)
        if any(not abs(bias_m) <= BIAS_MAX_M for bias_m in biases_m):
            self.fail(f"{value!r}: each error lies within {BIAS_MAX_M:g} m", param, ctx)
        return biases_m


def _sea(
    ctx: click.Context, param: click.Parameter, value: tuple[float, float, float] | None
) -> tuple[float, float, float] | None:
    """Check height, period and tilt of the waves as the simulator's settings do."""
    import msgspec

    from jezero.base.mistakes import mistake
    from jezero.services.simulator.config import SeaConfig

    if value is None:
        return None
    try:
        msgspec.convert(dict(zip(("wave_height_m", "period_s", "tilt_deg"), value, strict=True)), SeaConfig)
    except msgspec.ValidationError as error:
        raise click.BadParameter(f"{mistake(error, SeaConfig)}; write for example --sea 0.5 5 5") from None
    return value


@click.group(cls=CommandGroup)
def bench() -> None:
    """Fly benchmarks in virtual time; no running stack is needed."""


@bench.command()
@click.option(
    "--case",
    type=click.Choice(["all", *CASES]),
    default="all",
    show_default=True,
    help="Sensors in use.",
)
@click.option("--n", type=click.IntRange(1, 100_000), default=100, show_default=True, help="Landings of each case.")
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="First seed.")
@click.option("--rover", type=click.Choice(["still", "drive", "turn", "zigzag", "fast"]), default="still",
              show_default=True,
              help="Motion: none; 0.5 m/s straight; 1 m/s and 0.2 rad/s; 0.8 m/s, turning left and right; "
              "4 m/s straight.")  # fmt: skip
@click.option("--wind", "wind_mps", type=click.FloatRange(0.0, 30.0), default=3.0, show_default=True, metavar="MEAN",
              help="Speed of the mean wind, in m/s.")  # fmt: skip
@click.option("--gusts", "std_gust_mps", type=click.FloatRange(0.0, 10.0), default=0.6, show_default=True,
              metavar="STD", help="Standard deviation of the gusts, in m/s.")  # fmt: skip
@click.option("--wind-change", "wind_change_mps", type=click.FloatRange(0.0, 30.0), metavar="MEAN",
              help="Mean wind, from another direction, from a random time of the landing on.")  # fmt: skip
@click.option("--tilt", "tilt_deg", type=click.FloatRange(0.0, 30.0), default=0.0, show_default=True, metavar="DEG",
              help="Tilt of the rover's platform, in a random direction.")  # fmt: skip
@click.option("--sea", nargs=3, type=float, metavar="HEIGHT PERIOD TILT", callback=_sea,
              help="Waves under the rover: significant height in m, period in s, tilt in degrees.")  # fmt: skip
@click.option("--rocks", is_flag=True, help="The rover drives over rocks, and its platform leans and heaves with it.")
@click.option("--compass-step", "compass_step_deg", type=click.FloatRange(-180.0, 180.0), default=0.0,
              show_default=True, metavar="DEG",
              help="Jump of the vehicle's compass at a random time of the landing.")  # fmt: skip
@click.option("--jobs", type=click.IntRange(1, 256), default=1, show_default=True, help="Number of processes.")
@click.option("--tags", type=click.Choice(["projected", "rendered"]), default="projected", show_default=True,
              help="Calculate the tags' corners, or render images and detect.")  # fmt: skip
@click.option(
    "--uwb-std",
    "uwb_std_m",
    type=click.FloatRange(0.0, 10.0),
    metavar="M",
    help="Standard deviation of a UWB range [default: 0.01, case uwb: 0.1].",
)
@click.option("--uwb-outliers", type=click.FloatRange(0.0, 1.0), metavar="SHARE",
              help="Share of UWB ranges that are 0.5 to 3 m too long [default: 0, case uwb: 0.1].")  # fmt: skip
@click.option("--uwb-bias", "uwb_bias_m", type=_Bias(), default=(), metavar="M[,M...]",
              help="Constant error of the UWB ranges: one number for all anchors, or one for each.")  # fmt: skip
@click.option("--anchors", type=click.Choice(["right", "rotated"]), default="right", show_default=True,
              help="Rotated: each UWB anchor stands where the next one should.")  # fmt: skip
@click.option("--tag-side", "tag_side_m", type=click.FloatRange(0.2, 0.8), metavar="M",
              help="Side of the big tag as it was printed [default: as configured].")  # fmt: skip
@click.option("--rover-compass", "rover_compass_deg", type=click.FloatRange(-180.0, 180.0), default=0.0,
              show_default=True, metavar="DEG", help="Constant error of the rover's compass.")  # fmt: skip
@click.option("--camera-delay", "camera_delay_s", type=click.FloatRange(0.0, 1.0), metavar="S",
              help="Seconds from exposure to the image [default: 0.1].")  # fmt: skip
@click.option("--hide-tag", is_flag=True, help="Hide the tags twice, for a second each.")
@click.option("--tag-until", "tag_until_m", type=click.FloatRange(0.0, 20.0), metavar="M",
              help="Hide the tags below this height above the platform.")  # fmt: skip
@click.option("--record", "--out", "out", type=click.Path(path_type=Path, file_okay=False), metavar="FOLDER",
              help="Record each landing, about 2 MB, for `jezero report`.")  # fmt: skip
@world_option
@click.option("--json", "as_json", is_flag=True, help="One JSON object per case; `jezero report` draws them.")
def landing(
    case: str, n: int, seed: int, jobs: int, anchors: str, out: Path | None, as_json: bool, **conditions: Any
) -> None:
    """Land many times, from random positions 4 to 8 m up and up to 8 m away.

    Prints the touchdown error, the time, the error of the position estimate by range, its consistency (NEES), and the
    failed and crashed seeds. A vehicle that lies on its side, hits something faster than 1 m/s, or runs its motors on
    the ground at the end, has crashed.
    """
    import msgspec

    from jezero.trials.landing.benchmark import fly_landings
    from jezero.trials.landing.trial import Conditions

    failed = False
    for name in CASES if case == "all" else (case,):
        conditions_of_case = Conditions(case=cast("CaseName", name), anchors_rotated=anchors == "rotated", **conditions)
        report = fly_landings(conditions_of_case, n, seed, jobs, _print_nothing if as_json else _print_landing, out)
        click.echo(msgspec.json.encode(report).decode() if as_json else _table(report))
        failed |= bool(report.failed_seeds)
    if failed:
        raise SystemExit(FAILED)


def _print_nothing(landing: "Landing") -> None:
    pass


def _print_landing(landing: "Landing") -> None:
    if landing.failure:
        click.echo(f"seed {landing.seed}: {'crashed: ' if landing.crashed else ''}{landing.failure}")
        return
    where = f"{100.0 * landing.error_m:.1f} cm from the target after {landing.time_s:.1f} s"
    click.echo(f"seed {landing.seed}: {where}, impact at {landing.impact_mps:.2f} m/s")


def _table(report: "LandingReport") -> str:
    error_m, time_s, rmse_m = report.touchdown_error_m, report.time_s, report.rmse_m
    rows = (
        ("landed", f"{report.landed} of {report.n}"),
        ("crashed", f"{report.crashed} of {report.n}"),
        ("around", f"{report.gone_around} of {report.n} went around after a bad contact"),
        ("touchdown", f"median {_cm(error_m['median'])}, p95 {_cm(error_m['p95'])}, max {_cm(error_m['max'])} cm"),
        ("time", f"median {_s(time_s['median'])}, p95 {_s(time_s['p95'])} s"),
        ("estimate", f"RMSE {_cm(rmse_m['below_3m'])} cm below 3 m, {_cm(rmse_m['3_to_8m'])} cm from 3 to 8 m"),
        ("NEES", "no estimate" if report.nees is None else f"{report.nees:.2f} (1 is consistent)"),
        ("failed", ", ".join(map(str, report.failed_seeds)) or "none"),
    )
    title = f"{report.case}, rover: {report.rover}"
    return "\n".join((title, *(f"  {name:<10}{text}" for name, text in rows)))


def _cm(value_m: float | None) -> str:
    return "-" if value_m is None else f"{100.0 * value_m:.1f}"


def _s(value_s: float | None) -> str:
    return "-" if value_s is None else f"{value_s:.1f}"
