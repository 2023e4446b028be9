"""Which place a return takes: what each place needs, and what is left."""

import pytest
from msgspec.structs import replace

from jezero.base.frames import Vec3
from jezero.schemas.fence import Fence, Zone
from jezero.schemas.goals import ReturnHomeGoal
from jezero.schemas.state import Battery
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.land_on_spot.rover_landing import rover_landing_remaining
from jezero.services.actions.motion.behaviour import Refusal, VehicleState
from jezero.services.actions.return_home.decision import Decision, Place, Way

HERE = (100.0, 0.0, -10.0)
ROVER = Place("rover", (0.0, 0.0, -0.5), "the rover is in sight")
TAKEOFF = Place("takeoff_point", (60.0, 0.0, 0.0))
POND = Zone(name="pond", corners_ned_m=((85.0, -30.0), (90.0, -30.0), (90.0, 30.0), (85.0, 30.0)))
FULL_S = 1161.0
"""Seconds of hovering that a full battery lasts."""


def state(charge: float | None = None, **fields: object) -> VehicleState:
    battery = None if charge is None else Battery(voltage_v=15.0, remaining=charge, critical=0.05)
    known = VehicleState(HERE, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), True, False, battery=battery)
    return replace(known, **fields)


def decide(
    now: VehicleState,
    *places: Place | Refusal,
    goal: ReturnHomeGoal | None = None,
    present: Way | None = None,
    t_ns: int = 0,
) -> Way:
    decision = Decision(goal or ReturnHomeGoal(), ActionsConfig(), 0, now)
    return decision.best(t_ns, now, places or (ROVER, TAKEOFF), present)


def needed(place: Place) -> float:
    """Fraction of the capacity that a place needs in still air, reserve included."""
    return 0.1 + decide(state(), place).cost.hover_s / FULL_S


LANDING_S = rover_landing_remaining((0.0, 0.0, -6.0), ActionsConfig().land_on_spot.rover).time_s
SHORT = 0.002
"""Fraction of the capacity that is missing."""


def test_a_battery_that_nobody_knows_or_that_holds_leads_to_the_best_place() -> None:
    for now in (state(), state(0.9)):
        way = decide(now)
        assert (way.place, way.reason) == (ROVER, "the rover is in sight")


def test_a_place_that_would_not_leave_the_reserve_is_left_out_with_both_figures() -> None:
    way = decide(state(needed(ROVER) - SHORT))
    assert way.place == TAKEOFF
    assert way.reason == "the rover is left out: the battery would have 10% there, and 10% is its reserve"


def test_without_any_place_in_reach_the_vehicle_lands_here_before_the_reserve_is_used() -> None:
    way = decide(state(needed(TAKEOFF) - SHORT))
    assert way.place.kind == "here"
    assert "the rover is left out" in way.reason and "the takeoff point is left out" in way.reason


def test_a_place_that_takes_hardly_more_than_landing_here_is_better_than_the_ground_below() -> None:
    near = Place("takeoff_point", (96.0, 0.0, 0.0))
    assert decide(state(0.06), ROVER, near).place == near


def test_a_head_wind_takes_more_charge_and_a_tail_wind_does_not_carry_the_vehicle_past() -> None:
    calm, head, tail = (
        decide(state(wind_ned_mps=wind_ned_mps)).cost for wind_ned_mps in (None, (8.0, 0.0, 0.0), (-4.0, 0.0, 0.0))
    )
    assert head.hover_s > 1.3 * calm.hover_s
    assert calm.time_s == tail.time_s > tail.hover_s * 0.99


def test_a_wind_against_which_the_vehicle_does_not_come_forward_is_named() -> None:
    way = decide(state(wind_ned_mps=(14.0, 0.0, 0.0)))
    assert way.place.kind == "here"
    assert "the rover is left out: the wind of 14 m/s does not let the vehicle come there" in way.reason


def test_a_vehicle_that_the_wind_carries_away_still_lands_below_itself() -> None:
    now = state(0.2, wind_ned_mps=(0.0, 14.0, 0.0))
    way = decide(now)
    carried = replace(now, pos_uav_ned_m=(100.0, 20.0, -10.0))
    assert decide(carried, present=way).end_ned_m == (100.0, 20.0, 0.0)


