"""What holds a descent back over the platform, and which estimates a landing comes nearer by."""

import re

import pytest
from msgspec.structs import replace

from jezero.base.frames import Vec3, quat_from_euler
from jezero.schemas.estimate import Relative, RoverEstimate
from jezero.services.actions.land_on_spot.config import DeckConfig, PlatformControlConfig, RoverLandingConfig
from jezero.services.actions.land_on_spot.platform import (
    CalmMoment,
    Descent,
    PlatformControl,
    PlatformState,
    PlatformTracking,
    VerticalSpeed,
    deck_refusal,
    platform_state_at,
)
from jezero.services.actions.motion.behaviour import VehicleState
from tests.services.actions.land_on_spot.landing_rig import deck_motion

S = 1_000_000_000
STILL: Vec3 = (0.0, 0.0, 0.0)
CONFIG = RoverLandingConfig(cone_m=0.01, cone_per_m=0.08, descent_min_mps=0.35, descent_max_mps=1.5, coast_s=0.5)


def over_platform(height_m: float, vel_mps: tuple[float, float] = (0.0, 0.0), std_m: float = 0.0) -> PlatformState:
    return PlatformState((0.0, 0.0, -height_m), (*vel_mps, 0.0), STILL, 0.0, std_m)


@pytest.mark.parametrize(
    ("vel_mps", "down_mps"),
    [
        ((0.49, 0.0), 1.2),
        ((0.0, -0.49), 1.2),
        ((0.51, 0.0), 0.0),
        ((0.0, 0.51), 0.0),
        ((0.0, -0.51), 0.0),
        ((0.35, 0.35), 1.2),
        ((0.36, -0.36), 0.0),
    ],
)
def test_it_descends_only_while_it_is_slower_than_half_a_metre_per_second_on_both_axes_together(
    vel_mps: tuple[float, float], down_mps: float
) -> None:
    """2 m up the cone is 0.17 m wide, and 0.51 m/s lead 0.153 m away in 0.3 s: the speed alone holds it back."""
    descent = Descent(CONFIG, room_m=0.4)
    assert descent.down_mps(S, over_platform(2.0, vel_mps)) == pytest.approx(down_mps)
    assert descent.may_begin(over_platform(2.0, vel_mps)) is (down_mps > 0.0)


@pytest.mark.parametrize(
    ("height_m", "std_m", "down_mps"),
    [(0.5, 0.174, 0.35), (0.5, 0.176, 0.0), (2.0, 0.39, 1.2), (2.0, 0.41, 0.0)],
)
def test_the_lower_it_is_the_better_an_estimate_it_descends_by(height_m: float, std_m: float, down_mps: float) -> None:
    """0.1 m + 0.15 of the height are permitted: 0.175 m and 0.4 m."""
    assert Descent(CONFIG, room_m=0.4).down_mps(S, over_platform(height_m, std_m=std_m)) == pytest.approx(down_mps)


@pytest.mark.parametrize(("height_m", "down_mps"), [(0.3, 0.35), (0.8, 0.48), (2.2, 1.32), (2.9, 1.5)])
def test_the_speed_of_the_descent_is_proportional_to_the_height_within_its_limits(
    height_m: float, down_mps: float
) -> None:
    assert Descent(CONFIG, room_m=0.4).down_mps(S, over_platform(height_m)) == pytest.approx(down_mps)


@pytest.mark.parametrize(("height_m", "begins"), [(2.0, True), (3.4, True), (3.6, False)])
def test_a_descent_begins_half_a_metre_above_the_height_of_the_approach_at_most(height_m: float, begins: bool) -> None:
    assert Descent(CONFIG, room_m=0.4).may_begin(over_platform(height_m)) is begins


@pytest.mark.parametrize("north", [True, False])
@pytest.mark.parametrize(("error_m", "begins"), [(0.16, True), (0.18, False)])
def test_a_descent_begins_inside_its_cone(error_m: float, begins: bool, north: bool) -> None:
    """2 m up the cone is 0.17 m wide."""
    pos_ned_m = (error_m, 0.0, -2.0) if north else (0.0, -error_m, -2.0)
    assert Descent(CONFIG, room_m=0.4).may_begin(PlatformState(pos_ned_m, STILL, STILL, 0.0)) is begins


