"""Landing on the rover against a point mass and an estimate that the test controls."""

from itertools import pairwise
from math import hypot, pi, sin

import pytest
from msgspec.structs import replace

from jezero.base.frames import Vec3, add, altitude_m, quat_from_euler, subtract
from jezero.schemas.goals import LandPhase, LandResult
from jezero.services.actions.land_on_spot.config import SearchConfig
from jezero.services.actions.land_on_spot.contact import foot_drop_m
from jezero.services.actions.land_on_spot.platform import (
    PlatformState,
)
from jezero.services.actions.land_on_spot.rover_landing import (
    RoverLanding,
    Search,
    rover_landing_remaining,
)
from jezero.services.actions.motion.behaviour import Done, Move, hold_of, path_of, remaining_of
from tests.services.actions.land_on_spot.landing_rig import (
    BOTH,
    CONFIG,
    DECK_NED_M,
    DT_S,
    STILL,
    TAG,
    Landing,
    S,
    deck_motion,
)


@pytest.mark.parametrize(("speed_mps", "yaw_rate_rps"), [(0.0, 0.0), (0.5, 0.0), (1.0, 0.2), (-0.5, 0.3)])
def test_it_comes_down_on_the_middle_of_a_rover_that_stands_drives_or_turns(
    speed_mps: float, yaw_rate_rps: float
) -> None:
    landing = Landing(BOTH, speed_mps=speed_mps, yaw_rate_rps=yaw_rate_rps)
    assert landing.run(40.0) == Done("succeeded", then="disarm")
    assert landing.phases == ["approach", "descent", "contact"]
    assert hypot(*landing.offset_m[:2]) < 0.06
    assert landing.t_s < 18.0
    for _, offset_m, move in landing.moves:
        assert move.vel_ned_mps is not None or move.pos_ned_m is not None
        height_m, error_m = altitude_m(offset_m[2]), hypot(*offset_m[:2])
        if move.vel_ned_mps is None or move.feedback.phase != "descent":
            continue
        assert move.vel_ned_mps[2] <= max(0.6 * height_m, 0.35) + 0.05
        if move.vel_ned_mps[2] > 0.0 and height_m > 0.15:
            assert error_m < 0.03 + 0.13 * height_m
    last = [move.vel_ned_mps for _, _, move in landing.moves[-20:]]
    assert all(vel is not None and vel[2] == 0.5 for vel in last)
    assert landing.vel_deck_mps == pytest.approx((*last[-1][:2], 0.0), abs=0.02)  # type: ignore[index]


def test_the_feedback_has_the_radius_of_the_cone_at_the_height_of_the_vehicle() -> None:
    landing = Landing(BOTH)
    landing.run(40.0)
    descent = [(move, offset_m) for _, offset_m, move in landing.moves if move.feedback.phase == "descent"]
    narrowest_m = [0.008 + 0.08 * altitude_m(offset_m[2]) for _, offset_m in descent]
    cones_m = [move.feedback.cone_m for move, _ in descent]
    assert all(cone_m >= least_m - 0.01 for cone_m, least_m in zip(cones_m, narrowest_m, strict=True))
    assert cones_m[-1] < 0.25 * cones_m[0]
    assert all(move.feedback.cone_m >= 0.0 for _, _, move in landing.moves)


def test_from_lower_than_the_platform_it_climbs_before_it_comes_near() -> None:
    landing = Landing(BOTH, (3.0, -3.0, -0.4))
    assert landing.run(40.0) == Done("succeeded", then="disarm")
    for _, offset_m, _ in landing.moves:
        assert altitude_m(offset_m[2]) > 0.9 or abs(offset_m[0] + 2.0) < 0.05 or hypot(*offset_m[:2]) < 0.15


def test_by_a_poor_estimate_it_comes_nearer_at_its_height_until_that_is_good_enough() -> None:
    landing = Landing(BOTH, (-1.0, -3.0, -6.0))
    landing.std_at = lambda offset_m: 0.2 * hypot(*offset_m[:2])
    assert landing.run(40.0) == Done("succeeded", then="disarm")
    poor = [offset_m for _, offset_m, _ in landing.moves if landing.std_at(offset_m) > 0.5]
    assert len(poor) > 50
    assert all(altitude_m(offset_m[2]) == pytest.approx(5.5, abs=0.1) for offset_m in poor)
    assert landing.phases == ["approach", "descent", "contact"], "neither a hold nor a search"


def test_with_the_tag_alone_a_wrong_rough_position_is_corrected_once_the_tag_is_seen() -> None:
    landing = Landing(TAG, sees=lambda t_s, offset_m: hypot(*offset_m[:2]) < 0.5 * altitude_m(offset_m[2]))
    assert landing.run(60.0) == Done("succeeded", then="disarm")
    assert landing.phases == ["search", "approach", "descent", "contact"]
    assert hypot(*landing.offset_m[:2]) < 0.05


def test_losing_sight_for_less_than_half_a_second_does_not_stop_the_descent() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: t_s % 1.0 > 0.35)
    assert landing.run(40.0) == Done("succeeded", then="disarm")
    assert landing.phases == ["approach", "descent", "contact"]


