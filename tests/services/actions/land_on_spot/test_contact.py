"""A contact that slides or leans becomes a go-around; too many of them, or too much wind, end the landing."""

from math import cos, degrees, radians, sin

import msgspec
import pytest

from jezero.base.frames import Quat, Vec3, quat_from_euler
from jezero.base.vehicle_config import AirframeConfig, PlanetConfig, PlatformConfig, VehicleConfig
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.contact import (
    ContactWatcher,
    GoArounds,
    OnSurface,
    TouchdownDetector,
    feet_from_uav_ned_m,
    foot_drop_m,
    landing_outcome,
    level_acc_ned_mps2,
)
from jezero.services.actions.land_on_spot.platform import PlatformState
from jezero.services.actions.motion.behaviour import VehicleState
from tests.services.actions.land_on_spot.landing_rig import deck_motion

ROOM_M = 0.3
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
CENTRED = OnSurface((0.0, 0.0))
STILL: Vec3 = (0.0, 0.0, 0.0)


def rolled(angle_deg: float) -> Quat:
    return (cos(radians(angle_deg) / 2.0), sin(radians(angle_deg) / 2.0), 0.0, 0.0)


def state_with(q_ned_from_frd: Quat = LEVEL) -> VehicleState:
    return VehicleState((0.0, 0.0, -1.0), (0.0, 0.0, 0.0), q_ned_from_frd, armed=True, landed=False)


def problem(surface: OnSurface | None, q_ned_from_frd: Quat = LEVEL, after_s: float = 0.1) -> str:
    watcher = ContactWatcher(ROOM_M, PlanetConfig())
    watcher.begin(0, (0.0, 0.0))
    return watcher.update(int(after_s * NS_PER_S), surface, state_with(q_ned_from_frd))


def problem_of_slide(begin_m: float, end_m: float, duration_s: float, std_m: float = 0.0) -> str:
    """Problem at the end of an even motion towards the north."""
    watcher, found, steps = ContactWatcher(ROOM_M, PlanetConfig()), "", round(duration_s / 0.02)
    watcher.begin(0, (0.0, 0.0))
    for i in range(steps + 1):
        offset_m = begin_m + (end_m - begin_m) * i / steps
        found = watcher.update(i * 20_000_000, OnSurface((offset_m, 0.0), std_m), state_with())
    return found


@pytest.mark.parametrize(
    ("begin_m", "end_m", "slides"),
    [
        (0.12, 0.2, True),  # 0.2 m + 0.3 s · 0.4 m/s = 0.32 m, beyond 0.3 m
        (0.14, 0.2, False),  # 0.29 m
        (0.34, 0.4, True),  # 0.3 m/s
        (0.38, 0.4, False),  # 0.1 m/s is noise of the estimate
        (0.5, 0.4, False),  # comes back
    ],
)
def test_feet_that_are_about_to_leave_their_place_slide(begin_m: float, end_m: float, slides: bool) -> None:
    assert (problem_of_slide(begin_m, end_m, 0.2) == "slides") is slides


def test_a_motion_in_the_first_instant_of_contact_is_no_slide_yet() -> None:
    assert problem_of_slide(0.2, 0.28, 0.18) == ""
    assert problem_of_slide(0.2, 0.28, 0.2) == "slides"