@pytest.mark.parametrize(
    ("height_m", "error_m", "descends"), [(0.08, 0.3, True), (0.12, 0.3, False), (0.08, 0.45, False)]
)
def test_a_vehicle_that_is_about_to_touch_descends_outside_its_cone_too_if_the_platform_is_below_it(
    height_m: float, error_m: float, descends: bool
) -> None:
    platform = PlatformState((0.0, error_m, -height_m), STILL, STILL, 0.0)
    assert (Descent(CONFIG, room_m=0.4).down_mps(S, platform) > 0.0) is descends


def an_estimate(
    t_ns: int,
    *,
    pos_ned_m: Vec3,
    vel_ned_mps: Vec3 = STILL,
    std_m: float = 0.0,
    valid: bool = True,
    contradicted: bool = False,
    fused_t_ns: int = 0,
) -> Relative:
    return Relative(
        t_ns=t_ns,
        epoch_id=1,
        valid=valid,
        reason="" if valid else "too uncertain",
        contradicted=contradicted,
        pos_uav_rel_rover_ned_m=pos_ned_m,
        vel_uav_rel_rover_ned_mps=vel_ned_mps,
        cov=(std_m**2 / 2.0, *(0.0,) * 5, std_m**2 / 2.0, *(0.0,) * 14),
        vel_rover_ned_mps=STILL,
        yaw_rover_rad=0.0,
        yaw_rate_rover_rps=0.0,
        use_uwb=True,
        use_tag=True,
        fused_t_ns=fused_t_ns,
    )


@pytest.mark.parametrize(("age_s", "moved_m"), [(0.0, 0.0), (0.2, 0.2), (2.0, 0.5), (-0.2, 0.0)])
def test_an_old_estimate_is_carried_on_by_its_velocity_for_half_a_second_at_most(age_s: float, moved_m: float) -> None:
    t_ns = 100 * S
    relative = an_estimate(t_ns - int(age_s * S), pos_ned_m=(3.0, -2.0, -4.0), vel_ned_mps=(1.0, -1.0, 0.5))
    state = platform_state_at(t_ns, relative, (0.1, 0.2, 0.0))
    expected_m = (3.1 + moved_m, -1.8 - moved_m, -4.0 + 0.5 * moved_m)
    assert state.pos_ned_m == pytest.approx(expected_m)
    assert state.vel_ned_mps == (1.0, -1.0, 0.5)


@pytest.mark.parametrize(
    ("pos_m", "std_m", "age_s", "contradicted", "comes_nearer"),
    [
        ((3.0, 0.0), 1.19, 0.1, False, True),
        ((3.0, 0.0), 1.21, 0.1, False, False),
        ((0.0, -3.0), 1.19, 0.1, False, True),
        ((0.0, -3.0), 1.21, 0.1, False, False),
        ((3.0, 0.0), 0.5, 0.49, False, True),
        ((3.0, 0.0), 0.5, 0.51, False, False),
        ((3.0, 0.0), 0.5, 0.1, True, False),
    ],
)
def test_it_comes_nearer_by_an_invalid_estimate_only_if_that_is_good_for_its_distance_young_and_not_contradicted(
    pos_m: tuple[float, float], std_m: float, age_s: float, contradicted: bool, comes_nearer: bool
) -> None:
    t_ns = 100 * S
    relative = an_estimate(
        t_ns,
        pos_ned_m=(*pos_m, -4.0),
        std_m=std_m,
        valid=False,
        contradicted=contradicted,
        fused_t_ns=t_ns - int(age_s * S),
    )
    state = VehicleState((0.0, 0.0, -5.0), STILL, (1.0, 0.0, 0.0, 0.0), armed=True, landed=False, relative=relative)
    tracking = PlatformTracking(90 * S, None, CONFIG.coast_s)
    assert tracking.update(t_ns, 0.02, state, searches=False) is None
    assert (tracking.rough is not None) is comes_nearer


