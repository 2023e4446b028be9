"""Parts that the commands share: options, what is printed, the connection, and a goal that is followed to its end."""

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from jezero.cli.exit_codes import ABORTED, REFUSED, UNREACHABLE
from jezero.cli.plan import minutes
from jezero.keys.bundle import INSECURE_VARIABLE, endpoint_of
from jezero.keys.bundle import VARIABLE as KEYS_VARIABLE
from jezero.router_address import insecurity

if TYPE_CHECKING:
    from rich.progress import Progress

    from jezero.client import Goal, Vehicle

FRAMES = click.Choice(["world", "rover"])
PLAIN_PERIOD_S = 1.0
KEYS, INSECURE = "jezero.keys", "jezero.insecure"
"""Names under which click's context has the values of these options."""


class Finite(click.ParamType[float]):
    """A number that is neither NaN nor infinite."""

    name = "float"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number: float = click.FLOAT.convert(value, param, ctx)
        if not isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


class Router(click.ParamType[str]):
    """The address of a router, which becomes its endpoint with what `keys_option` and `insecure_option` say."""

    name = "address"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        try:
            meta = ctx.meta if ctx else {}
            insecure = bool(meta.get(INSECURE)) or os.environ.get(INSECURE_VARIABLE) == "1"
            return endpoint_of(value, meta.get(KEYS), insecure=insecure)
        except ValueError as error:
            self.fail(str(error), param, ctx)


class FiniteRange(click.FloatRange):
    """A number within limits. Its parent class takes NaN, which no comparison excludes."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        return FINITE.convert(super().convert(value, param, ctx), param, ctx)


FINITE = Finite()
NUMBERS = {"ignore_unknown_options": True}  # "-4" is a coordinate, not an option


def common_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of every command that connects to a vehicle."""
    json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object per line, the result last.")
    return vehicle_options(json_option(command))


def _keep(ctx: click.Context, param: click.Parameter, value: Any) -> Any:
    """Keep an option's value for the type `Router`."""
    ctx.meta[f"jezero.{param.name}"] = value
    return value


