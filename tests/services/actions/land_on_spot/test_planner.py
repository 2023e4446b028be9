"""Which landing a goal gets by its sensors, and which goals are refused."""

from typing import Any

import pytest
from msgspec.structs import replace

from jezero.schemas.goals import LandOnSpotGoal
from jezero.schemas.topics import ALTIMETER, RELATIVE, ROVER_ESTIMATE
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.land_on_spot.plain_landing import PlainLanding
from jezero.services.actions.land_on_spot.planner import LandOnSpotPlanner
from jezero.services.actions.land_on_spot.rover_landing import RoverLanding
from jezero.services.actions.motion.behaviour import Plan, Preparation, Refusal, VehicleState
from tests.client.rig import a_status

SPOT = (3.0, -4.0, 0.0)
FLYING = a_status()
STATE = VehicleState((0.0, 0.0, -4.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), armed=True, landed=False, height_m=4.0)
PLANNER = LandOnSpotPlanner(ActionsConfig())


def goal(**fields: Any) -> LandOnSpotGoal:
    return LandOnSpotGoal(goal_id="g", **fields)


ELSEWHERE = goal(use_uwb=False, use_tag=False, landing_spot_ned_m=SPOT)


def started(plan: Plan | Refusal, state: VehicleState = STATE) -> Any:
    assert isinstance(plan, Plan) and not isinstance(plan.start, Preparation)
    return plan.start(0, state)


@pytest.mark.parametrize(
    ("fields", "kind", "selected", "warning"),
    [
        ({}, RoverLanding, (True, True, None), ""),
        ({"use_tag": False}, RoverLanding, (True, False, None), ""),
        ({"landing_spot_ned_m": SPOT}, RoverLanding, (True, True, None), "the landing spot isn't used"),
        ({"use_uwb": False, "landing_spot_ned_m": SPOT}, RoverLanding, (False, True, SPOT), ""),
        ({"use_uwb": False, "use_tag": False, "landing_spot_ned_m": SPOT}, PlainLanding, None, ""),
    ],
)
def test_the_sensors_of_a_goal_choose_the_landing(
    fields: dict[str, Any], kind: type, selected: tuple[Any, ...] | None, warning: str
) -> None:
    plan = PLANNER.plan(goal(**fields), FLYING)
    assert isinstance(plan, Plan)
    assert isinstance(started(plan), kind)
    selection = plan.selection
    assert selected == (selection and (selection.use_uwb, selection.use_tag, selection.pos_rover_ned_m))
    assert plan.warning.startswith(warning) and bool(plan.warning) is bool(warning)
    assert plan.inputs == ((ALTIMETER,) if kind is PlainLanding else (ALTIMETER, RELATIVE, ROVER_ESTIMATE))
    assert plan.lands


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"use_uwb": False}, "the vehicle needs to know roughly where the rover is"),
        ({"use_uwb": False, "use_tag": False}, "the vehicle needs to know where to land"),
        ({"use_uwb": False, "frame": "rover", "landing_spot_ned_m": SPOT}, "give the landing spot in frame 'world'"),
        ({"use_uwb": False, "landing_spot_ned_m": (0.0, 1e4, 0.0)}, "10000 m"),
        ({"use_uwb": False, "use_tag": False, "landing_spot_ned_m": (0.0, 1e4, 0.0)}, "10000 m"),
    ],
)
def test_a_landing_without_a_place_that_can_be_found_or_reached_is_refused(fields: dict[str, Any], reason: str) -> None:
    refusal = PLANNER.plan(goal(**fields), FLYING)
    assert isinstance(refusal, Refusal)
    assert reason in refusal.reason


@pytest.mark.parametrize("fields", [{}, {"use_uwb": False, "use_tag": False, "landing_spot_ned_m": SPOT}])
def test_a_landing_in_too_much_wind_is_refused_unless_it_is_forced(fields: dict[str, Any]) -> None:
    windy = replace(FLYING, wind_ned_mps=(0.0, -12.5, 0.0))
    refusal = PLANNER.plan(goal(**fields), windy)
    assert isinstance(refusal, Refusal) and "the wind is 12.5 m/s" in refusal.reason
    assert isinstance(PLANNER.plan(goal(**fields, force=True), windy), Plan)


def test_the_spot_of_a_landing_can_change_on_the_way_there_alone() -> None:
    running = started(PLANNER.plan(ELSEWHERE, FLYING))
    assert isinstance(PLANNER.replan(ELSEWHERE, FLYING, running), Plan)
    above = replace(STATE, pos_uav_ned_m=(3.0, -4.0, -4.0))
    descends = started(PLANNER.plan(ELSEWHERE, FLYING), above)
    t_ns = 0
    while descends.approaches:
        t_ns += 20_000_000
        descends.step(t_ns, above)
    refusal = PLANNER.replan(ELSEWHERE, FLYING, descends)
    assert isinstance(refusal, Refusal) and "descends onto its spot already" in refusal.reason
    refusal = PLANNER.replan(ELSEWHERE, FLYING, started(PLANNER.plan(goal(), FLYING)))
    assert isinstance(refusal, Refusal) and "the sensors find the rover" in refusal.reason
