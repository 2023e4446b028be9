"""Commands of the section "Records": messages shown to a viewer, and recordings shown, changed and drawn.

`jezero replay` and `jezero tune` have files of their own.
"""

import json
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from jezero.base.extras import require
from jezero.base.router_address import is_loopback, shown_router
from jezero.cli import completion
from jezero.cli.options import FINITE, RECORDING_PATH, CommandGroup, check_times, common_options, vehicle_option
from jezero.cli.terminal import UNREACHABLE, Printer
from jezero.schemas.units import NS_PER_S

if TYPE_CHECKING:
    from jezero.recording import RecordedGoal, Recording
    from jezero.report.style import Format

PORT = 8765
"""The port that Foxglove suggests."""
CONNECT_TIMEOUT_S = 3.0
POLL_PERIOD_S = 0.2
"""Longest time until images are sent to somebody who has just subscribed to them."""
DATES_FROM_NS = 10**18
"""Recordings over Zenoh have times since 1970, of this size since 2001; virtual time starts at 0."""


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

    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig
    from jezero.base.zenoh_client import client_config
    from jezero.client.session import hidden_reason
    from jezero.keys.diagnosis import connection_problem
    from jezero.recording.live import LiveServer, ServeError, VehicleMessages
    from jezero.recording.viewer_scene import ViewerScene

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


class RecordingGroup(CommandGroup):
    """Group whose commands end with one sentence when a recording can't be read."""

    def invoke(self, ctx: click.Context) -> object:
        from jezero.recording import RecordingError

        try:
            return super().invoke(ctx)
        except RecordingError as error:
            raise click.ClickException(str(error)) from None