def contact_after_s(height_m: float, feet_m: float, ratio: float) -> float | None:
    """Time until a descent at 0.5 m/s that reaches only a ratio of it counts as contact; None for more than 2 s."""
    descent = Descent(CONFIG, room_m=0.4)
    platform = PlatformState((0.0, 0.0, -height_m), (0.0, 0.0, 0.5 * ratio), STILL, 0.0)
    steps = (n for n in range(101) if descent.has_contact(S + n * S // 50, platform, feet_m, 0.5))
    return next((n / 50.0 for n in steps), None)


@pytest.mark.parametrize(
    ("height_m", "feet_m", "ratio", "after_s"),
    [
        (0.2, 0.2, 0.45, 0.42),
        (0.2, 0.2, 0.55, None),
        (0.2, 0.2, -0.5, 0.42),
        (0.29, 0.29, 0.0, 0.42),
        (0.31, 0.31, 0.0, None),
        (0.2, 0.02, 1.0, 0.0),
        (0.2, 0.04, 1.0, None),
    ],
)
def test_a_low_foot_is_contact_at_once_and_less_than_half_the_speed_after_four_tenths_of_a_second(
    height_m: float, feet_m: float, ratio: float, after_s: float | None
) -> None:
    assert contact_after_s(height_m, feet_m, ratio) == after_s


def test_a_stop_begins_anew_when_the_vehicle_moves_or_no_longer_descends() -> None:
    descent, stopped = Descent(CONFIG, room_m=0.4), over_platform(0.2)
    moving = PlatformState((0.0, 0.0, -0.2), (0.0, 0.0, 0.5), STILL, 0.0)
    for t_ns, platform, down_mps in ((0, stopped, 0.5), (3, moving, 0.5), (6, stopped, 0.0), (9, stopped, 0.5)):
        assert not descent.has_contact(t_ns * S // 10, platform, 0.2, down_mps)
    assert descent.has_contact(11 * S // 10, stopped, 0.2, 0.5)


def test_the_velocity_over_the_platform_is_that_of_a_pi_controller_with_the_rovers_fed_forward() -> None:
    """At 2 m the gain is 1.55 /s, in the middle between those of 0.5 m and 3.5 m, but √(2 · 1.5 · 2) m/s is faster
    than the vehicle can brake."""
    config = PlatformControlConfig(gain_far_1ps=0.9, gain_near_1ps=2.2, gain_integral_1ps2=0.8, speed_max_mps=3.5)
    rover_mps, turn_rps = (0.6, -0.3, 0.0), 0.2
    for error_m, speed_mps in ((0.2, 0.44), (2.0, 6.0**0.5), (3.0, 3.0), (3.5, 3.15), (9.0, 3.5)):
        platform = PlatformState((0.6 * error_m, -0.8 * error_m, -3.0), (0.1, 0.2, 0.3), rover_mps, turn_rps)
        velocity, acceleration = PlatformControl(config).command(0.0, platform)
        assert velocity == pytest.approx((0.6 - 0.6 * speed_mps, -0.3 + 0.8 * speed_mps), rel=0.05)
        pull_1ps = speed_mps / error_m
        turning = (0.3 * turn_rps, 0.6 * turn_rps)
        assert acceleration == pytest.approx((turning[0] - pull_1ps * 0.1, turning[1] - pull_1ps * 0.2), rel=0.05)


def test_the_integral_grows_near_the_middle_stays_on_the_way_and_is_left_behind_far_away() -> None:
    control = PlatformControl(PlatformControlConfig(gain_near_1ps=2.0, gain_integral_1ps2=0.8))

    def at(north_m: float, east_m: float) -> PlatformState:
        return PlatformState((north_m, east_m, -3.0), STILL, STILL, 0.0)

    def integral_mps() -> tuple[float, float]:
        return control.command(1.0, at(0.0, 0.0))[0]

    assert control.command(1.0, at(0.1, -0.2))[0] == pytest.approx((-0.2 - 0.08, 0.4 + 0.16))
    assert integral_mps() == pytest.approx((-0.08, 0.16))
    control.command(1.0, at(3.4, 0.0))
    assert integral_mps() == pytest.approx((-0.08, 0.16))
    for _ in range(9):
        control.command(1.0, at(0.12, -0.16))
    north_mps, east_mps = integral_mps()
    assert north_mps**2 + east_mps**2 == pytest.approx(0.09) and north_mps < 0.0 < east_mps
    control.command(1.0, at(3.6, 0.0))
    assert integral_mps() == (0.0, 0.0)


# -- a platform that heaves ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("climb_down_mps", "motion", "calm"),
    [
        (0.0, {}, True),
        (0.25, {}, True),
        (-0.35, {}, False),
        (0.25, {"acc_down_mps2": 0.2}, False),
        (-0.4, {"acc_down_mps2": 0.2}, True),
        (0.0, {"roll_rad": 0.05}, True),
        (0.0, {"pitch_rad": -0.07}, False),
        (0.0, {"roll_rad": 0.08, "roll_rate_rps": -0.05}, True),
        (0.0, {"roll_rad": 0.05, "roll_rate_rps": 0.05}, False),
        (0.0, {"pitch_rad": 0.08, "pitch_rate_rps": -0.05}, True),
        (0.0, {"pitch_rad": 0.05, "pitch_rate_rps": 0.05}, False),
    ],
)
def test_a_moment_is_calm_in_which_the_deck_will_be_slow_and_level_at_the_touchdown(
    climb_down_mps: float, motion: dict[str, float], calm: bool
) -> None:
    """The touchdown is in one second; 0.3 m/s and 0.06 rad are permitted."""
    assert CalmMoment(DeckConfig()).is_calm(0.02, deck_motion(**motion), climb_down_mps, 1.0) is calm


def test_the_motion_of_a_deck_is_predicted_to_the_touchdown_and_for_a_second_at_most() -> None:
    rolls_back = deck_motion(roll_rad=0.08, roll_rate_rps=-0.1)
    calm = [CalmMoment(DeckConfig()).is_calm(0.02, rolls_back, 0.0, touchdown_s) for touchdown_s in (0.1, 1.0, 3.0)]
    assert calm == [False, True, True], "0.07 rad, -0.02 rad, and not -0.22 rad"


def test_a_vehicle_that_waits_for_a_calm_moment_takes_a_worse_one_later() -> None:
    moment, deck = CalmMoment(DeckConfig(climb_calm_mps=0.3, widening_s=6.0)), deck_motion()
    waited_s = 0.0
    while not moment.is_calm(0.1, deck, 0.6, 1.0):
        waited_s += 0.1
    assert waited_s == pytest.approx(6.0, abs=0.2)


def test_over_a_deck_that_is_not_calm_the_vehicle_waits_low_but_goes_on_from_where_it_would_touch() -> None:
    rough = deck_motion(pitch_rad=0.1)
    descent = Descent(CONFIG, room_m=0.4)

    def down_mps(height_m: float) -> float:
        return descent.down_mps(S, over_platform(height_m)._replace(deck=rough))

    assert [down_mps(1.0), down_mps(0.39), down_mps(0.09)] == pytest.approx([0.6, 0.0, 0.35])


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        ({"climb_significant_mps": 0.99, "tilt_significant_rad": 0.19}, ""),
        ({"climb_significant_mps": 1.2}, "heaves with 1.20 m/s and tilts by 0 degrees .* limited to 1 m/s"),
        ({"tilt_significant_rad": 0.3}, "tilts by 17 degrees .* limited to 11 degrees"),
        ({"climb_significant_mps": 1.2, "observed_s": 7.0}, ""),
    ],
)
def test_a_deck_beyond_its_limits_is_refused_with_its_figures_once_it_has_been_observed(
    motion: dict[str, float], words: str
) -> None:
    refusal = deck_refusal(deck_motion(**motion), DeckConfig())
    assert re.search(words, refusal) if words else refusal == ""
    assert deck_refusal(None, DeckConfig()) == ""


def test_a_descent_to_a_deck_begins_when_it_has_been_observed() -> None:
    descent, low = Descent(CONFIG, room_m=0.4), over_platform(2.0)
    assert descent.may_begin(low._replace(deck=deck_motion()))
    assert not descent.may_begin(low._replace(deck=deck_motion(observed_s=7.9)))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("speed_mps", "descends"), [(0.3, False), (-0.3, True)])
