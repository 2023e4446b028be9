"""Flights of more than a minute are shown before they start, and must be confirmed."""

import sys
from typing import TYPE_CHECKING, Any

import click

from jezero.cli.exit_codes import FAILED, USAGE

if TYPE_CHECKING:
    from jezero.cli.flight import Printer
    from jezero.client import Vehicle
    from jezero.schemas.actions import Goal, PlanReply
    from jezero.schemas.topics import Action

LONG_FLIGHT_S = 60.0


def send_goal(printer: "Printer", uav: "Vehicle", action: "Action[Any]", goal: "Goal", *, yes: bool) -> Any:
    """Send a goal; a long flight is shown first, and on a terminal the user is asked.

    Args:
        yes: the user has agreed already, with --yes.

    Returns:
        The accepted goal.

    Raises:
        Refused: the vehicle refuses the goal.
    """
    plan = uav.plan(action, goal)
    if plan.duration_s is not None and plan.duration_s > LONG_FLIGHT_S:
        _show(printer, plan, action.name)
        if not yes:
            _confirm(printer)
    return uav.send(action, goal)


def minutes(duration_s: float) -> str:
    """A duration for people: `42 s`, `5 min 12 s`."""
    whole_s = round(duration_s)
    return f"{whole_s} s" if whole_s < 60 else f"{whole_s // 60} min {whole_s % 60} s"


def _show(printer: "Printer", plan: "PlanReply", name: str) -> None:
    parts = [minutes(plan.duration_s or 0.0)]
    if plan.distance_m is not None:
        parts.append(f"{plan.distance_m:.0f} m")
    if plan.battery_used is not None:
        left = plan.battery_remaining
        known = [] if left is None else [f"{100.0 * left:.0f} % left"]
        if plan.battery_critical is not None:
            known.append(f"{100.0 * plan.battery_critical:.0f} % must be left")
        parts.append(f"{100.0 * plan.battery_used:.0f} % of the battery" + (f" ({', '.join(known)})" if known else ""))
    printer.event(
        "plan",
        f"{name}: {', '.join(parts)}",
        duration_s=plan.duration_s,
        distance_m=plan.distance_m,
        battery_used=plan.battery_used,
        battery_remaining=plan.battery_remaining,
        battery_critical=plan.battery_critical,
    )


def _confirm(printer: "Printer") -> None:
    """Ask on a terminal; a script has to say --yes."""
    if printer.as_json or not _is_terminal():
        reason = "not sent: this flight takes more than a minute; add --yes to fly it without a question"
        printer.fail("unconfirmed", reason, USAGE, reason=reason)
    if not click.confirm("Fly it?", default=True, err=True):
        printer.fail("unconfirmed", "not sent", FAILED, reason="not confirmed")


def _is_terminal() -> bool:
    return sys.stdin.isatty()