def test_out_of_sight_it_holds_its_height_and_goes_on_when_it_sees_again() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: not 6.0 < t_s < 10.0)
    assert landing.run(60.0) == Done("succeeded", then="disarm")
    held = [(t_s, offset_m) for t_s, offset_m, _ in landing.moves if 6.8 < t_s < 9.9]
    assert {m.feedback.phase for t_s, _, m in landing.moves if 6.6 < t_s < 10.0} == {"hold"}
    heights_m = [altitude_m(offset_m[2]) for _, offset_m in held]
    assert max(heights_m) - min(heights_m) < 0.15


@pytest.mark.parametrize("lost_below_m", [0.42, 0.44, 0.46, 0.48, 0.5])
def test_a_hover_low_over_the_platform_while_that_is_out_of_sight_is_no_contact(lost_below_m: float) -> None:
    lost_s: list[float] = []

    def sees(t_s: float, offset_m: Vec3) -> bool:
        if not lost_s and altitude_m(offset_m[2]) < lost_below_m:
            lost_s.append(t_s)
        return not lost_s or t_s > lost_s[0] + 2.0

    landing = Landing(BOTH, sees=sees)
    assert landing.run(60.0) == Done("succeeded", then="disarm")
    assert landing.phases == ["approach", "descent", "hold", "contact"]
    touched_m = next(altitude_m(offset_m[2]) for _, offset_m, move in landing.moves if move.feedback.phase == "contact")
    assert touched_m < 0.05


@pytest.mark.parametrize("forget_s", [1.0, 100.0])
def test_out_of_sight_for_long_it_climbs_and_searches_and_hovers_in_the_end(forget_s: float) -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: t_s < 6.0)
    landing.forget_s = forget_s
    done = landing.run(180.0)
    assert done is not None
    assert (done.outcome, done.then) == ("aborted", "hover")
    assert done.reason.startswith("TARGET_LOST: not found in 3 rounds of search")
    assert landing.phases == ["approach", "descent", "hold", "search"]
    begun_s = next(t_s for t_s, _, move in landing.moves if move.feedback.phase == "search")
    assert begun_s == pytest.approx(6.0 + 5.5, abs=0.2)
    searching = [offset_m for t_s, offset_m, _ in landing.moves if t_s > begun_s]
    assert max(altitude_m(offset_m[2]) for offset_m in searching) > 6.5
    assert max(hypot(*offset_m[:2]) for offset_m in searching) > 5.0
    after_climb = [offset_m for t_s, offset_m, _ in landing.moves if t_s > begun_s + 6.0]
    assert min(altitude_m(offset_m[2]) for offset_m in after_climb) > 2.9


def test_a_rover_found_in_the_search_is_landed_on() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: t_s < 6.0 or altitude_m(offset_m[2]) > 4.0 or t_s > 20.0)
    assert landing.run(90.0) == Done("succeeded", then="disarm")
    assert landing.phases == ["approach", "descent", "hold", "search", "contact"]


def test_a_search_that_a_contradiction_has_interrupted_goes_on_as_a_search() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: t_s < 6.0)
    assert landing.run(14.0) is None
    assert landing.moves[-1][2].feedback.phase == "search"
    landing.contradicted = "UWB and tag contradict each other"
    assert landing.run(1.0) is None
    assert landing.moves[-1][2].feedback.phase == "hold"
    landing.contradicted = ""
    assert landing.run(1.0) is None
    move = landing.moves[-1][2]
    assert move.vel_ned_mps is not None and hypot(*move.vel_ned_mps) > 0.5
    assert move.feedback.phase == "search"


def test_a_search_for_a_rover_that_was_driving_moves_along_with_it() -> None:
    landing = Landing(BOTH, speed_mps=0.5, sees=lambda t_s, offset_m: t_s < 6.0)
    while "search" not in landing.phases:
        assert landing.run(DT_S) is None
    vel_ned_mps = landing.moves[-1][2].vel_ned_mps
    assert vel_ned_mps is not None and vel_ned_mps[:2] == pytest.approx(landing.vel_deck_mps[:2], abs=0.2)
    assert landing.run(4.0) is None
    assert hypot(*landing.offset_m[:2]) < 2.5, "on the first hexagon, and not left behind by 2 m"


def test_a_height_that_jumps_up_in_the_search_does_not_bring_it_down_fast() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: t_s < 6.0)
    assert landing.run(14.0) is None
    north_m, east_m, down_m = landing.pos_m
    landing.pos_m = (north_m, east_m, down_m - 3.0)
    before = len(landing.moves)
    assert landing.run(2.0) is None
    fastest_mps = max(move.vel_ned_mps[2] for _, _, move in landing.moves[before:] if move.vel_ned_mps is not None)
    assert 0.0 < fastest_mps <= 0.15


def test_near_the_ground_the_search_does_not_go_down() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: t_s < 6.0)
    assert landing.run(14.0) is None
    north_m, east_m, down_m = landing.pos_m
    landing.pos_m = (north_m, east_m, down_m - 3.0)
    landing.range_m = 2.9
    before = len(landing.moves)
    assert landing.run(2.0) is None
    assert all(move.vel_ned_mps is None or move.vel_ned_mps[2] <= 0.0 for _, _, move in landing.moves[before:])