@pytest.mark.parametrize("vel_ned_mps", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.5, 0.0)])
def test_a_driving_rover_is_met_where_it_will_be(vel_ned_mps: Vec3) -> None:
    way = decide(state(), driving(vel_ned_mps))
    assert way.place.kind == "rover"
    for axis in (0, 1):
        assert way.end_ned_m[axis] == pytest.approx(vel_ned_mps[axis] * (way.cost.time_s - LANDING_S), abs=1.5)
    assert way.corners_ned_m[-1][:2] == pytest.approx(way.end_ned_m[:2], abs=1.5)


def driving(vel_ned_mps: Vec3) -> Place:
    return Place("rover", ROVER.pos_ned_m, ROVER.note, vel_ned_mps)


def test_a_rover_that_drives_away_too_fast_is_left_out() -> None:
    way = decide(state(), driving((-5.0, 0.0, 0.0)), TAKEOFF)
    assert way.place == TAKEOFF
    assert "it drives at 5.0 m/s, too fast to be caught up with" in way.reason


def test_a_rover_that_drives_beyond_the_limits_is_left_out() -> None:
    far = replace(state(), pos_uav_ned_m=(-300.0, 0.0, -10.0))
    way = decide(far, Place("rover", (-480.0, 0.0, -0.5), "", (-1.0, 0.0, 0.0)), TAKEOFF)
    assert way.place == TAKEOFF
    assert "it drives beyond the limit of 500 m" in way.reason


def test_each_rally_point_is_tried_in_turn() -> None:
    behind = [Place("rally_point", (80.0, float(east), 0.0)) for east in (0, 5, 10)]
    free = Place("rally_point", (110.0, 0.0, 0.0))
    way = decide(state(fence=Fence(keep_out=(POND,))), TAKEOFF, *behind, free)
    assert way.place == free
    assert way.reason.count("the rally point is left out") == 1 and "so are 2 more" in way.reason


@pytest.mark.parametrize(("ceiling_m", "way_m"), [(8.0, 7.5), (4.0, 3.5), (30.0, 10.0)])
def test_under_a_low_ceiling_the_vehicle_flies_as_high_as_the_fence_lets_it(ceiling_m: float, way_m: float) -> None:
    low = state(fence=Fence(ceiling_m=ceiling_m), pos_uav_ned_m=(50.0, 0.0, -3.0))
    way = decide(low)
    assert way.place == ROVER
    assert -min(corner[2] for corner in way.corners_ned_m) == way_m


def test_the_ceiling_of_the_fence_is_that_of_the_autopilots_present_frame() -> None:
    low = state(fence=Fence(ceiling_m=8.0), pos_uav_ned_m=(50.0, 0.0, -3.0), shift_ned_m=(0.0, 0.0, 1.0))
    assert -min(corner[2] for corner in decide(low).corners_ned_m) == 8.5


def test_a_better_place_is_taken_again_only_with_a_margin_and_the_present_one_is_kept() -> None:
    way = decide(state(needed(ROVER) - SHORT))
    assert decide(state(needed(ROVER) + SHORT), present=way).place == TAKEOFF
    assert decide(state(0.30), present=way).place == ROVER
    rover = decide(state(0.2))
    assert decide(state(needed(ROVER) - SHORT), present=rover).place == ROVER


def test_a_gauge_that_the_sender_of_the_goal_does_not_believe_does_not_count() -> None:
    goal = ReturnHomeGoal(charge=needed(ROVER) - SHORT, charge_per_s=1.0 / FULL_S)
    assert decide(state(0.8), goal=goal).place == TAKEOFF
    assert decide(state(0.8), goal=goal, t_ns=30 * 10**9).place.kind == "here"


def test_a_flight_that_uses_more_than_declared_counts_as_measured() -> None:
    assert decide(state(0.15)).place == ROVER
    assert decide(state(0.15), goal=ReturnHomeGoal(charge_per_s=2.0 / FULL_S)).place != ROVER