@click.group(cls=RecordingGroup)
def recording() -> None:
    """Look into recordings of flights, cut, repair, export and import them.

    FILE is a recording, or the folder of a run: its recording is flight.mcap, else the newest one in its folder
    recordings, as of `jezero up`. Foxglove, PlotJuggler and `import jezero.recording` read recordings too.
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
@click.option("--csv", "folder", type=click.Path(path_type=Path, file_okay=False),
              help="Folder for the tables, one file for each topic.")  # fmt: skip
@click.option("--rosbag2", "bag", type=click.Path(path_type=Path, file_okay=False), help="The rosbag2, a new folder.")
@click.option(
    "--topic",
    "topics",
    multiple=True,
    shell_complete=completion.topics,
    help="Only this topic as a table; may be given several times.",
)
@click.option("--storage", type=click.Choice(["sqlite3", "mcap"]), default="sqlite3", show_default=True,
              help="Storage of the rosbag2.")  # fmt: skip
@click.option("--humble", is_flag=True, help="A rosbag2 for ROS 2 Humble; else for Jazzy and later.")
@click.option("--no-images", is_flag=True, help="A rosbag2 without the camera's images.")
@vehicle_option("Vehicle's name, in the names of the rosbag2's topics.")
def export(
    file: Path,
    folder: Path | None,
    bag: Path | None,
    topics: tuple[str, ...],
    storage: str,
    humble: bool,
    no_images: bool,
    vehicle: str,
) -> None:
    """Write the messages of FILE as tables (CSV), one for each topic, or as a rosbag2.

    A column of a table is one number: `pos_uav_ned_m.n` is the position's component to the north, in m. A rosbag2 has
    the topics that `jezero ros2 bridge` publishes.
    """
    from jezero.recording import open_recording
    from jezero.recording.export import write_csv

    if (folder is None) is (bag is None):
        raise click.UsageError("give --csv FOLDER for tables, or --rosbag2 FOLDER for a rosbag2")
    if bag is None:
        assert folder is not None
        for path, rows in write_csv(open_recording(file), folder, topics):
            click.echo(f"wrote {path}: {rows} rows")
        return
    require("a rosbag2", "rosbags")
    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig
    from jezero.services.ros2_bridge.bag import write_bag
    from jezero.services.ros2_bridge.rows import ros_name

    counts = write_bag(
        open_recording(file),
        bag,
        load_config(VehicleConfig, "vehicle"),
        vehicle=ros_name(vehicle),
        version=8 if humble else 9,
        mcap=storage == "mcap",
        images=not no_images,
    )
    for name, count in counts.items():
        click.echo(f"{name:<34} {count:>7}")
    click.echo(f"wrote {bag}: {sum(counts.values())} messages, among them /clock; play it with `ros2 bag play {bag}`")


@recording.command("import")
@click.argument("bag", type=click.Path(path_type=Path, exists=True))
@click.argument("target", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--topic", "topics", multiple=True, metavar="ROS=JEZERO",
              help="A topic of BAG that has another name than the bridge's; may be given several times.")  # fmt: skip
@vehicle_option("Vehicle's name, in the names of BAG's topics.")
def import_(bag: Path, target: Path, topics: tuple[str, ...], vehicle: str) -> None:
    """Make a recording, TARGET, of BAG, a rosbag2: the estimator runs on its messages.

    BAG is one of `jezero recording export`, one of `ros2 bag record` with the topics of `jezero ros2 bridge`, or
    anybody's with odometry of vehicle and rover and UWB ranges: `--topic /odom=odometry --topic
    /husky/odom=rover/odometry --topic /uwb/0=sensor/uwb`. `jezero info page ros2` lists what is read. TARGET can be
    replayed through the estimator, with other settings too, and drawn as every recording.
    """
    require("a rosbag2", "rosbags")
    from jezero.replay.rosbag import import_bag
    from jezero.services.ros2_bridge.rows import ros_name

    names = dict(_name_pair(text) for text in topics)
    done = import_bag(bag, target, namespace=ros_name(vehicle), names=names)
    for source, name, kind in done.sources:
        click.echo(f"{source:<18} from {name} ({kind})")
    for name, count in done.left_out.items():
        click.echo(f"warning: {count} messages of {name} were left out: {done.reasons[name]}", err=True)
    click.echo("settings: " + ("those of the flight" if done.has_settings else "estimator.toml and vehicle.toml"))
    click.echo(
        f"wrote {target}: {done.counts['estimate/relative']} estimates of the relative position; "
        f"`jezero replay {target} --through estimator`"
    )


def _name_pair(text: str) -> tuple[str, str]:
    """Name in ROS and name in jezero of a topic, from what the user has given."""
    ros, equals, source = text.partition("=")
    if not (ros and equals and source):
        raise click.UsageError(f"--topic {text}: give the bag's name and jezero's, such as --topic /odom=odometry")
    return ros if ros.startswith("/") else f"/{ros}", source


@recording.command()
@click.argument("file", type=RECORDING_PATH)
@click.argument("target", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--from", "start_s", type=FINITE, default=0.0, help="Seconds from the start of FILE.")
@click.option("--to", "end_s", type=FINITE, help="Seconds from the start of FILE.")
@click.option("--topic", "topics", multiple=True, help="Only this topic; may be given several times.")
@click.option("--force", is_flag=True, help="Write over a file that exists.")
def cut(file: Path, target: Path, start_s: float, end_s: float | None, topics: tuple[str, ...], force: bool) -> None:
    """Write a part of FILE as a new recording, TARGET."""
    from jezero.recording import editing, open_recording

    check_times(start_s, end_s, "the new recording")
    if target.exists() and not force:
        raise click.ClickException(f"{target} exists: choose another name, or add --force")
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


@click.command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True), metavar="PATH...")
@click.option("--format", "form", type=click.Choice(["png", "pdf", "svg"]), default="png", show_default=True,
              help="Format of the figures; pdf and svg for papers.")  # fmt: skip
def report(paths: tuple[Path, ...], form: str) -> None:
    """Draw the figures of recorded flights into their folders.

    A PATH is the folder of a run (`jezero up`, `jezero demo`, `jezero fly --out`, `jezero getimages`,
    `jezero gridsweep`, `jezero bench landing --out`), a recording, or a file of `jezero bench landing --json`. Each
    recording of `jezero up` has its own folder of figures, beside it.

    Figures of a flight: position and status over time; for each orbit and coverage the path flown and the pictures.
    Figures of each landing on the rover: estimate and truth, the rover's position, UWB and tag, the touchdown; on a
    spot: the vehicle's odometry. Figures of images: a contact sheet, and for a coverage the planned and the flown path.
    Figure of several landings or a benchmark: the scatter of the touchdowns. In a recording without truth, as of a real
    vehicle, the figures show the estimate with three of its standard deviations instead of its error.
    """
    from jezero.report.report import ReportError, draw_report

    try:
        files = draw_report(paths, cast("Format", form), lambda text: click.echo(text, err=True))
    except ReportError as error:
        raise click.ClickException(str(error)) from error
    for file in files:
        click.echo(f"wrote {file}")