def test_a_rover_that_was_seen_at_an_impossible_speed_is_not_followed_far() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: t_s < 6.0)
    landing.forget_s = 0.5
    landing.vel_rover_error_mps = (2.4, 0.0, 0.0)
    seen_at_m = landing.deck_m
    done = landing.run(180.0)
    assert done is not None
    assert done.reason.startswith("TARGET_LOST: not found in 3 rounds of search")
    away_m = subtract(landing.pos_m, seen_at_m)
    assert hypot(*away_m[:2]) < 2.4 * (5.5 + 10.0) + 7.0


def test_below_the_last_range_of_the_tag_it_finishes_blind() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: altitude_m(offset_m[2]) > 0.2)
    assert landing.run(40.0) == Done("succeeded", then="disarm")
    assert hypot(*landing.offset_m[:2]) < 0.06


@pytest.mark.parametrize("silent", [True, False])
def test_without_any_estimate_it_waits_and_then_gives_up_with_the_reason(silent: bool) -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: False)
    landing.silent, landing.std_rover_m = silent, 11.0
    done = landing.run(20.0)
    assert done is not None
    assert done.outcome == "aborted"
    why = "the estimator is silent" if silent else "not seen"
    assert done.reason == f"TARGET_LOST: the rover can't be found: {why}"
    assert all(move.pos_ned_m == (-1.0, -3.0, -6.0) for _, _, move in landing.moves)


def test_a_rover_out_of_sight_whose_odometry_goes_on_is_flown_to() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: hypot(*offset_m[:2]) < 1.0)
    assert landing.run(120.0) == Done("succeeded", then="disarm")


@pytest.mark.parametrize("speed_mps", [0.0, 0.5])
def test_standing_for_long_enough_it_is_disarmed_by_force_when_the_autopilot_does_not_see_the_ground(
    speed_mps: float,
) -> None:
    landing = Landing(BOTH, speed_mps=speed_mps)
    landing.grounded = False
    assert landing.run(60.0) == Done("succeeded", then="force_disarm")
    contact_s = contact_begin_s(landing)
    assert landing.t_s - contact_s == pytest.approx(3.0, abs=0.6)
    last = [altitude_m(offset_m[2]) for t_s, offset_m, _ in landing.moves if t_s > landing.t_s - 2.0]
    assert max(last) < 0.1


def contact_begin_s(landing: Landing) -> float:
    return next(t_s for t_s, _, move in landing.moves if move.feedback.phase == "contact")


def is_given_up(landing: Landing) -> bool:
    done = landing.run(60.0)
    assert done is not None and "contact" in landing.phases
    assert landing.t_s - contact_begin_s(landing) == pytest.approx(10.0, abs=0.5)
    return done.outcome == "aborted" and done.then == "hover" and "doesn't detect the ground" in done.reason


def held_up_at(height_m: float) -> Landing:
    """Something unseen holds the vehicle up over the platform; the autopilot knows of nothing."""
    landing = Landing(BOTH)
    landing.grounded = False
    landing.deck_m = (*DECK_NED_M[:2], DECK_NED_M[2] - height_m)
    landing.offset_of_estimate_m = (0.0, 0.0, -height_m)
    return landing


def test_resting_above_a_tenth_of_a_metre_it_is_never_disarmed_by_force() -> None:
    assert is_given_up(held_up_at(0.15))
    assert held_up_at(0.05).run(60.0) == Done("succeeded", then="force_disarm")


def test_a_height_that_is_not_surely_below_a_tenth_of_a_metre_is_no_sign() -> None:
    landing = Landing(BOTH)
    landing.grounded = False
    landing.std_height_m = 0.06
    assert is_given_up(landing)


def test_low_but_moving_it_is_not_disarmed_by_force() -> None:
    landing = Landing(BOTH)
    landing.grounded = False
    landing.vel_error_mps = lambda t_s: (0.0, 0.0, 0.3 if t_s % 1.0 < 0.3 else 0.0)
    assert is_given_up(landing)


def test_signs_that_lapse_begin_anew() -> None:
    landing = Landing(BOTH)
    landing.grounded = False
    while "contact" not in landing.phases:
        assert landing.run(DT_S) is None
    contact_s = landing.t_s
    landing.sees = lambda t_s, offset_m: not contact_s + 1.0 < t_s < contact_s + 1.9
    assert landing.run(60.0) == Done("succeeded", then="force_disarm")
    assert landing.t_s - contact_s > 4.8


def test_signs_that_do_not_last_are_none() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: altitude_m(offset_m[2]) > 0.01 or t_s % 2.6 < 1.6)
    landing.grounded = False
    assert is_given_up(landing)


def test_an_altimeter_that_measures_a_way_down_forbids_force() -> None:
    landing = Landing(BOTH)
    landing.grounded = False
    while "contact" not in landing.phases:
        assert landing.run(0.1) is None
    landing.range_m = 0.3
    assert is_given_up(landing)
    landing = Landing(BOTH)
    landing.grounded = False
    while "contact" not in landing.phases:
        assert landing.run(0.1) is None
    landing.range_m = 0.16
    assert landing.run(60.0) == Done("succeeded", then="force_disarm")