def insecure_option(text: str, *, expose_value: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The option that permits addresses without TLS, which the type `Router` uses.

    Args:
        text: help.
        expose_value: whether the command gets its value too.
    """
    return click.option(
        "--insecure",
        is_flag=True,
        default=None,
        is_eager=True,
        expose_value=expose_value,
        callback=_keep,
        help=text,
    )


def keys_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option of the bundle, which the type `Router` uses."""
    return click.option(
        "--keys",
        envvar=KEYS_VARIABLE,
        type=click.Path(path_type=Path, exists=True, file_okay=False),
        is_eager=True,
        expose_value=False,
        callback=_keep,
        help="Folder of the bundle of `jezero keys`, for an address with tls.",
    )(command)


def vehicle_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that name a vehicle, its router and the bundle for it."""
    command = insecure_option("Connect to another computer without TLS, on a network that you trust.")(command)
    command = keys_option(command)
    command = click.option(
        "--router",
        envvar="JEZERO_ROUTER",
        type=Router(),
        default="tcp/127.0.0.1:7447",
        show_default=True,
        help="Router's endpoint.",
    )(command)
    return click.option(
        "--vehicle", envvar="JEZERO_VEHICLE", default="uav1", show_default=True, help="Vehicle's name."
    )(command)


def flight_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of every command that sends a goal."""
    command = click.option("--yes", is_flag=True, help="Fly for more than a minute without a question.")(command)
    return common_options(command)


class Printer:
    """Prints events as text with a progress bar on a terminal, as plain lines into a pipe, or as JSON lines."""

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json
        self._bar: Progress | None = None
        self._printed_s = -PLAIN_PERIOD_S
        self._warned: set[str] = set()

    def event(self, kind: str, text: str, **fields: Any) -> None:
        """Print one event: `text` for people, or `fields` as JSON."""
        self._end_bar()
        click.echo(json.dumps({"type": kind, **fields}) if self.as_json else text)

    def warn(self, text: str) -> None:
        """Print a warning for people, once; programs find it in the events. "" is none."""
        if text and not self.as_json and text not in self._warned:
            self._end_bar()
            self._warned.add(text)
            click.echo(f"warning: {text}", err=True)

    def hint(self, text: str) -> None:
        """Print a line for the person at the terminal."""
        if not self.as_json and sys.stdout.isatty():
            click.secho(text, dim=True)

    def progress(self, text: str, done: float | None, **fields: Any) -> None:
        """Print feedback: a bar on a terminal, a line per second into a pipe. `done` is a fraction from 0 to 1."""
        if self.as_json:
            click.echo(json.dumps({"type": "feedback", **fields}))
        elif sys.stdout.isatty():
            self._draw(text, done)
        elif time.monotonic() - self._printed_s >= PLAIN_PERIOD_S:
            self._printed_s = time.monotonic()
            click.echo(text)

    def fail(self, kind: str, text: str, exit_code: int, **fields: Any) -> NoReturn:
        """End the command with JSON on standard output, a sentence on standard error, and an exit code."""
        self._end_bar()
        if self.as_json:
            click.echo(json.dumps({"type": kind, **fields}))
        click.echo(text, err=True)
        raise SystemExit(exit_code)

    def _draw(self, text: str, done: float | None) -> None:
        from rich.progress import BarColumn, Progress, TextColumn

        if self._bar is None:
            self._bar = Progress(BarColumn(24), TextColumn("{task.description}"), transient=True)
            self._bar.start()
            self._bar.add_task(text, total=None)
        self._bar.update(self._bar.task_ids[0], description=text, completed=done or 0.0, total=done and 1.0)

    def _end_bar(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


@contextmanager
def connected(vehicle: str, router: str, printer: Printer) -> Iterator["Vehicle"]:
    """Connect for one command; an error of the client becomes a sentence and an exit code."""
    from jezero.client import Aborted, Canceled, JezeroError, Refused, Vehicle

    try:
        with Vehicle.connect(vehicle, router=router, insecure=True) as uav:  # `Router` has checked it
            printer.warn(insecurity(router))
            yield uav
    except Refused as error:
        printer.fail("rejected", f"refused: {error}", REFUSED, reason=str(error), code=error.code)
    except Canceled as error:
        printer.fail("result", f"canceled: {error}", ABORTED, outcome="canceled", reason=str(error))
    except Aborted as error:
        printer.fail("result", f"aborted: {error}", ABORTED, outcome="aborted", reason=str(error))
    except KeyboardInterrupt:
        printer.fail("interrupted", "interrupted", ABORTED, reason="interrupted")
    except JezeroError as error:
        printer.fail("unreachable", f"unreachable: {error}", UNREACHABLE, reason=str(error))


def fly_goal(printer: Printer, goal: "Goal[Any, Any]", name: str) -> None:
    """Follow a goal to its end. Ctrl+C cancels the goal; a second one ends the command at once."""
    import msgspec

    printer.event("accepted", f"{name}: accepted (goal {goal.goal_id})", goal_id=goal.goal_id, warning=goal.warning)
    printer.warn(goal.warning)
    try:
        _follow(printer, goal)
    except KeyboardInterrupt:
        printer.event("canceling", "canceling: the vehicle will hover where it is", goal_id=goal.goal_id)
        goal.cancel()
        _follow(printer, goal)
    result = msgspec.to_builtins(goal.result())
    position = result.get("pos_uav_ned_m") or result.get("touchdown_ned_m")
    where = f" at {point_in_words(position)}" if position else ""
    printer.event("result", f"{name}: succeeded{where}", outcome="succeeded", goal_id=goal.goal_id, result=result)


def _follow(printer: Printer, goal: "Goal[Any, Any]") -> None:
    import msgspec

    from jezero.cli.goal_keys import GoalKeys

    farthest_m = 0.0
    with GoalKeys(printer, goal) as keys:
        for feedback in goal.feedback():
            keys.poll()
            fields = msgspec.to_builtins(feedback)
            distance_m, done = fields.get("distance_m"), None
            if distance_m is not None:
                farthest_m = max(farthest_m, distance_m)
                done = 1.0 - distance_m / farthest_m if farthest_m > 0.0 else 1.0
            text = f"{'paused, ' if goal.paused else ''}{_in_words(fields)}{time_to_go(goal)}"
            more = {"remaining_s": goal.remaining_s, "paused": goal.paused}
            printer.progress(text, done, goal_id=goal.goal_id, **more, **fields)


def time_to_go(goal: "Goal[Any, Any]") -> str:
    """The end of a line of progress; "" while the time is unknown."""
    return "" if goal.remaining_s is None else f", {minutes(goal.remaining_s)} to go"


def _in_words(feedback: dict[str, Any]) -> str:
    """A line for people from the feedback of any action."""
    fields = {name: value for name, value in feedback.items() if name != "kind"}
    parts = []
    if "pos_uav_ned_m" in fields:
        parts.append(f"position {point_in_words(fields.pop('pos_uav_ned_m'))} in {fields.pop('frame', 'world')}")
    if "distance_m" in fields:
        parts.append(f"{fields.pop('distance_m'):.2f} m to go")
    if "phase" in fields:
        parts.append(str(fields.pop("phase")))
    if "place" in fields:
        why = f" ({reason})" if (reason := fields.pop("reason", "")) else ""
        place = fields.pop("place").replace("_", " ")
        parts.append(f"landing here{why}" if place == "here" else f"to the {place}{why}")
    for name in ("pos_rel_ned_m", "cone_m", "place_ned_m", "landing"):  # for programs
        fields.pop(name, None)
    parts.extend(
        f"{name} {value:.2f}" if isinstance(value, float) else f"{name} {value}" for name, value in fields.items()
    )
    return ", ".join(parts)


def point_in_words(pos_ned_m: Any) -> str:
    return "({:.2f}, {:.2f}, {:.2f})".format(*pos_ned_m)
