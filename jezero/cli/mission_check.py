"""The judged plan of a mission as text: each step with duration, length, battery and images, and the sum."""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from math import cos, radians, sin
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from jezero.cli.area import ROUTER_WAIT_S, Origin, simulator_origin, vehicle_origin
from jezero.cli.exit_codes import FAILED
from jezero.cli.plan import minutes

if TYPE_CHECKING:
    from jezero.cli.shared import Printer
    from jezero.client import Vehicle
    from jezero.mission_files import MissionFile, StepPlan
    from jezero.mission_files.planning import Plan, Start
    from jezero.schemas.actions import PlanReply
    from jezero.schemas.goals import Goal
    from jezero.schemas.rows import Action

BUSY_TRIES, BUSY_S = 10, 0.3
Read = Callable[[Sequence[float]], "MissionFile"]
"""Reads the mission around the world's origin: latitude and longitude in degrees, and altitude where it is known."""
Wind = tuple[float, float]
"""Speed in m/s, and the direction from which it blows, in degrees clockwise from north."""


class Judged(NamedTuple):
    """What the plan of a mission says.

    Attributes:
        mistakes: number of steps that would fail.
        duration_s: of the whole mission, as far as it is known.
    """

    mistakes: int
    duration_s: float


def check_mission(
    printer: "Printer", read: Read, origin: Origin | None, wind: Wind | None, vehicle: str, router: str
) -> None:
    """Print the plan of a mission, and judge it.

    Args:
        origin: of the world without a stack; None takes the simulator's.
        wind: mean wind; None takes what the vehicle measures, and calm air without a stack or on the ground.

    Raises:
        SystemExit: the mission has a mistake.
    """
    from jezero.client import TimedOut, Unreachable, Vehicle

    with ExitStack() as ends:
        try:
            uav: Vehicle | None = ends.enter_context(
                Vehicle.connect(vehicle, router=router, insecure=True, timeout_s=ROUTER_WAIT_S)
            )
            found = None if uav is None else vehicle_origin(uav.status().odometry)
        except (Unreachable, TimedOut):
            uav, found = None, None
        found = found or origin or simulator_origin()
        file = read(found.origin_deg)
        judged = show_mission(printer, file, uav, found.origin_deg, wind)
    if judged.mistakes:
        printer.fail("mistakes", f"{judged.mistakes} of the steps would fail", FAILED, number=judged.mistakes)


def show_mission(
    printer: "Printer", file: "MissionFile", uav: "Vehicle | None", origin_deg: Sequence[float], wind: Wind | None
) -> Judged:
    """Print the judged plan of a mission.

    Args:
        uav: the vehicle; None plans in this process, for a vehicle that stands on the world's origin.
    """
    from jezero.mission_files import plan_mission
    from jezero.plugins import all_actions

    start = _start(uav, wind)
    plans = list(plan_mission(file.mission, all_actions(), _planner(uav, origin_deg), start))
    lines = [_step_in_words(file, index, plan) for index, plan in enumerate(plans)]
    without = "" if uav is not None else "no stack runs: planned for a full battery, and a rover where it starts"
    text = "\n".join(filter(None, [f"{file.mission.name}: {len(lines)} steps", *lines, _sum_in_words(plans), without]))
    printer.event("mission", text, name=file.mission.name, steps=_plain(file, plans))
    return Judged(sum(plan.mistake for plan in plans), sum(plan.duration_s or 0.0 for plan in plans))


def _start(uav: "Vehicle | None", wind: Wind | None) -> "Start":
    """The vehicle as it is, or one that stands on the origin with a full battery."""
    from jezero.mission_files.planning import Start
    from jezero.runtime.config import load_config
    from jezero.services.mission.config import MissionConfig
    from jezero.vehicle_config import VehicleConfig

    way_margin = load_config(MissionConfig, "mission").way_margin
    start = Start(vehicle=load_config(VehicleConfig, "vehicle"), way_margin=way_margin)
    if uav is not None:
        status = uav.status()
        battery = status.battery
        start = replace(
            start,
            pos_ned_m=start.pos_ned_m if status.odometry is None else status.odometry.pos_uav_ned_m,
            flies=status.armed and not status.landed,
            charge=1.0 if battery is None or battery.remaining is None else battery.remaining,
            wind_ned_mps=status.wind_ned_mps or start.wind_ned_mps,
        )
    if wind is None:
        return start
    speed_mps, from_rad = wind[0], radians(wind[1])
    blows_ned_mps = (-speed_mps * cos(from_rad), -speed_mps * sin(from_rad), 0.0)
    return replace(start, wind_ned_mps=blows_ned_mps)