def test_a_touchdown_beside_the_platform_is_no_success() -> None:
    landing = Landing(BOTH)
    while "descent" not in landing.phases:
        assert landing.run(DT_S) is None
    landing.pos_m = add(landing.deck_m, (0.8, 0.0, 0.3))
    landing._still_s = pi
    done = landing.run(DT_S)
    assert done is not None
    assert (done.outcome, done.then) == ("aborted", "disarm")
    assert "m from the middle of the platform" in done.reason


def test_a_touchdown_below_the_surface_by_the_estimate_is_no_success() -> None:
    landing = Landing(BOTH)
    while "contact" not in landing.phases:
        assert landing.run(DT_S) is None
    landing.offset_of_estimate_m = (0.0, 0.0, 0.4)
    landing.landed = True
    done = landing.run(DT_S)
    assert done is not None
    assert (done.outcome, done.then) == ("aborted", "disarm")
    assert "below the platform's surface" in done.reason


def test_a_vehicle_that_comes_below_the_surface_by_the_estimate_goes_around() -> None:
    landing = Landing(BOTH)
    landing.grounded = False
    landing.offset_of_estimate_m = (0.0, 0.0, 0.4)
    done = landing.run(120.0)
    assert "go_around" in landing.phases
    assert done is not None
    assert done.outcome == "aborted"
    assert "came below the platform's surface, which can't be, in spite of" in done.reason


def test_a_vehicle_that_lies_on_the_platform_has_not_landed() -> None:
    landing = Landing(BOTH)
    landing.q_ned_from_frd = (0.6, 0.8, 0.0, 0.0)
    assert landing.run(60.0) == Done("aborted", "the vehicle fell over: it is tilted by 106 degrees", "disarm")


def test_the_vertical_setpoint_makes_no_jump_while_the_estimate_is_good_and_poor_in_turn() -> None:
    landing = Landing(BOTH)
    landing.std_at = lambda offset_m: 0.0 if round(landing.t_s / DT_S) % 50 < 25 else 0.4
    landing.run(15.0)
    high = [move for _, offset_m, move in landing.moves if altitude_m(offset_m[2]) > 0.6]
    down_mps = [move.vel_ned_mps[2] for move in high if move.vel_ned_mps is not None]
    assert max(down_mps) > 0.2
    assert max(abs(b - a) for a, b in pairwise(down_mps)) <= 8.0 * DT_S + 1e-9


def test_the_cone_does_not_widen_beyond_the_place_where_all_feet_stand_on_the_platform() -> None:
    landing = Landing(BOTH)
    landing.std_at = lambda offset_m: 0.35  # it waits above the height of 1.7 m for this
    assert landing.run(60.0) is None
    room_m, height_m = 0.5 - hypot(0.13, 0.16), altitude_m(landing.offset_m[2])
    assert landing.moves[-1][2].feedback.cone_m == pytest.approx(room_m + 0.08 * height_m, abs=0.02)


def test_in_contact_the_feet_are_where_the_present_tilt_puts_them_and_not_the_filtered_one() -> None:
    """The measured place is that of the feet by the filtered tilt, 5 cm north and 3 cm west of the vehicle."""
    landing = Landing(BOTH)
    assert isinstance(landing.behaviour, RoverLanding)
    landing.behaviour._tracking.feet_ned_m = (0.05, -0.03, 0.0)
    measured = PlatformState((0.1, 0.2, -0.1), STILL, STILL, 0.0, std_m=0.02)
    surface = landing.behaviour._on_surface(measured, landing.state())
    assert surface is not None
    assert surface.offset_ned_m == pytest.approx((0.05, 0.23))
    assert surface.std_m == 0.02
    landing.q_ned_from_frd = quat_from_euler(0.0, 0.5, 0.0)
    surface = landing.behaviour._on_surface(measured, landing.state())
    assert surface is not None
    low_m = CONFIG.vehicle.airframe.height_stand_m * sin(0.5)
    assert surface.offset_ned_m == pytest.approx((0.05 + low_m, 0.23)), "its nose is up, its feet are ahead"
    landing.q_ned_from_frd = quat_from_euler(0.5, 0.0, 0.0)
    surface = landing.behaviour._on_surface(measured, landing.state())
    assert surface is not None
    assert surface.offset_ned_m == pytest.approx((0.05, 0.23 - low_m)), "its right side is low: its feet are left"


@pytest.mark.parametrize(("height_m", "phase"), [(1.4, "go_around"), (1.6, "approach")])
def test_a_go_around_ends_a_metre_and_a_half_above_the_platform_also_when_that_is_out_of_sight(
    height_m: float, phase: str
) -> None:
    landing = Landing(BOTH)
    behaviour = landing.behaviour
    assert isinstance(behaviour, RoverLanding)
    behaviour._phase = "go_around"
    behaviour._go_arounds.begin(landing.t_ns, "slides", landing.state())
    behaviour._tracking.platform = PlatformState((0.0, 0.0, -height_m), (0.0, 0.0, -1.5), STILL, 0.0)
    move = behaviour._go_around(landing.t_ns + 1, 0.02, None, landing.state())
    assert isinstance(move, Move)
    assert move.feedback.phase == phase
    assert move.vel_ned_mps is not None and move.vel_ned_mps[2] <= 0.0