def test_a_vehicle_that_drifts_out_of_the_cone_waits_and_one_that_drifts_in_descends(
    axis: int, speed_mps: float, descends: bool
) -> None:
    """1 m up the cone is 0.09 m wide; 0.3 m/s lead 0.09 m on in 0.3 s."""
    pos_m, vel_mps = (0.05, 0.0, -1.0), (speed_mps, 0.0, 0.0)
    if axis == 1:
        pos_m, vel_mps = (0.0, 0.05, -1.0), (0.0, speed_mps, 0.0)
    platform = PlatformState(pos_m, vel_mps, STILL, 0.0)
    assert (Descent(CONFIG, room_m=0.4).down_mps(S, platform) > 0.0) is descends


@pytest.mark.parametrize(("height_m", "error_m", "down_mps"), [(2.0, 0.6, 0.0), (2.0, 0.75, -0.35), (3.2, 2.0, 0.0)])
def test_a_low_vehicle_that_has_strayed_far_out_of_the_cone_climbs(
    height_m: float, error_m: float, down_mps: float
) -> None:
    """2 m up the cone is 0.17 m wide, and four times that is far."""
    platform = PlatformState((0.0, -error_m, -height_m), STILL, STILL, 0.0)
    assert Descent(CONFIG, room_m=0.4).down_mps(S, platform) == down_mps


