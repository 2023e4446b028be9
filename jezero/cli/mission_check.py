"""The plan of a mission as text: each step with duration, length, battery and images, and the sum."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from jezero.cli.area import ROUTER_WAIT_S, Origin, simulator_origin, vehicle_origin
from jezero.cli.exit_codes import FAILED
from jezero.cli.plan import flight_in_words, minutes

if TYPE_CHECKING:
    from jezero.cli.shared import Printer
    from jezero.client import Vehicle
    from jezero.mission_files import MissionFile, StepPlan
    from jezero.schemas.actions import PlanReply
    from jezero.schemas.goals import Goal
    from jezero.schemas.rows import Action

Read = Callable[[Sequence[float]], "MissionFile"]
"""Reads the mission around the world's origin: latitude and longitude in degrees, and altitude where it is known."""


def check_mission(printer: "Printer", read: Read, origin: Origin | None, vehicle: str, router: str) -> None:
    """Print the plan of a mission.

    Args:
        origin: of the world, for areas in degrees without a stack; None takes the simulator's.

    Raises:
        SystemExit: the mission has a mistake.
    """
    from jezero.client import TimedOut, Unreachable, Vehicle

    try:
        with Vehicle.connect(vehicle, router=router, insecure=True, timeout_s=ROUTER_WAIT_S) as uav:
            found = vehicle_origin(uav.status().odometry) or origin or simulator_origin()
            file = read(found.origin_deg)
            plans: list[StepPlan] | None = _plans(file, uav)
    except (Unreachable, TimedOut) as error:
        file, plans = read((origin or simulator_origin()).origin_deg), None
        note = f"the steps are not planned: {error}"
    else:
        note = ""
    rows = [] if plans is None else plans
    lines = [_step_in_words(file, index, rows[index] if rows else None) for index in range(len(file.mission.steps))]
    text = "\n".join([f"{file.mission.name}: {len(lines)} steps", *lines, note or _sum_in_words(rows)])
    printer.event("mission", text, name=file.mission.name, steps=_plain(file, rows))
    mistakes = sum(plan.mistake for plan in rows)
    if mistakes:
        printer.fail("mistakes", f"{mistakes} of the steps would be refused", FAILED, number=mistakes)


def _plans(file: "MissionFile", uav: "Vehicle") -> "list[StepPlan]":
    from jezero.client import Refused
    from jezero.mission_files import plan_mission
    from jezero.plugins import all_actions
    from jezero.schemas.actions import PlanReply

    def plan(action: "Action[Any]", goal: "Goal") -> "PlanReply":
        try:
            return uav.plan(action, goal)
        except Refused as error:
            return PlanReply(accepted=False, reason=error.reason, input_missing=error.input_missing)

    odometry = uav.status().odometry
    start_ned_m = (0.0, 0.0, 0.0) if odometry is None else odometry.pos_uav_ned_m
    return list(plan_mission(file.mission, all_actions(), plan, start_ned_m))


def _step_in_words(file: "MissionFile", index: int, plan: "StepPlan | None") -> str:
    step = file.mission.steps[index]
    begin = f"{index + 1:>4}  line {file.lines[index]:<4} {step.label:<30}"
    if plan is None:
        return begin.rstrip()
    if plan.problem:
        return f"{begin} {'REFUSED' if plan.mistake else 'not planned'}: {plan.problem}"
    if plan.reply is None:
        return begin.rstrip()
    coverage = plan.reply.coverage
    images = "" if coverage is None else f", {len(coverage.pictures_ned_m)} images"
    used = "" if plan.reply.battery_used is None else f", {100.0 * plan.reply.battery_used:.1f} % of the battery"
    length = "" if plan.reply.distance_m is None else f", {plan.reply.distance_m:.0f} m"
    duration = "duration unknown" if plan.duration_s is None else minutes(plan.duration_s)
    return f"{begin} {duration}{length}{used}{images}"


def _sum_in_words(plans: "list[StepPlan]") -> str:
    replies = [plan.reply for plan in plans if plan.reply is not None and plan.reply.accepted]
    complete = all(plan.duration_s is not None for plan in plans)
    total = None if not replies else replies[0]
    if total is None:
        return "no step is planned"
    total = msgspec.structs.replace(
        total,
        duration_s=sum(plan.duration_s or 0.0 for plan in plans),
        distance_m=sum(reply.distance_m or 0.0 for reply in replies),
        battery_used=sum(reply.battery_used or 0.0 for reply in replies),
    )
    return f"in all{'' if complete else ', without the steps of unknown duration'}: {flight_in_words(total)}"


def _plain(file: "MissionFile", plans: "list[StepPlan]") -> list[dict[str, Any]]:
    """The steps for programs."""
    rows = []
    for index, (line, step) in enumerate(zip(file.lines, file.mission.steps, strict=True)):
        plan = plans[index] if plans else None
        planned = {} if plan is None else {"problem": plan.problem, "plan": msgspec.to_builtins(plan.reply)}
        rows.append({"line": line, **msgspec.to_builtins(step), **planned})
    return rows