def test_the_climb_of_a_go_around_leads_back_over_the_platform_or_along_with_a_rover_out_of_sight() -> None:
    landing = Landing(BOTH, speed_mps=0.5)
    landing.grounded = False
    landing.offset_of_estimate_m = (0.0, 0.0, 0.4)
    while "go_around" not in landing.phases:
        assert landing.run(DT_S) is None
    landing.offset_of_estimate_m = STILL
    north_mps, east_mps, _ = landing.vel_deck_mps
    landing.pos_m, landing.vel_mps = add(landing.deck_m, (0.3, -0.3, -0.8)), landing.vel_deck_mps
    assert landing.run(0.2) is None
    move = landing.moves[-1][2]
    assert move.feedback.phase == "go_around" and move.vel_ned_mps is not None
    assert move.vel_ned_mps[0] < north_mps - 0.2 and move.vel_ned_mps[1] > east_mps + 0.2
    assert move.vel_ned_mps[2] < -1.0
    landing.pos_m = add(landing.deck_m, (0.3, -0.3, -0.8))
    landing.silent = True
    assert landing.run(0.2) is None
    move = landing.moves[-1][2]
    assert move.vel_ned_mps == pytest.approx((north_mps, east_mps, -1.5), abs=0.05)


def test_by_the_tag_alone_it_stays_so_high_on_its_way_that_the_tag_is_in_view() -> None:
    for goal, descends in ((TAG, False), (BOTH, True)):
        behaviour = Landing(goal).behaviour
        assert isinstance(behaviour, RoverLanding)
        far, over = (PlatformState((away_m, 0.0, -6.0), STILL, STILL, 0.0) for away_m in (10.0, 0.0))
        assert (behaviour._approach_mps(far, None) > 0.0) is descends
        assert behaviour._approach_mps(over, None) > 0.0


def test_the_path_leads_from_the_vehicle_to_above_the_platform_and_down_to_it() -> None:
    landing = Landing(BOTH)
    landing.run(0.1)
    assert isinstance(landing.behaviour, RoverLanding)
    here, above, platform = landing.behaviour.path(landing.state())
    assert here == landing.pos_m
    assert platform == pytest.approx(DECK_NED_M, abs=0.05)
    assert above[:2] == platform[:2] and platform[2] - above[2] > 1.0


def test_the_path_leads_to_the_place_of_the_goal_until_the_platform_is_seen() -> None:
    landing = Landing(TAG, sees=lambda t_s, offset_m: False)
    spot_ned_m, above_ned_m = TAG.landing_spot_ned_m, (3.0, -4.0, -3.0)
    assert path_of(landing.behaviour, landing.state()) == (landing.pos_m, above_ned_m, spot_ned_m)


def test_the_path_is_empty_while_nobody_knows_where_the_rover_is() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: False)
    assert path_of(landing.behaviour, landing.state()) == ()
    assert remaining_of(landing.behaviour, landing.state()) is None


def test_a_landing_has_its_touchdown_in_its_result_only_when_it_has_succeeded() -> None:
    behaviour = Landing(BOTH).behaviour
    assert behaviour.result(True, (1.0, 2.0, -0.5)) == LandResult(completed=True, touchdown_ned_m=(1.0, 2.0, -0.5))
    assert behaviour.result(False, (1.0, 2.0, -0.5)) == LandResult(completed=False, touchdown_ned_m=None)


def test_a_vehicle_that_the_wind_tilts_touches_with_its_lowest_foot() -> None:
    """Tilted by 8 degrees the foot on the low side is 3 cm and more below those of a level vehicle."""

    def height_of_contact_m(tilt_rad: float) -> float:
        landing = Landing(BOTH)
        landing.q_ned_from_frd = quat_from_euler(tilt_rad, 0.0, 0.0)
        landing.run(40.0)
        return next(altitude_m(offset_m[2]) for _, offset_m, move in landing.moves if move.feedback.phase == "contact")

    drop_m = foot_drop_m(quat_from_euler(0.14, 0.0, 0.0), CONFIG.vehicle.airframe)
    assert drop_m > 0.02
    assert height_of_contact_m(0.14) - height_of_contact_m(0.0) == pytest.approx(drop_m, abs=0.015)


def test_the_rest_of_a_landing_that_uwb_does_not_reach_has_the_time_of_a_search() -> None:
    near, far = (Landing(TAG, (3.0 + away_m, -4.0, -6.0), sees=lambda t_s, offset_m: False) for away_m in (5.0, 40.0))
    assert isinstance(near.behaviour, RoverLanding) and isinstance(far.behaviour, RoverLanding)
    rests = near.behaviour.remaining(near.state()), far.behaviour.remaining(far.state())
    assert rests[0] is not None and rests[1] is not None
    plain = [rover_landing_remaining((away_m, 0.0, -6.0), CONFIG.land_on_spot.rover) for away_m in (5.0, 40.0)]
    assert rests[0].time_s == pytest.approx(plain[0].time_s)
    beyond_m = hypot(40.0, 6.0) - CONFIG.vehicle.uwb.range_max_m
    assert rests[1].time_s == pytest.approx(plain[1].time_s + 3.0 + beyond_m / 1.5)