def _planner(uav: "Vehicle | None", origin_deg: Sequence[float]) -> "Plan":
    """Plans a goal by the stack; by one in this process where there is none, or where it does not see the rover yet."""
    from jezero.client import Refused, TimedOut, Unreachable
    from jezero.schemas.actions import PlanReply

    virtual: list[Plan] = []

    def plan_here(action: "Action[Any]", goal: "Goal") -> "PlanReply":
        if not virtual:
            from jezero.trials.planning import VirtualPlanner

            virtual.append(VirtualPlanner(origin_deg).plan)
        return virtual[0](action, goal)

    def plan(action: "Action[Any]", goal: "Goal") -> "PlanReply":
        if uav is None:
            return plan_here(action, goal)
        try:
            reply = _plan_by(uav, action, goal)
        except Refused as error:
            reply = PlanReply(accepted=False, reason=error.reason, input_missing=error.input_missing)
        except (Unreachable, TimedOut) as error:  # one server is silent
            reply = PlanReply(accepted=False, reason=str(error)[:2000], input_missing=True)
        unknown = reply.input_missing or (reply.accepted and reply.duration_s is None)
        if unknown and (found := plan_here(action, goal)).accepted:
            return found
        return reply

    return plan


def _plan_by(uav: "Vehicle", action: "Action[Any]", goal: "Goal") -> "PlanReply":
    """Plan by the stack; while its server plans for somebody else, ask again.

    Raises:
        Refused: the goal would be refused.
    """
    from jezero.client import Refused

    for _ in range(BUSY_TRIES):
        try:
            return uav.plan(action, goal)
        except Refused as error:
            if "is being planned" not in error.reason:
                raise
            time.sleep(BUSY_S)
    return uav.plan(action, goal)


def _step_in_words(file: "MissionFile", index: int, plan: "StepPlan") -> str:
    step = file.mission.steps[index]
    begin = f"{index + 1:>4}  line {file.lines[index]:<4} {step.label:<30}"
    flight = _flight_in_words(plan)
    if not plan.problem:
        return f"{begin} {flight}".rstrip()
    return f"{begin} {'WRONG' if plan.mistake else 'not planned'}: {plan.problem}" + (f" ({flight})" if flight else "")


def _flight_in_words(plan: "StepPlan") -> str:
    """Duration, length, battery and images of a step, as far as they are known."""
    reply = plan.reply
    if reply is not None and not reply.accepted:
        return ""
    parts = ["duration unknown" if plan.duration_s is None else minutes(plan.duration_s)]
    if reply is not None and reply.distance_m is not None:
        parts.append(f"{reply.distance_m:.0f} m")
    if plan.charge_used is not None:
        parts.append(f"{100.0 * plan.charge_used:.1f} % of the battery, {100.0 * plan.charge_left:.0f} % left")
    if reply is not None and reply.coverage is not None:
        parts.append(f"{len(reply.coverage.pictures_ned_m)} images")
    return ", ".join(parts)


def _sum_in_words(plans: "Sequence[StepPlan]") -> str:
    known = [plan for plan in plans if plan.duration_s is not None]
    if not known:
        return "no step is planned"
    complete = "" if len(known) == len(plans) else ", without the steps of unknown duration"
    duration_s = sum(plan.duration_s or 0.0 for plan in known)
    length_m = sum((plan.reply.distance_m or 0.0) for plan in known if plan.reply is not None)
    used = sum(plan.charge_used or 0.0 for plan in known)
    return f"in all{complete}: {minutes(duration_s)}, {length_m:.0f} m, {100.0 * used:.0f} % of the battery"


def _plain(file: "MissionFile", plans: "Sequence[StepPlan]") -> list[dict[str, Any]]:
    """The steps for programs."""
    rows = []
    for line, step, plan in zip(file.lines, file.mission.steps, plans, strict=True):
        planned = {
            "problem": plan.problem,
            "mistake": plan.mistake,
            "charge_used": plan.charge_used,
            "charge_left": plan.charge_left,
            "plan": msgspec.to_builtins(plan.reply),
        }
        rows.append({"line": line, **msgspec.to_builtins(step), **planned})
    return rows
