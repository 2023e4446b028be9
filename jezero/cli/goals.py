"""The life of a goal on the command line: its plan, the question whether to fly it, its progress, images and end.

The plan of a goal is shown before the goal is sent where it takes more than a minute, and must be confirmed then. While
the goal is flown, keys pause and resume it, and Ctrl+C cancels it.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import click
import msgspec

from jezero.cli.terminal import FAILED, USAGE, Keyboard, Printer

if TYPE_CHECKING:
    from jezero.base.frames import Vec3
    from jezero.client import Goal, Vehicle
    from jezero.client.dataset import Dataset
    from jezero.client.images import ImagesGoal
    from jezero.schemas import goals
    from jezero.schemas.actions import FeedbackMessage, PlanReply
    from jezero.schemas.rows import Action

LONG_FLIGHT_S = 60.0
SHORT_PLAN_S = 1.0
"""A plan that takes longer is announced."""
HINT = "p pauses, r resumes, Ctrl+C cancels"


def send_goal(printer: Printer, uav: "Vehicle", action: "Action[Any]", goal: "goals.Goal", *, yes: bool) -> Any:
    """Send a goal after `agreed_plan`; returns the accepted goal.

    Raises:
        Refused: the vehicle refuses the goal.
    """
    return uav.send(action, as_planned(goal, agreed_plan(printer, uav, action, goal, yes=yes)))


def agreed_plan(
    printer: Printer, uav: "Vehicle", action: "Action[Any]", goal: "goals.Goal", *, yes: bool
) -> "PlanReply":
    """Plan a goal and show what the user should know; before a long flight, the user is asked on a terminal.

    Args:
        yes: the user has agreed already, with --yes.

    Raises:
        Refused: the vehicle refuses the goal.
    """
    with _planning_shown(printer, uav, action):
        plan = uav.plan(action, goal)
    long = plan.duration_s is not None and plan.duration_s > LONG_FLIGHT_S
    if long or plan.coverage is not None:
        show_plan(printer, plan, action.name)
    printer.warn(plan.warning)
    if long and not yes:
        confirm(printer)
    return plan


def as_planned(goal: "goals.Goal", plan: "PlanReply") -> "goals.Goal":
    """The goal that flies exactly the plan that was shown, where its action has such plans."""
    return goal if plan.coverage is None else msgspec.structs.replace(goal, plan_id=plan.coverage.plan_id)


@contextmanager
def _planning_shown(printer: Printer, uav: "Vehicle", action: "Action[Any]") -> Iterator[None]:
    """Show that a plan is being made, if it takes long."""
    if printer.as_json or not action.takes_pictures:
        yield
        return
    from jezero.schemas.topics import feedback_of

    begin_s = time.monotonic()

    def on_feedback(message: "FeedbackMessage[Any]") -> None:
        waited_s = time.monotonic() - begin_s
        if waited_s > SHORT_PLAN_S and getattr(message.feedback, "phase", "") == "planning":
            printer.progress(f"planning, {minutes(waited_s)}", None)

    subscription = uav.subscribe(feedback_of(action), on_feedback)
    try:
        yield
    finally:
        subscription.close()


def show_plan(printer: Printer, plan: "PlanReply", name: str) -> None:
    """Print what a goal flies: duration, length, battery, and for a coverage its images and the shares of the area."""
    text, coverage, fields = flight_in_words(plan), plan.coverage, {}
    if coverage is not None:
        fields = {"plan_id": coverage.plan_id, "covered": coverage.covered, "photographed": coverage.photographed}
        shares = (
            f"{100.0 * coverage.covered:.1f} % of the area swept, {100.0 * coverage.photographed:.1f} % photographed"
        )
        text = f"{text}; {len(coverage.pictures_ned_m)} images, {shares}"
    printer.event(
        "plan",
        f"{name}: {text}",
        warning=plan.warning,
        **fields,
        duration_s=plan.duration_s,
        distance_m=plan.distance_m,
        battery_used=plan.battery_used,
        battery_remaining=plan.battery_remaining,
        battery_critical=plan.battery_critical,
    )


def flight_in_words(plan: "PlanReply") -> str:
    """Duration, length and battery of a flight, as far as they are known."""
    parts = ["duration unknown" if plan.duration_s is None else minutes(plan.duration_s)]
    if plan.distance_m is not None:
        parts.append(f"{plan.distance_m:.0f} m")
    if plan.battery_used is not None:
        left = plan.battery_remaining
        known = [] if left is None else [f"{100.0 * left:.0f} % left"]
        if plan.battery_critical is not None:
            known.append(f"{100.0 * plan.battery_critical:.0f} % must be left")
        parts.append(f"{100.0 * plan.battery_used:.0f} % of the battery" + (f" ({', '.join(known)})" if known else ""))
    return ", ".join(parts)


def minutes(duration_s: float) -> str:
    """A duration for people: `42 s`, `5 min 12 s`."""
    whole_s = round(duration_s)
    return f"{whole_s} s" if whole_s < 60 else f"{whole_s // 60} min {whole_s % 60} s"


def confirm(printer: Printer) -> None:
    """Ask on a terminal; a script has to say --yes."""
    if printer.as_json or not _is_terminal():
        reason = "not sent: this flight takes more than a minute; add --yes to fly it without a question"
        printer.fail("unconfirmed", reason, USAGE, reason=reason)
    if not click.confirm("Fly it?", default=True, err=True):
        printer.fail("unconfirmed", "not sent", FAILED, reason="not confirmed")


def _is_terminal() -> bool:
    return sys.stdin.isatty()


def fly_goal(printer: Printer, goal: "Goal[Any, Any]", name: str) -> None:
    """Follow a goal to its end. Ctrl+C cancels the goal; a second one ends the command at once."""
    printer.event("accepted", f"{name}: accepted (goal {goal.goal_id})", goal_id=goal.goal_id, warning=goal.warning)
    printer.warn(goal.warning)
    _cancel_on_interrupt(printer, goal, lambda: _follow(printer, goal))
    result = msgspec.to_builtins(goal.result())
    position = result.get("pos_uav_ned_m") or result.get("touchdown_ned_m")
    where = f" at {point_in_words(position)}" if position else ""
    printer.event("result", f"{name}: succeeded{where}", outcome="succeeded", goal_id=goal.goal_id, result=result)


def _cancel_on_interrupt(printer: Printer, goal: "Goal[Any, Any]", follow: Callable[[], None]) -> None:
    """Follow a goal until it ends; Ctrl+C cancels it."""
    try:
        follow()
    except KeyboardInterrupt:
        printer.event("canceling", "canceling: the vehicle will hover where it is", goal_id=goal.goal_id)
        goal.cancel()
        follow()


def _follow(printer: Printer, goal: "Goal[Any, Any]") -> None:
    farthest_m = 0.0
    with GoalKeys(printer, goal) as keys:
        for feedback in goal.feedback():
            keys.poll()
            fields = msgspec.to_builtins(feedback)
            distance_m, done = fields.get("distance_m"), None
            if distance_m is not None:
                farthest_m = max(farthest_m, distance_m)
                done = 1.0 - distance_m / farthest_m if farthest_m > 0.0 else 1.0
            text = f"{'paused, ' if goal.paused else ''}{_feedback_in_words(fields)}{time_to_go(goal)}"
            more = {"remaining_s": goal.remaining_s, "paused": goal.paused}
            printer.progress(text, done, goal_id=goal.goal_id, **more, **fields)


def time_to_go(goal: "Goal[Any, Any]") -> str:
    """The end of a line of progress; "" while the time is unknown."""
    return "" if goal.remaining_s is None else f", {minutes(goal.remaining_s)} to go"


def _feedback_in_words(feedback: dict[str, Any]) -> str:
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


def take_pictures(
    printer: Printer,
    goal: "ImagesGoal",
    name: str,
    dataset: "Dataset",
    on_end: Callable[[Any], None] = lambda result: None,
) -> None:
    """Follow a goal to its end and write its images. Ctrl+C cancels the goal; a second one ends the command at once.

    The images of a canceled or aborted goal are written too.

    Args:
        on_end: called with the result, however the goal ended.
    """
    from jezero.client.errors import EndedError
    from jezero.schemas.goals import ImagesResult

    folder, before = dataset.folder, dataset.count
    track: list[Vec3] = []
    printer.event("accepted", f"{name}: accepted (goal {goal.goal_id})", goal_id=goal.goal_id, warning=goal.warning)
    printer.warn(goal.warning)
    with dataset:
        dataset.note(action=name, goal_id=goal.goal_id)
        _cancel_on_interrupt(printer, goal, lambda: _follow_images(printer, goal, dataset, before, track))
        try:
            result = goal.result()
        except EndedError as error:
            if isinstance(error.result, ImagesResult):
                dataset.update(error.result.images)
                on_end(error.result)
            if dataset.count and not printer.as_json:
                click.echo(f"{dataset.count} images are in {folder}", err=True)
            raise
        dataset.update(result.images)
        on_end(result)
        text = f"{name}: succeeded, {dataset.count} images in {folder}"
    fields: dict[str, Any] = {"outcome": "succeeded", "goal_id": goal.goal_id, "folder": str(folder)}
    printer.event("result", text, **fields, result=msgspec.to_builtins(result))


def _follow_images(printer: Printer, goal: "ImagesGoal", dataset: "Dataset", before: int, track: "list[Vec3]") -> None:
    """Fetch the images of a goal until it ends.

    Args:
        before: images of the flights that this one goes on with.
        track: positions of this flight so far, which grow.
    """

    def on_feedback(feedback: "goals.ImagesFeedback") -> None:
        track.append(feedback.pos_uav_ned_m)
        dataset.note(track_ned_m=track, track_frame=feedback.frame, planned=feedback.planned)
        north_m, east_m, down_m = feedback.pos_uav_ned_m
        keys.poll()
        there = before + feedback.taken
        where = f"at ({north_m:.2f}, {east_m:.2f}, {down_m:.2f}){time_to_go(goal)}"
        text = f"{'paused, ' if goal.paused else ''}{there} of {feedback.planned} images, {where}"
        fields = {"pos_uav_ned_m": feedback.pos_uav_ned_m, "frame": feedback.frame, "paused": goal.paused}
        counts = {"taken": feedback.taken, "planned": feedback.planned, "remaining_s": goal.remaining_s}
        printer.progress(text, there / max(feedback.planned, 1), goal_id=goal.goal_id, **fields, **counts)

    with GoalKeys(printer, goal) as keys:
        for picture in goal.pictures(on_feedback):
            if not dataset.has(picture.image):
                path = dataset.add(picture)
                if printer.as_json or not sys.stdout.isatty():
                    printer.event("image", f"image {picture.image.index + 1}: {path}", file=str(path))


class GoalKeys:
    """The keys of one goal; a context manager. Without a terminal, and with JSON, there are none."""

    def __init__(self, printer: Printer, goal: "Goal[Any, Any]") -> None:
        self._printer = printer
        self._goal = goal
        self._keyboard = Keyboard()

    def __enter__(self) -> Self:
        self._keyboard.__enter__()
        if self._keyboard.attached and not self._printer.as_json:
            self._printer.hint(HINT)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._keyboard.__exit__(kind, error, trace)

    def poll(self) -> None:
        """Send the request of the key that was pressed last, if any; a refusal is a warning."""
        if not self._keyboard.attached or self._printer.as_json:
            return
        from jezero.client import Refused

        pressed = self._keyboard.read(0.0)[-1:]
        try:
            if pressed in ("p", "P"):
                self._goal.pause(wait=False)  # the progress goes on meanwhile
            elif pressed in ("r", "R"):
                self._goal.resume()
        except Refused as error:
            self._printer.warn(str(error))
