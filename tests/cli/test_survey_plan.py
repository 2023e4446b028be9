"""`jezero gridsweep --plan-only`: the stack's own plan, or one of its own that says where it begins."""

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result

from jezero import Vehicle
from jezero.cli.main import main
from jezero.schemas.actions import PlanReply
from jezero.schemas.fence import Fence, FenceState, Zone
from tests.cli.test_survey_flights import PLANNED
from tests.client.rig import ODOMETRY, Server, a_status, endpoint, server, vehicle

__all__ = ["endpoint", "server", "vehicle"]

HERE = msgspec.structs.replace(ODOMETRY, pos_uav_ned_m=(3.5, 0.5, -3.0))
REPLY = PlanReply(
    accepted=True,
    duration_s=12.0,
    distance_m=9.0,
    battery_used=0.01,
    battery_remaining=0.8,
    warning="the camera is slow",
    coverage=PLANNED,
)


@pytest.fixture
def words(tmp_path: Path, endpoint: str) -> list[str]:
    file = tmp_path / "area.csv"
    file.write_text("north,east\n0,0\n4,0\n4,4\n0,4\n")
    words = ["gridsweep", "--plan-only", "--out", str(tmp_path / "plan.png"), "--polygon", str(file)]
    return [*words, "--z", "-5", "--resolution", "2", "--vehicle", "v", "--router", endpoint]


@pytest.fixture
def stack(server: Server, vehicle: Vehicle) -> Server:
    """A stack with a vehicle that hovers away from the world's origin."""
    server.serve("status", msgspec.structs.replace(a_status(), odometry=HERE))
    return server


def run(words: list[str], *more: str) -> Result:
    return CliRunner().invoke(main, [*words, *more])


def fields(done: Result) -> Any:
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def test_a_running_stack_is_asked_for_the_plan_that_it_would_fly(words: list[str], stack: Server) -> None:
    stack.serve("@action/area_coverage/plan", REPLY)
    done = run(words)
    assert done.exit_code == 0, done.output
    assert "16.0 m², 99.0 % of it swept, 95.0 % photographed" in done.stdout
    assert "start       at the vehicle, 3.5 m north and 0.5 m east" in done.stdout
    assert "flight      12 s, 9 m, 1 % of the battery (80 % left)" in done.stdout
    assert "plan        0123456789ab: with --plan-id 0123456789ab exactly this plan is flown" in done.stdout
    assert "warning: the camera is slow" in done.stderr
    assert fields(run(words, "--json"))["path_ned_m"] == [[1.0, 1.0], [3.0, 1.0]]


def test_a_stack_that_would_not_fly_now_is_planned_for_from_the_vehicles_position(
    words: list[str], stack: Server
) -> None:
    stack.serve("@action/area_coverage/plan", PlanReply(accepted=False, reason="it is on the ground: take off first"))
    done = run(words)
    assert done.exit_code == 0, done.output
    assert "3.5 m north and 0.5 m east; it would not fly now: it is on the ground: take off first" in done.stdout
    plan = fields(run(words, "--json"))
    assert plan["plan_id"] is None
    assert plan["start_ned_m"] == [3.5, 0.5]


def test_a_plan_that_leaves_the_fence_says_so_whatever_else_keeps_it_from_flying(
    words: list[str], stack: Server
) -> None:
    stack.serve("@action/area_coverage/plan", PlanReply(accepted=False, reason="it is on the ground: take off first"))
    yard = Zone(name="yard", corners_ned_m=((-1.0, -1.0), (2.0, -1.0), (2.0, 9.0), (-1.0, 9.0)))
    stack.serve("fence", FenceState(t_ns=0, fence=Fence(name="home", keep_in=yard), fence_id="1"))
    done = run(words)
    assert done.exit_code == 0, done.output
    assert re.search(r"warning: the way (leaves|is outside) the fence 'home': .*'yard'", done.stderr), done.stderr
    assert "'home'" in fields(run(words, "--json"))["warning"]


def test_without_a_stack_the_plan_says_where_it_assumes_the_start(words: list[str], server: Server) -> None:
    done = run(words)
    assert done.exit_code == 0, done.output
    assert "start       assumed at the vehicle's place before a flight, 0 0, as no stack is asked" in done.stdout
    assert "with --plan-id" not in done.stdout


def test_an_origin_of_ones_own_is_not_that_of_the_stack(words: list[str], stack: Server) -> None:
    stack.serve("@action/area_coverage/plan", REPLY)
    assert fields(run(words, "--json", "--origin", "47.0", "8.0"))["plan_id"] is None


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (("--resolution", "1e-9"), "needs about 1.6e+19 pictures, more than 3000: take a coarser resolution"),
        (("--resolution", "1e-300"), "take a coarser resolution"),
        (("--resolution", "1e300"), "expected a number from 0 to"),
        (("--z", "-1e5"), "beyond the limit of 120 m"),
        (("--speed", "-3"), "speed -3 m/s is not within"),
        (("--speed", "1e300"), "is not within"),
        (("--z", "-50"), "with force (--force)"),
    ],
)
def test_numbers_that_can_not_be_flown_are_refused_without_a_stack_too(
    words: list[str], server: Server, more: tuple[str, ...], why: str
) -> None:
    done = run(words, *more)
    assert done.exit_code == 1, done.output
    assert why in done.output


def test_with_force_it_is_planned_and_warned_of(words: list[str], server: Server) -> None:
    done = run(words, "--z", "-50", "--force")
    assert done.exit_code == 0, done.output
    assert "warning: at 50 m the altimeter does not reach the ground" in done.stderr


@pytest.mark.parametrize("option", ["--resolution", "--overlap", "--sidelap", "--margin", "--hole-margin"])
@pytest.mark.parametrize(
    ("number", "why"), [("-1", "range"), ("nan", "not a finite number"), ("1e400", "range|finite")]
)
def test_a_number_that_no_option_may_have_is_refused_with_the_option(
    words: list[str], option: str, number: str, why: str
) -> None:
    done = run(words, option, number)
    assert done.exit_code == 2, done.output
    assert re.search(f"Invalid value for '{option}': .*({why})", done.output)


@pytest.mark.parametrize("given", [("--plan-id", "0123456789ab"), ("--resume", ".")])
def test_an_option_of_a_flight_is_refused_beside_plan_only(words: list[str], given: tuple[str, str]) -> None:
    done = run(words, *given)
    assert done.exit_code == 2, done.output
    assert f"{given[0]} is for a flight: leave out {given[0]} or --plan-only" in done.output


def test_a_resumed_coverage_takes_no_other_area(words: list[str], tmp_path: Path) -> None:
    without_plan = [word for word in words if word != "--plan-only"]
    done = run(without_plan, "--resume", str(tmp_path), "rover")
    assert done.exit_code == 2, done.output
    assert "as it was planned: leave out --out, --polygon, --resolution, --z, FRAME" in done.output