@pytest.mark.parametrize(("height_m", "down_s"), [(0.0, 0.0), (0.035, 0.1), (0.07, 0.2), (0.35, 1.0), (-0.2, 0.0)])
def test_low_over_the_platform_the_rest_is_the_slow_way_down_and_the_end_of_the_motors(
    height_m: float, down_s: float
) -> None:
    """The slowest descent is 0.35 m/s; the contact takes 0.4 s, and the motors stop 4 s later."""
    rest = rover_landing_remaining((0.0, 0.0, -height_m), CONFIG.land_on_spot.rover)
    assert rest.time_s == pytest.approx(down_s + 4.4)
    assert rest.distance_m == max(height_m, 0.0)


@pytest.mark.parametrize("start_ned_m", [(-5.0, -3.0, -8.0), (5.0, -3.0, -8.0), (4.0, -3.0, -2.5)])
def test_the_rest_of_a_landing_is_about_the_time_that_it_takes(start_ned_m: Vec3) -> None:
    landing = Landing(BOTH, start_ned_m)
    landing.run(0.1)
    assert isinstance(landing.behaviour, RoverLanding)
    rest = landing.behaviour.remaining(landing.state())
    assert rest is not None
    away_m, height_m = hypot(start_ned_m[0] - 5.0, start_ned_m[1] + 3.0), -start_ned_m[2] - 0.5
    assert rest.distance_m == pytest.approx(away_m + height_m, abs=0.2)
    landing.run(90.0)
    assert rest.time_s - 4.0 == pytest.approx(landing.t_s - 0.1 - 0.8, rel=0.15)


@pytest.mark.parametrize("speed_mps", [0.0, 0.8])
@pytest.mark.parametrize(("height_m", "climbs"), [(3.1, False), (1.5, True)])
def test_a_pause_hovers_over_the_rover_and_climbs_to_the_height_of_the_approach_first(
    speed_mps: float, height_m: float, climbs: bool
) -> None:
    landing = Landing(BOTH, speed_mps=speed_mps)
    while altitude_m(landing.offset_m[2]) > height_m:
        assert landing.run(DT_S) is None
    behaviour = landing.behaviour
    assert isinstance(behaviour, RoverLanding)
    assert behaviour.pause_refusal(landing.state()) == ""
    for _ in range(100):
        move = behaviour.hold(landing.t_ns, DT_S, landing.state())
    assert isinstance(move, Move) and move.vel_ned_mps is not None
    assert move.vel_ned_mps[:2] == pytest.approx(landing.vel_deck_mps[:2], abs=0.15)
    assert (move.vel_ned_mps[2] < -0.1) is climbs
    assert move.feedback.phase == "approach"
    assert landing.run(40.0) == Done("succeeded", then="disarm")


def test_each_pause_hovers_over_the_place_on_the_platform_where_the_vehicle_is_then() -> None:
    landing = Landing(BOTH, (5.0, -3.0, -4.5))
    assert landing.run(0.1) is None
    for off_m in (0.0, 2.0):
        landing.pos_m, landing.vel_mps = add(DECK_NED_M, (off_m, 0.0, -4.0)), STILL
        landing.t_ns += S // 50
        for _ in range(100):
            move = hold_of(landing.behaviour, landing.t_ns, DT_S, landing.state())
        assert isinstance(move, Move) and move.vel_ned_mps == pytest.approx(STILL, abs=0.02)


@pytest.mark.parametrize(("phase", "driven_m"), [("hold", 10.0), ("search", 10.0 * 0.432)])
def test_in_a_pause_a_rover_out_of_sight_is_supposed_to_drive_on_and_ever_slower_once_it_is_searched_for(
    phase: str, driven_m: float
) -> None:
    """20 s at 0.5 m/s, or with a time constant of 10 s: a share of (1 - exp(-2)) / 2."""
    landing = Landing(BOTH, speed_mps=0.5, sees=lambda t_s, offset_m: t_s < 6.0)
    while phase not in landing.phases:
        assert landing.run(DT_S) is None
    landing.silent = True
    _, _, from_ned_m = path_of(landing.behaviour, landing.state())
    for _ in range(200):
        assert isinstance(hold_of(landing.behaviour, landing.t_ns, 0.1, landing.state()), Move)
    _, _, to_ned_m = path_of(landing.behaviour, landing.state())
    assert hypot(*subtract(to_ned_m, from_ned_m)) == pytest.approx(driven_m, rel=0.03)


def test_a_pause_without_a_measured_rover_hovers_where_it_is_and_ends_out_of_bounds() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: False)
    assert landing.run(1.0) is None
    behaviour = landing.behaviour
    assert isinstance(behaviour, RoverLanding)
    for _ in range(100):
        move = behaviour.hold(landing.t_ns, DT_S, landing.state())
    assert isinstance(move, Move)
    assert move.vel_ned_mps == pytest.approx(STILL, abs=0.05)
    landing.pos_m = (-1.0, 160.0, -6.0)
    done = behaviour.hold(landing.t_ns, DT_S, landing.state())
    assert isinstance(done, Done) and "distance_max_m" in done.reason