def test_the_cone_widens_while_the_vehicle_waits_and_narrows_while_it_descends() -> None:
    descent, inside = Descent(CONFIG, room_m=0.4), over_platform(1.0)
    outside = PlatformState((0.3, 0.0, -1.0), STILL, STILL, 0.0)
    widths_m = []
    for t_s, platform in ((0.0, outside), (0.1, outside), (0.2, outside), (0.3, inside), (0.4, inside), (0.5, inside)):
        descent.down_mps(int(t_s * S), platform)
        widths_m.append(descent.cone_m(inside))
    per_step_m = 0.09 * 0.1 / CONFIG.cone_widening_s
    assert widths_m == pytest.approx([0.09 + n * per_step_m for n in (0, 1, 2, 1, 0, 0)])


def test_a_time_without_steps_as_in_a_pause_widens_the_cone_by_no_more_than_a_step() -> None:
    descent, outside = Descent(CONFIG, room_m=0.4), PlatformState((0.3, 0.0, -1.0), STILL, STILL, 0.0)
    for t_s in (0, 20):
        descent.down_mps(t_s * S, outside)
    assert descent.cone_m(outside) == pytest.approx(0.09 * (1.0 + 0.1 / CONFIG.cone_widening_s))


def test_a_time_without_steps_low_over_the_platform_is_no_stop_of_the_descent() -> None:
    descent, stopped = Descent(CONFIG, room_m=0.4), over_platform(0.2)
    for t_s in (1.0, 1.02, 3.0):
        descent.down_mps(int(t_s * S), stopped)
        assert not descent.has_contact(int(t_s * S), stopped, 0.2, 0.35)


def test_the_landing_aims_with_the_feet_which_the_tilt_against_the_wind_puts_beside_the_vehicle() -> None:
    """0.2 rad nose up for long puts the feet 0.22 m · sin 0.2 = 4 cm ahead; the rover is where it is."""
    tracking, nose_up = PlatformTracking(0, None, 0.5), quat_from_euler(0.0, 0.2, 0.0)
    for step in range(1, 400):
        t_ns = step * S // 50
        relative = an_estimate(t_ns, pos_ned_m=(1.0, 2.0, -3.0), fused_t_ns=t_ns)
        state = VehicleState((11.0, 22.0, -33.0), STILL, nose_up, armed=True, landed=False, relative=relative)
        platform = tracking.update(t_ns, 0.02, state, searches=False)
    assert platform is not None
    assert platform.pos_ned_m == pytest.approx((1.044, 2.0, -3.0), abs=0.002)
    assert tracking.pos_rover_ned_m == pytest.approx((10.0, 20.0, -30.0))