def test_a_slide_is_measured_anew_after_a_time_without_measurements() -> None:
    watcher = ContactWatcher(ROOM_M, PlanetConfig())
    watcher.begin(0, (0.0, 0.0))
    assert watcher.update(0, OnSurface((0.0, 0.0)), state_with()) == ""
    assert watcher.update(NS_PER_S // 10, None, state_with()) == ""
    assert watcher.update(3 * NS_PER_S // 10, OnSurface((0.4, 0.0)), state_with()) == ""


def test_a_vehicle_that_has_stood_for_a_while_and_then_begins_to_slide_goes_around_before_it_leaves_its_place() -> None:
    """0.5 m/s outwards: 0.3 s later the vehicle would be 0.15 m farther on."""
    watcher, t_ns, offset_m = ContactWatcher(ROOM_M, PlanetConfig()), 0, 0.1
    watcher.begin(0, (0.0, 0.0))
    while watcher.update(t_ns, OnSurface((offset_m, 0.0)), state_with()) != "slides":
        t_ns += NS_PER_S // 50
        offset_m += 0.01 if t_ns > 3 * NS_PER_S else 0.0
        assert offset_m < ROOM_M


def test_an_uncertain_offset_counts_as_much_nearer_to_the_middle() -> None:
    assert problem_of_slide(0.17, 0.25, 0.2) == "slides"
    assert problem_of_slide(0.17, 0.25, 0.2, std_m=0.1) == ""


def test_the_feet_of_a_tilted_vehicle_are_beside_its_middle() -> None:
    """Rolled to the right by 30°, the feet are on the left: 0.148 m · sin 30°."""
    north_m, east_m = feet_from_uav_ned_m(state_with(rolled(30.0)), AirframeConfig(height_stand_m=0.148))
    assert (north_m, east_m) == pytest.approx((0.0, -0.074))


@pytest.mark.parametrize(("tilt_deg", "leans"), [(15.0, False), (30.0, True), (50.0, True), (90.0, False)])
def test_a_vehicle_leans_when_it_is_tilted_more_than_a_slope_tilts_it_but_can_still_climb(
    tilt_deg: float, leans: bool
) -> None:
    assert (problem(CENTRED, rolled(tilt_deg), after_s=0.5) == "leans") is leans


def test_a_short_tilt_is_the_way_to_four_feet() -> None:
    assert problem(CENTRED, rolled(30.0), after_s=0.3) == ""


def test_without_a_measured_place_only_the_tilt_counts() -> None:
    assert problem(None) == ""
    assert problem(None, rolled(30.0), after_s=0.5) == "leans"


def test_the_thrust_goes_down_only_after_the_touchdown_and_the_tilt_against_the_wind_with_it() -> None:
    watcher = ContactWatcher(ROOM_M, PlanetConfig())
    watcher.begin(0, (0.1, 0.0))
    assert watcher.push_acc_ned_mps2(0.4) == (0.0, 0.0, 0.0)
    north_mps2, east_mps2, down_mps2 = watcher.push_acc_ned_mps2(0.1)
    assert down_mps2 == 5.0
    assert north_mps2 == pytest.approx(0.8 * 9.81 * 0.1 / (1.0 - 0.01) ** 0.5)
    assert east_mps2 == 0.0


@pytest.mark.parametrize(("down_mps", "touched"), [(0.2, False), (0.1, True), (-0.3, True)])
def test_a_pushed_vehicle_has_touched_down_once_it_hardly_sinks_and_its_thrust_stays_down_when_it_bounces(
    down_mps: float, touched: bool
) -> None:
    watcher = ContactWatcher(ROOM_M, PlanetConfig())
    watcher.begin(0, (0.0, 0.0))
    assert (watcher.push_acc_ned_mps2(down_mps)[2] > 0.0) is touched
    assert (watcher.push_acc_ned_mps2(0.5)[2] > 0.0) is touched
    watcher.begin(NS_PER_S, (0.0, 0.0))
    assert watcher.push_acc_ned_mps2(0.5) == (0.0, 0.0, 0.0), "the next contact is another one"


def test_of_the_thrust_against_the_wind_four_fifths_are_cancelled_in_its_direction() -> None:
    """A vehicle that hovers with a tilt is pulled sideways by its weight times the tangent of the tilt."""
    north, east = 0.2, -0.3
    pull_mps2 = 9.81 / (1.0 - north**2 - east**2) ** 0.5
    assert level_acc_ned_mps2((north, east), PlanetConfig()) == pytest.approx(
        (0.8 * pull_mps2 * north, 0.8 * pull_mps2 * east)
    )


def test_of_the_thrust_against_a_storm_no_more_is_cancelled_than_the_autopilot_surely_makes() -> None:
    """What is too much would tip the vehicle over downwind."""
    assert level_acc_ned_mps2((0.3, -0.4), PlanetConfig()) == pytest.approx((2.4, -3.2))


def test_a_rolled_vehicle_has_one_side_of_its_feet_lower() -> None:
    airframe = AirframeConfig()
    _, right_m = airframe.feet_frd_m
    expected_m = right_m * sin(radians(10.0)) + airframe.height_stand_m * (cos(radians(10.0)) - 1.0)
    assert foot_drop_m(LEVEL, airframe) == pytest.approx(0.0)
    assert foot_drop_m(rolled(10.0), airframe) == pytest.approx(expected_m)


def test_a_pitched_vehicle_has_its_front_or_its_rear_lower_and_one_that_is_rolled_too_a_corner() -> None:
    airframe = AirframeConfig(height_stand_m=0.1, feet_frd_m=(0.2, 0.3))
    for pitch_rad in (0.1, -0.1):
        expected_m = 0.2 * sin(0.1) + 0.1 * (cos(0.1) - 1.0)
        assert foot_drop_m(quat_from_euler(0.0, pitch_rad, 0.0), airframe) == pytest.approx(expected_m)
        corner_m = 0.2 * sin(0.1) + cos(0.1) * (0.3 * sin(0.2) + 0.1 * cos(0.2)) - 0.1
        assert foot_drop_m(quat_from_euler(0.2, pitch_rad, 1.0), airframe) == pytest.approx(corner_m)


def test_a_landing_ends_after_the_last_go_around_and_names_the_slope_or_the_wind() -> None:
    go_arounds = GoArounds(1)
    leaning = state_with(rolled(degrees(0.3)))
    go_arounds.begin(0, "leans", leaning)
    assert not go_arounds.is_high(NS_PER_S, 1.0)
    assert go_arounds.is_high(NS_PER_S, 1.6)
    assert go_arounds.abort_reason(leaning) == ""
    go_arounds.begin(NS_PER_S, "leans", leaning)
    assert "tilted by 17 degrees on what it touched, in spite of 1 go-arounds" in go_arounds.abort_reason(leaning)
    go_arounds.begin(NS_PER_S, "slides", leaning)
    windy = msgspec.structs.replace(leaning, wind_ned_mps=(6.0, 8.0, 0.0), std_gust_mps=2.0)
    assert "the wind is 10.0 m/s with gusts to 12.0 m/s" in go_arounds.abort_reason(windy)
    go_arounds.begin(NS_PER_S, "below", leaning)
    assert "by the estimate the vehicle came below the platform's surface" in go_arounds.abort_reason(windy)
    go_arounds.begin(NS_PER_S, "slides", leaning)
    assert "the vehicle slid on what it touched" in go_arounds.abort_reason(windy), "the newest one counts"


@pytest.mark.parametrize(("off_m", "touched_down"), [(0.6, True), (0.8, False)])
def test_a_vehicle_that_rests_beside_the_platform_has_not_touched_down_on_it(off_m: float, touched_down: bool) -> None:
    """The platform reaches 0.7 m to each side."""
    at_rest = PlatformState((off_m, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    vehicle = msgspec.structs.replace(VehicleConfig(), platform=PlatformConfig(side_m=1.4))
    detector, found = TouchdownDetector(vehicle), []
    for step in range(200):
        found.append(detector.update(step * 20_000_000, at_rest, None))
    assert found[-1] is touched_down and not found[0]


@pytest.mark.parametrize(
    ("height_m", "std_height_m", "vel_ned_mps", "range_m", "touched_down"),
    [
        (0.0, 0.04, STILL, None, True),
        (0.0, 0.06, STILL, None, False),
        (0.08, 0.0, STILL, None, True),
        (0.12, 0.0, STILL, None, False),
        (0.0, 0.0, (0.1, -0.1, 0.15), None, True),
        (0.0, 0.0, (0.3, 0.0, 0.0), None, False),
        (0.0, 0.0, (0.0, -0.3, 0.0), None, False),
        (0.0, 0.0, (0.0, 0.0, 0.3), None, False),
        (0.0, 0.0, (0.0, 0.0, -0.3), None, False),
        (0.0, 0.0, STILL, 0.18, True),
        (0.0, 0.0, STILL, 0.22, False),
    ],
)
def test_a_vehicle_has_touched_down_when_it_is_surely_low_and_at_rest_and_the_altimeter_does_not_contradict(
    height_m: float, std_height_m: float, vel_ned_mps: Vec3, range_m: float | None, touched_down: bool
) -> None:
    """Two standard deviations above its height it must be below 0.1 m, and the altimeter measures at most 0.2 m."""
    platform = PlatformState((0.0, 0.0, -height_m), vel_ned_mps, STILL, 0.0, std_height_m=std_height_m)
    detector = TouchdownDetector(VehicleConfig())
    assert not detector.update(0, platform, range_m)
    assert not detector.update(28 * NS_PER_S // 10, platform, range_m)
    assert detector.update(32 * NS_PER_S // 10, platform, range_m) is touched_down


@pytest.mark.parametrize(
    ("sinks_mps", "height_m", "off_m", "range_m", "held"),
    [
        (0.0, 0.1, 0.0, None, True),
        (0.0, 0.4, 0.0, None, False),
        (0.0, 0.1, 0.4, None, True),
        (0.0, 0.1, 0.6, None, False),
        (0.0, 0.1, 0.0, 0.5, False),
        (0.5, 0.1, 0.0, None, False),
    ],
    ids=["held", "too high", "near the edge", "beside the platform", "the altimeter sees a gap", "it sinks"],
)
@pytest.mark.parametrize("below_takeoff_m", [0.0, 30.0, -30.0])
def test_a_heaving_deck_holds_a_vehicle_that_does_not_sink_though_it_is_pushed_down(
    below_takeoff_m: float, sinks_mps: float, height_m: float, off_m: float, range_m: float | None, held: bool
) -> None:
    """Its height and speed over the platform are too uncertain, as by UWB close to the anchors."""
    uncertain = PlatformState((0.0, -off_m, -height_m), (0.0, 0.0, 0.4), STILL, 0.0, std_height_m=0.3)
    detector, found = TouchdownDetector(VehicleConfig()), []
    for step in range(300):
        t_s = 0.02 * step
        down_m = below_takeoff_m + 0.25 * sin(1.25 * t_s) + sinks_mps * t_s
        found.append(detector.update(step * 20_000_000, uncertain, range_m, deck_motion(), down_m))
    assert any(found) is held
    assert not any(found[:180])


def test_a_vehicle_that_a_falling_deck_has_carried_down_is_held_once_the_deck_falls_no_more() -> None:
    """The deck falls by 1.5 m within 3 s; after that the vehicle must be pushed down for 4 s."""
    uncertain = PlatformState((0.0, 0.0, -0.1), (0.0, 0.0, 0.4), (0.0, 0.0, 0.0), 0.0, std_height_m=0.3)
    detector, held_s = TouchdownDetector(VehicleConfig()), []
    for step in range(400):
        t_s = 0.02 * step
        if detector.update(step * 20_000_000, uncertain, None, deck_motion(), min(0.5 * t_s, 1.5)):
            held_s.append(t_s)
    assert held_s and 3.0 < held_s[0] < 7.1


def test_a_vehicle_that_stood_tilted_in_the_wind_must_turn_upright_within_some_time() -> None:
    """The tilt of the wind, 20 degrees, counts less and less: with the same tilt it leans later than without wind."""

    def leans_after_s(free_down_ned: tuple[float, float]) -> float:
        watcher, begin_ns, passed_ns = ContactWatcher(ROOM_M, PlanetConfig()), 100 * NS_PER_S, 0
        watcher.begin(begin_ns, free_down_ned)
        while watcher.update(begin_ns + passed_ns, CENTRED, state_with(rolled(30.0))) != "leans":
            passed_ns += NS_PER_S // 50
            assert passed_ns < 5 * NS_PER_S
        return passed_ns / NS_PER_S

    blown, calm = leans_after_s((0.0, -sin(radians(30.0)))), leans_after_s((0.0, 0.0))
    assert calm == pytest.approx(0.4, abs=0.03)
    assert calm + 0.2 < blown < 1.3


@pytest.mark.parametrize("std_height_m", [0.0, 0.1])
@pytest.mark.parametrize(("margin_m", "below"), [(-0.01, False), (0.01, True)])
def test_a_vehicle_is_below_the_surface_by_more_than_a_fifth_of_a_metre_and_two_standard_deviations(
    std_height_m: float, margin_m: float, below: bool
) -> None:
    down_m = 0.2 + 2.0 * std_height_m + margin_m
    platform = PlatformState((0.0, 0.0, down_m), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, std_height_m=std_height_m)
    watcher = ContactWatcher(ROOM_M, PlanetConfig())
    watcher.begin(0, (0.0, 0.0))
    assert (watcher.update(0, CENTRED, state_with(), platform) == "below") is below


@pytest.mark.parametrize(("tilt_deg", "outcome"), [(0.0, "succeeded"), (25.0, "succeeded"), (35.0, "aborted")])
def test_a_vehicle_that_is_tilted_by_more_than_thirty_degrees_on_the_ground_has_fallen_over(
    tilt_deg: float, outcome: str
) -> None:
    done = landing_outcome(state_with(rolled(tilt_deg)))
    assert (done.outcome, done.then) == (outcome, "disarm")
    assert done.reason == ("" if outcome == "succeeded" else "the vehicle fell over: it is tilted by 35 degrees")


def test_a_go_around_ends_after_four_seconds_where_the_height_is_unknown() -> None:
    go_arounds = GoArounds(1)
    go_arounds.begin(0, "slides", state_with())
    assert not go_arounds.is_high(int(3.9 * NS_PER_S), None)
    assert go_arounds.is_high(int(4.1 * NS_PER_S), None)
    assert not go_arounds.climbing