@pytest.mark.parametrize("phase", ["contact", "go_around"])
def test_a_touchdown_is_not_paused(phase: LandPhase) -> None:
    behaviour = Landing(BOTH).behaviour
    assert isinstance(behaviour, RoverLanding)
    behaviour._phase = phase
    assert behaviour.pause_refusal(Landing(BOTH).state())


def test_a_vehicle_that_bounces_off_the_platform_descends_again() -> None:
    landing = Landing(BOTH)
    landing.grounded = False
    while "contact" not in landing.phases:
        assert landing.run(DT_S) is None
    for height_m, phase in ((0.38, "contact"), (0.42, "descent")):
        landing.pos_m = add(landing.deck_m, (0.0, 0.0, -height_m))
        landing.vel_mps = STILL
        landing.run(DT_S)
        landing.run(DT_S)
        assert landing.moves[-1][2].feedback.phase == phase


@pytest.mark.parametrize("altimeter", [True, False])
@pytest.mark.parametrize(
    ("start_ned_m", "fastest_mps"),
    [((-5.0, -3.0, -12.0), 1.2), ((2.0, -3.0, -1.7), -1.0), ((-5.0, -3.0, -4.0), 0.4)],
    ids=["from high up", "from below", "from half a metre above"],
)
def test_the_approach_comes_to_its_height_of_three_metres_by_the_rest_and_within_its_limits(
    start_ned_m: Vec3, fastest_mps: float, altimeter: bool
) -> None:
    landing = Landing(BOTH, start_ned_m)
    while "descent" not in landing.phases:
        landing.range_m = altitude_m(landing.offset_m[2]) if altimeter else None
        assert landing.run(DT_S) is None
    down_mps = [move.vel_ned_mps[2] for _, _, move in landing.moves[:-1] if move.vel_ned_mps is not None]
    assert max(down_mps, key=abs) == pytest.approx(fastest_mps, rel=0.1)
    assert all(-1.0 <= vel_mps <= 1.2 for vel_mps in down_mps)
    assert altitude_m(landing.offset_m[2]) == pytest.approx(3.0, abs=0.6)


def test_over_the_platform_each_move_has_the_platform_as_its_target_so_that_a_runaway_is_noticed() -> None:
    landing = Landing(BOTH, speed_mps=0.5, sees=lambda t_s, offset_m: not 5.0 < t_s < 7.0)
    deck_ned_m: list[Vec3] = []
    while landing.run(DT_S) is None:
        deck_ned_m.append(subtract(landing.moves[-1][2].feedback.pos_uav_ned_m, landing.moves[-1][1]))
    led = [
        (move.target_ned_m, deck_m)
        for (_, _, move), deck_m in zip(landing.moves, deck_ned_m, strict=True)
        if move.feedback.phase in ("approach", "descent", "hold") and move.vel_ned_mps is not None
    ]
    assert len(led) > 300
    for target_ned_m, deck_m in led:
        assert target_ned_m is not None and target_ned_m[:2] == pytest.approx(deck_m[:2], abs=0.2)


def test_a_contradiction_holds_the_vehicle_where_it_was_then() -> None:
    landing = Landing(BOTH, (-5.0, -3.0, -6.0))
    assert landing.run(3.0) is None
    landing.contradicted = "UWB and tag contradict each other"
    before_m = landing.pos_m
    assert landing.run(1.0) is None
    move = landing.moves[-1][2]
    assert move.feedback.phase == "hold"
    assert move.pos_ned_m == pytest.approx(before_m, abs=0.1)


def test_the_vertical_speed_of_a_deck_and_its_acceleration_are_followed() -> None:
    landing = Landing(BOTH, (2.0, -3.0, -3.5))
    landing.vel_rover_error_mps = (0.0, 0.0, 0.2)
    landing.deck = deck_motion(acc_down_mps2=0.3)
    landing.run(0.3)
    move = landing.moves[-1][2]
    assert move.vel_ned_mps is not None and move.acc_ned_mps2 is not None
    assert move.vel_ned_mps[2] == pytest.approx(0.2, abs=0.03)
    assert move.acc_ned_mps2[2] == pytest.approx(0.3)


def test_in_contact_the_vehicle_pushes_against_a_deck_that_moves_with_half_a_metre_per_second() -> None:
    landing = Landing(BOTH)
    landing.grounded = False
    while "contact" not in landing.phases:
        assert landing.run(DT_S) is None
    landing.vel_rover_error_mps = (0.0, 0.1, -0.2)
    landing.deck = deck_motion(acc_down_mps2=0.3)
    landing.run(0.2)
    move = landing.moves[-1][2]
    assert move.vel_ned_mps == pytest.approx((0.0, 0.1, 0.3))
    assert move.acc_ned_mps2 == pytest.approx((0.0, 0.0, 5.3))


