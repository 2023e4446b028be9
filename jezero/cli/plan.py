"""Plans of flights before they start: those of more than a minute are shown, and must be confirmed."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click
import msgspec

from jezero.cli.exit_codes import FAILED, USAGE

if TYPE_CHECKING:
    from jezero.cli.shared import Printer
    from jezero.client import Vehicle
    from jezero.schemas.actions import FeedbackMessage, PlanReply
    from jezero.schemas.goals import Goal
    from jezero.schemas.rows import Action

LONG_FLIGHT_S = 60.0
SHORT_PLAN_S = 1.0
"""A plan that takes longer is announced."""


def send_goal(printer: "Printer", uav: "Vehicle", action: "Action[Any]", goal: "Goal", *, yes: bool) -> Any:
    """Send a goal after `agreed_plan`; returns the accepted goal.

    Raises:
        Refused: the vehicle refuses the goal.
    """
    return uav.send(action, as_planned(goal, agreed_plan(printer, uav, action, goal, yes=yes)))


def agreed_plan(printer: "Printer", uav: "Vehicle", action: "Action[Any]", goal: "Goal", *, yes: bool) -> "PlanReply":
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


def as_planned(goal: "Goal", plan: "PlanReply") -> "Goal":
    """The goal that flies exactly the plan that was shown, where its action has such plans."""
    return goal if plan.coverage is None else msgspec.structs.replace(goal, plan_id=plan.coverage.plan_id)


@contextmanager
def _planning_shown(printer: "Printer", uav: "Vehicle", action: "Action[Any]") -> Iterator[None]:
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


def minutes(duration_s: float) -> str:
    """A duration for people: `42 s`, `5 min 12 s`."""
    whole_s = round(duration_s)
    return f"{whole_s} s" if whole_s < 60 else f"{whole_s // 60} min {whole_s % 60} s"


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


def show_plan(printer: "Printer", plan: "PlanReply", name: str) -> None:
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


def confirm(printer: "Printer") -> None:
    """Ask on a terminal; a script has to say --yes."""
    if printer.as_json or not _is_terminal():
        reason = "not sent: this flight takes more than a minute; add --yes to fly it without a question"
        printer.fail("unconfirmed", reason, USAGE, reason=reason)
    if not click.confirm("Fly it?", default=True, err=True):
        printer.fail("unconfirmed", "not sent", FAILED, reason="not confirmed")


def _is_terminal() -> bool:
    return sys.stdin.isatty()
