"""`jezero recording`: what is in a recording, parts of it, and tables for other programs."""

import json
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jezero.cli.shared import FINITE
from jezero.schemas.units import NS_PER_S

if TYPE_CHECKING:
    from jezero.recording import RecordedGoal, Recording

DATES_FROM_NS = 10**18
"""Recordings over Zenoh have times since 1970, of this size since 2001; virtual time starts at 0."""
RECORDING_PATH = click.Path(path_type=Path)


class RecordingGroup(click.Group):
    """Group whose commands end with one sentence when a recording can't be read."""

    def invoke(self, ctx: click.Context) -> object:
        from jezero.recording import RecordingError

        try:
            return super().invoke(ctx)
        except RecordingError as error:
            raise click.ClickException(str(error)) from None


@click.group(cls=RecordingGroup)
def recording() -> None:
    """Look into recordings of flights, cut, repair and export them.

    FILE is a recording, or the folder of a run, whose recording is flight.mcap. Foxglove, PlotJuggler and
    `import jezero.recording` read recordings too.
    """


@recording.command()
@click.argument("file", type=RECORDING_PATH)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def info(file: Path, as_json: bool) -> None:
    """Show what FILE holds: its origin, how long it lasts, its goals, and how many messages each topic has."""
    from jezero.recording import open_recording

    opened = open_recording(file)
    summary = opened.summary()
    size_bytes = opened.path.stat().st_size
    origin = {name: value for name, value in summary.about.items() if not name.startswith("settings/")}
    if as_json:
        goals, problem = _goals(opened)
        fields = {"file": str(opened.path), "size_bytes": size_bytes, **asdict(summary)}
        fields |= {"goals": [_goal_fields(goal) for goal in goals], "goals_problem": problem}
        click.echo(json.dumps(fields))
        return
    hint = f"`jezero recording repair {file}` finishes it"
    rows = [
        ("file", str(opened.path)),
        ("size", f"{size_bytes / 1e6:.1f} MB"),
        ("duration", f"{summary.duration_s:.1f} s"),
        ("start", _time_text(summary.start_ns)),
        ("end", _time_text(summary.end_ns)),
        ("messages", f"{sum(summary.counts.values())}"),
        *((name, value) for name, value in origin.items() if value),
        ("state", f"{summary.problem}: {hint}" if summary.problem else "finished"),
    ]
    for name, value in rows:
        click.echo(f"{name:<11}{value}")
    _print_goals(opened)
    click.echo("topics")
    width = max(map(len, summary.counts), default=0)
    for topic, count in summary.counts.items():
        rate_hz = count / summary.duration_s if summary.duration_s else 0.0
        click.echo(f"  {topic:<{width}}  {count:>7}  {rate_hz:>6.1f} Hz  {summary.schemas.get(topic, '')}")


def _goal_fields(goal: "RecordedGoal") -> dict[str, Any]:
    """What `info --json` shows of a goal."""
    return {
        "goal_id": goal.goal_id,
        "action": goal.action,
        "start_s": goal.start_s,
        "duration_s": goal.duration_s,
        "outcome": goal.outcome,
        "reason": goal.reason,
    }


def _goals(opened: "Recording") -> tuple[list["RecordedGoal"], str]:
    """The goals, and why they can't be read, or ""; the rest can be shown all the same."""
    from jezero.recording import RecordingError

    try:
        return opened.goals(), ""
    except RecordingError as error:
        return [], str(error)


def _print_goals(opened: "Recording") -> None:
    """A line for each goal: when it started, and how it ended."""
    goals, problem = _goals(opened)
    if problem:
        click.echo(f"{'goals':<11}not shown: {problem}")
    if goals:
        click.echo("goals, by seconds from the start")
    width = max((len(goal.action) for goal in goals), default=0)
    for goal in goals:
        click.echo(f"  {goal.start_s:>7.1f} s  {goal.action:<{width}}  {_end_in_words(goal)}")


def _end_in_words(goal: "RecordedGoal") -> str:
    match goal.outcome:
        case "rejected":
            return f"rejected: {goal.reason}"
        case "unknown":
            return f"runs for {goal.duration_s:.1f} s; its end is not recorded"
        case _:
            return f"{goal.outcome} after {goal.duration_s:.1f} s{': ' if goal.reason else ''}{goal.reason}"


def _time_text(logged_ns: int) -> str:
    """Time of a recording's clock: the local date, or vehicle time of a flight in virtual time."""
    if logged_ns < DATES_FROM_NS:
        return f"{logged_ns / NS_PER_S:.3f} s of virtual time"
    at = datetime.fromtimestamp(logged_ns / NS_PER_S).astimezone()
    return f"{at:%Y-%m-%d %H:%M:%S}.{at.microsecond // 1000:03d} {at:%z}"


@recording.command()
@click.argument("file", type=RECORDING_PATH)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def settings(file: Path, as_json: bool) -> None:
    """Show every setting that was in force in the services that started during FILE, defaults included."""
    from jezero.recording import open_recording
    from jezero.recording.journals import settings_of

    found = settings_of(open_recording(file).path)
    if as_json:
        click.echo(json.dumps(found))
        return
    if not found:
        raise click.ClickException(f"{file} has no start of a service: give a recording that begins with the stack")
    for service, values in found.items():
        click.echo(service)
        for name, value in values.items():
            click.echo(f"  {name} = {json.dumps(value)}")


@recording.command()
@click.argument("file", type=RECORDING_PATH)
@click.option("--csv", "folder", type=click.Path(path_type=Path, file_okay=False), required=True,
              help="Folder for the tables, one file for each topic.")  # fmt: skip
@click.option("--topic", "topics", multiple=True, help="Only this topic; may be given several times.")
def export(file: Path, folder: Path, topics: tuple[str, ...]) -> None:
    """Write the messages of FILE as tables (CSV), one for each topic.

    A column is one number: `pos_uav_ned_m.n` is the position's component to the north, in m.
    """
    from jezero.recording import open_recording
    from jezero.recording.export import write_csv

    for path, rows in write_csv(open_recording(file), folder, topics):
        click.echo(f"wrote {path}: {rows} rows")


@recording.command()
@click.argument("file", type=RECORDING_PATH)
@click.argument("target", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--from", "start_s", type=FINITE, default=0.0, help="Seconds from the start of FILE.")
@click.option("--to", "end_s", type=FINITE, help="Seconds from the start of FILE.")
@click.option("--topic", "topics", multiple=True, help="Only this topic; may be given several times.")
def cut(file: Path, target: Path, start_s: float, end_s: float | None, topics: tuple[str, ...]) -> None:
    """Write a part of FILE as a new recording, TARGET."""
    from jezero.recording import editing, open_recording

    written = editing.cut(open_recording(file).path, target, start_s, end_s, topics)
    click.echo(f"wrote {target}: {written} messages")


@recording.command()
@click.argument("file", type=RECORDING_PATH)
def repair(file: Path) -> None:
    """Finish FILE, which was cut or damaged, so that every viewer opens it; the old file stays beside it."""
    from jezero.recording import editing, open_recording

    path = open_recording(file).path
    count, problem = editing.repair(path)
    if problem:
        click.echo(f"{path}: {problem}. {count} messages are in the finished file; the old one is {path}.damaged")
    else:
        click.echo(f"{path} is finished and whole: {count} messages")