@pytest.mark.parametrize(("height_m", "at_once"), [(0.5, True), (0.75, False)])
def test_close_to_the_platform_a_descent_stops_at_once_and_gradually_higher_up(height_m: float, at_once: bool) -> None:
    landing = Landing(BOTH)
    while altitude_m(landing.offset_m[2]) > height_m:
        assert landing.run(DT_S) is None
    landing.std_at = lambda offset_m: 0.4
    assert landing.run(DT_S) is None
    vel_ned_mps = landing.moves[-1][2].vel_ned_mps
    assert vel_ned_mps is not None
    assert (vel_ned_mps[2] == 0.0) is at_once
    assert vel_ned_mps[2] >= 0.0


@pytest.mark.parametrize(
    ("beside_m", "height_m", "climbs"), [(0.75, 0.8, False), (0.85, 0.8, True), (0.85, 1.2, False)]
)
def test_beside_the_platform_and_lower_than_a_metre_it_climbs_before_it_comes_near(
    beside_m: float, height_m: float, climbs: bool
) -> None:
    """The platform reaches 0.5 m from its middle, and 0.3 m are permitted."""
    landing = Landing(BOTH, add(DECK_NED_M, (0.0, beside_m, -height_m)))
    landing.run(0.2)
    move = next(move for _, _, move in landing.moves if move.vel_ned_mps is not None)
    assert move.vel_ned_mps is not None
    assert (move.vel_ned_mps[1] == 0.0) is climbs
    assert move.vel_ned_mps[2] < -0.9 or not climbs


def test_a_search_flies_hexagons_that_grow_in_width_and_height_and_ends_after_its_rounds() -> None:
    search, t_ns, corners = Search(0, 3.0, SearchConfig(tries=2, radius_m=2.0, height_max_m=5.0)), 0, []
    while not search.over:
        corners.append((search.offset_m, search.height_m))
        t_ns += 1
        search.step(t_ns, search.offset_m, search.height_m)
    assert len(corners) == 2 * 7
    heights_m = [height_m for _, height_m in corners]
    assert heights_m == [3.0, *(4.5,) * 6, 4.5, *(5.0,) * 6]
    for turn in (0, 1):
        middle, *around = (offset_m for offset_m, _ in corners[7 * turn : 7 * turn + 7])
        assert middle == (0.0, 0.0)
        radius_m = 2.0 * (turn + 1)
        assert around[0] == pytest.approx((radius_m, 0.0)), "the north first"
        assert around[1] == pytest.approx((0.5 * radius_m, 0.5 * 3**0.5 * radius_m)), "clockwise"
        assert around[5] == pytest.approx((0.5 * radius_m, -0.5 * 3**0.5 * radius_m))


@pytest.mark.parametrize(
    ("off_m", "after_s", "goes_on"),
    [
        ((0.49, 0.0, 0.0), 0.1, True),
        ((0.0, -0.49, 0.0), 0.1, True),
        ((0.0, 0.0, 0.49), 0.1, True),
        ((0.3, 0.3, 0.3), 0.1, False),
        ((5.0, 0.0, 0.0), 9.9, False),
        ((5.0, 0.0, 0.0), 10.1, True),
    ],
)
def test_a_corner_of_a_search_is_reached_within_half_a_metre_or_given_up_after_ten_seconds(
    off_m: Vec3, after_s: float, goes_on: bool
) -> None:
    search = Search(0, 3.0, SearchConfig())
    for _ in range(2):
        search.step(0, search.offset_m, search.height_m)
    north_m, east_m = corner_m = search.offset_m
    search.step(int(after_s * S), (north_m + off_m[0], east_m + off_m[1]), search.height_m + off_m[2])
    assert (search.offset_m != corner_m) is goes_on


# -- a deck that moves more than is permitted ------------------------------------------------------------


def test_a_deck_that_moves_too_much_ends_the_approach_before_the_descent() -> None:
    landing = Landing(BOTH)
    landing.deck = deck_motion(climb_significant_mps=1.2)
    done = landing.run(40.0)
    assert done is not None and "the platform heaves with 1.20 m/s" in done.reason
    assert landing.phases == ["approach"]


def test_a_deck_that_begins_to_move_too_much_during_the_descent_sends_the_vehicle_up_before_the_landing_ends() -> None:
    landing = Landing(BOTH)
    landing.deck = deck_motion()
    while landing.run(0.1) is None and altitude_m(landing.offset_m[2]) > 1.0:
        pass
    assert landing.phases[-1] == "descent"
    landing.deck = deck_motion(tilt_significant_rad=0.3)
    done = landing.run(40.0)
    assert done is not None and (done.outcome, done.then) == ("aborted", "hover")
    assert "tilts by 17 degrees" in done.reason
    assert altitude_m(landing.offset_m[2]) > CONFIG.land_on_spot.rover.height_approach_m - 0.6


def test_a_vehicle_that_is_about_to_touch_a_deck_lands() -> None:
    landing = Landing(BOTH)
    landing.deck = deck_motion()
    while landing.run(0.02) is None and altitude_m(landing.offset_m[2]) > 0.08:
        pass
    landing.deck = deck_motion(tilt_significant_rad=0.3)
    assert landing.run(40.0) == Done("succeeded", then="disarm")


def test_a_forced_landing_is_flown_on_any_deck() -> None:
    landing = Landing(replace(BOTH, force=True))
    landing.deck = deck_motion(climb_significant_mps=1.2)
    assert landing.run(40.0) == Done("succeeded", then="disarm")
