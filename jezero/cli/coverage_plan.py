"""`jezero gridsweep --plan-only`: the plan of a coverage, by the running stack or without one, drawn and in words."""

import json
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from jezero.cli.area import ROUTER_WAIT_S, CoverageRequest, Origin, place_in_words, simulator_origin, vehicle_origin
from jezero.cli.plan import flight_in_words, minutes

if TYPE_CHECKING:
    from jezero.client import Vehicle
    from jezero.schemas.actions import PlannedCoverage, PlanReply
    from jezero.schemas.fence import Fence
    from jezero.schemas.goals import AreaCoverageGoal


@dataclass(frozen=True)
class _Planned:
    """A plan that is not flown.

    Attributes:
        start: where its path begins, and why there, for people.
        reply: of the stack that would fly it; None for a plan that no stack knows.
        fence: the vehicle's fence; None without one, and for a plan in the rover's frame.
    """

    goal: "AreaCoverageGoal"
    origin: Origin
    coverage: "PlannedCoverage"
    warning: str
    start: str
    reply: "PlanReply | None" = None
    fence: "Fence | None" = None


def show_coverage_plan(
    request: CoverageRequest, origin: Origin | None, file: Path, *, vehicle: str, router: str, as_json: bool
) -> None:
    """Plan a coverage, draw it into a file, and print its figures.

    A running stack plans it as it would fly it. With an origin of its own, the plan is not that of a stack.
    """
    from jezero.report.coverage_plot import draw_plan
    from jezero.services.actions.area_coverage.area import make_area

    planned = _plan_of_stack(request, vehicle, router) if origin is None else None
    if planned is None:
        place = origin or simulator_origin()
        start = "assumed at the vehicle's place before a flight, 0 0, as no stack is asked"
        planned = _plan_here(request, place, (0.0, 0.0), start)
    goal, coverage = planned.goal, planned.coverage
    area = make_area(goal.polygon_ned_m, goal.holes_ned_m)
    title = f"{len(coverage.pictures_ned_m)} images, {coverage.length_m:.0f} m, {minutes(coverage.duration_s)}"
    draw_plan(file, area, coverage, title, planned.fence)
    if as_json:
        click.echo(json.dumps(_fields(planned)))
        return
    shares = f"{100.0 * coverage.covered:.1f} % of it swept, {100.0 * coverage.photographed:.1f} % photographed"
    click.echo(f"area        {area.area:.1f} m², {shares}")
    click.echo(f"place       {place_in_words(goal, planned.origin)}")
    lines = f"lines {coverage.line_distance_m:.3g} m apart"
    click.echo(f"path        {coverage.length_m:.1f} m in {coverage.duration_s:.0f} s, {lines}")
    click.echo(f"images      {len(coverage.pictures_ned_m)}, every {coverage.picture_distance_m:.3g} m")
    click.echo(f"start       {planned.start}")
    if planned.reply is not None:
        click.echo(f"flight      {flight_in_words(planned.reply)}")
        click.echo(f"plan        {coverage.plan_id}: with --plan-id {coverage.plan_id} exactly this plan is flown")
    click.echo(f"drawn in    {file}")
    if planned.warning:
        click.echo(f"warning: {planned.warning}", err=True)


def _plan_of_stack(request: CoverageRequest, vehicle: str, router: str) -> _Planned | None:
    """The plan as the running stack would fly it; None without a stack."""
    from jezero.client import TimedOut, Unreachable, Vehicle

    try:
        with Vehicle.connect(vehicle, router=router, insecure=True, timeout_s=ROUTER_WAIT_S) as uav:
            planned = _ask(request, uav)
            if planned is not None and planned.goal.frame == "world":
                with suppress(Unreachable, TimedOut):  # a bridge of an earlier version publishes no fence
                    return replace(planned, fence=uav.fence().fence)
            return planned
    except (Unreachable, TimedOut):
        return None


def _ask(request: CoverageRequest, uav: "Vehicle") -> _Planned | None:
    """The plan by a stack; from the vehicle's position also if the stack would refuse to fly it now."""
    from jezero.client import Refused
    from jezero.schemas.topics import AREA_COVERAGE

    odometry = uav.status().odometry
    if odometry is None:
        return None
    origin = vehicle_origin(odometry) or simulator_origin()
    goal = request.goal(origin)
    north_m, east_m, _ = odometry.pos_uav_ned_m
    at = f"at the vehicle, {north_m:.1f} m north and {east_m:.1f} m east"
    try:
        reply = uav.plan(AREA_COVERAGE, goal)
    except Refused as error:
        if goal.frame == "rover":
            raise click.ClickException(str(error)) from None
        return _plan_here(request, origin, (north_m, east_m), f"{at}; it would not fly now: {error}")
    if reply.coverage is None:
        return None
    return _Planned(
        goal, origin, reply.coverage, reply.warning, "at the vehicle" if goal.frame == "rover" else at, reply
    )


def _plan_here(request: CoverageRequest, origin: Origin, start_m: tuple[float, float], start: str) -> _Planned:
    """A plan by this command itself, for a vehicle that hovers at a point of the goal's frame."""
    from jezero.services.actions.area_coverage.planner import plan_or_refuse
    from jezero.services.actions.config import load_actions_config
    from jezero.services.actions.motion.behaviour import Refusal

    goal = request.goal(origin)
    try:
        msgspec.convert(msgspec.to_builtins(goal), type(goal))  # as a server would check its numbers
    except msgspec.ValidationError as error:
        raise click.ClickException(f"the goal has a wrong number: {error}") from None
    made = plan_or_refuse(goal, load_actions_config(), start_m, (0.0, 0.0, 0.0))
    if isinstance(made, Refusal):
        raise click.ClickException(made.reason)
    return _Planned(goal, origin, made.shown, made.plan.warning, start)


def _fields(planned: _Planned) -> dict[str, object]:
    """The plan for programs."""
    coverage, reply = planned.coverage, planned.reply
    return {
        "plan_id": None if reply is None else coverage.plan_id,
        "path_ned_m": coverage.path_ned_m,
        "pictures_ned_m": coverage.pictures_ned_m,
        "start_ned_m": coverage.start_ned_m,
        "length_m": round(coverage.length_m, 3),
        "time_s": round(coverage.duration_s, 3),
        "covered": round(coverage.covered, 5),
        "photographed": round(coverage.photographed, 5),
        "warning": planned.warning,
        "start": planned.start,
        "battery_used": None if reply is None else reply.battery_used,
        "origin_deg": planned.origin.position_deg,
    }