@pytest.mark.parametrize(("searches", "left"), [(False, (1.0, 1.0)), (True, (0.3, 0.45))])
def test_the_supposed_speed_of_a_rover_decays_within_ten_seconds_of_a_search(
    searches: bool, left: tuple[float, float]
) -> None:
    tracking = PlatformTracking(0, (5.0, 1.0, -0.5), 0.5)
    tracking.vel_rover_ned_mps = (0.6, -0.8, 0.0)
    state = VehicleState((0.0, 0.0, -5.0), STILL, (1.0, 0.0, 0.0, 0.0), armed=True, landed=False)
    for step in range(500):
        tracking.update(step * S // 50, 0.02, state, searches=searches)
    north_mps, east_mps, _ = tracking.vel_rover_ned_mps
    assert left[0] <= (north_mps**2 + east_mps**2) ** 0.5 <= left[1]
    assert east_mps / north_mps == pytest.approx(-0.8 / 0.6)


def test_a_platform_out_of_sight_is_where_the_rover_would_have_driven_to() -> None:
    """It drives north at 1 m/s for 2 s, and the vehicle stands still in the air."""
    tracking, level = PlatformTracking(0, None, 0.5), (1.0, 0.0, 0.0, 0.0)
    seen = replace(an_estimate(S, pos_ned_m=(0.0, 0.0, -3.0), fused_t_ns=S), vel_rover_ned_mps=(1.0, 0.0, 0.0))
    state = VehicleState((0.0, 0.0, -5.0), STILL, level, armed=True, landed=False, relative=seen)
    assert tracking.update(S, 0.02, state, searches=False) is not None
    assert tracking.was_measured
    for step in range(1, 101):
        assert tracking.update(S + step * S // 50, 0.02, replace(state, relative=None), searches=False) is None
    assert tracking.platform is not None
    assert tracking.platform.pos_ned_m == pytest.approx((-2.0, 0.0, -3.0))
    assert tracking.platform.vel_ned_mps == (-1.0, 0.0, 0.0)
    assert tracking.loss_reason == "the estimator is silent"


def test_the_feet_of_a_vehicle_that_tilts_against_the_wind_are_downwind_after_a_second() -> None:
    tracking, nose_up = PlatformTracking(0, None, 0.5), quat_from_euler(0.0, 0.2, 0.0)
    state = VehicleState(STILL, STILL, nose_up, armed=True, landed=False)
    for step in range(50):
        tracking.update(step * S // 50, 0.02, state, searches=False)
    settled = tracking.tilt_ned[0] / state.down_ned[0]
    assert settled == pytest.approx(1.0 - 0.98**50, abs=0.01)
    assert state.down_ned[0] > 0.19 and tracking.tilt_ned[1] == pytest.approx(0.0)


@pytest.mark.parametrize(("valid", "expected_m"), [(True, (9.0, 9.0, -0.5)), (False, (7.0, 1.0, -0.5))])
def test_a_rover_that_is_not_measured_is_where_its_own_estimate_or_its_last_velocity_puts_it(
    valid: bool, expected_m: Vec3
) -> None:
    tracking = PlatformTracking(0, (5.0, 1.0, -0.5), 0.5)
    tracking.vel_rover_ned_mps = (1.0, 0.0, 0.0)
    rover = RoverEstimate(
        t_ns=0,
        epoch_id=1,
        valid=valid,
        pos_rover_ned_m=(9.0, 9.0, -0.5),
        vel_rover_ned_mps=(0.0, 2.0, 0.0),
        yaw_rover_rad=0.0,
        std_pos_m=1.0,
    )
    state = VehicleState((0.0, 0.0, -5.0), STILL, (1.0, 0.0, 0.0, 0.0), armed=True, landed=False, rover=rover)
    for step in range(100):
        tracking.update(step * S // 50, 0.02, state, searches=False)
    assert tracking.pos_rover_ned_m == pytest.approx(expected_m)
    assert tracking.vel_rover_ned_mps == ((0.0, 2.0, 0.0) if valid else (1.0, 0.0, 0.0))


def test_the_vertical_setpoint_brakes_faster_than_it_speeds_up_and_begins_at_the_vehicles_speed() -> None:
    vertical = VerticalSpeed()
    assert vertical.changed(0, 1.0, 0.3, gradually=True) == 0.3
    assert vertical.changed(S // 20, 1.0, 0.3, gradually=True) == pytest.approx(0.3 + 2.0 * 0.05)
    assert vertical.changed(S // 10, -1.0, 0.3, gradually=True) == pytest.approx(0.4 - 8.0 * 0.05)
    assert vertical.changed(3 * S // 20, -1.0, 0.3, gradually=False) == -1.0
    assert vertical.changed(S, 1.0, 0.2, gradually=True) == 0.2, "something else has moved the vehicle meanwhile"
