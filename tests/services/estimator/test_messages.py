"""What the estimator does with each message, and what it publishes then."""

import msgspec
import pytest

from jezero.base.frames import add
from jezero.schemas import topics
from jezero.schemas.estimate import GetParameters, Lease, SetParameters
from jezero.schemas.state import Clock
from jezero.schemas.struct import Message
from jezero.services.estimator.config import EstimatorConfig, Tuning
from tests.services.estimator.rig import MS, POS_ROVER_NED_M, REL_M, Steps

replace = msgspec.structs.replace
DROPPED = "measurements dropped: too late, too early or impossible"


def sensors(steps: Steps) -> set[str]:
    """Sensors that were fused or rejected in the last step."""
    return {innovation.sensor for innovation in steps.innovations}


# -- what is dropped ---------------------------------------------------------------------------------------


def impossible(steps: Steps, t_ms: int) -> dict[str, Message]:
    """Messages of which nothing is used."""
    tag, uwb = steps.tag(t_ms), steps.uwb(t_ms)
    return {
        "late odometry": steps.odometry(t_ms - 500),
        "late tag": steps.tag(t_ms - 500),
        "late UWB": steps.uwb(t_ms - 500),
        "late altimeter": steps.altimeter(t_ms - 500, 4.0),
        "late rover": steps.rover(t_ms - 500),
        "early tag": steps.tag(t_ms + 100),
        "far altimeter": steps.altimeter(t_ms, 11.5),
        "fast rover": steps.rover(t_ms, speed_mps=20.0),
        "no covariance": replace(tag, cov_pos_ned_m2=(1e-4, 0.0, 0.0, -1e-4, 0.0, 1e-4)),
        "far UWB": replace(uwb, ranges=(replace(uwb.ranges[0], range_m=17.0),)),
    }


@pytest.mark.parametrize("name", list(impossible(Steps(), 1000)))
def test_each_measurement_that_can_not_be_used_is_dropped_and_counted_once(name: str) -> None:
    steps = Steps()
    steps.find_rover(200)
    assert steps.health.text == "the rover is found"
    steps.step(220, impossible(steps, 220)[name])
    assert not sensors(steps)
    assert steps.health.text == f"the rover is found; 1 {DROPPED}"
    steps.step(240, impossible(steps, 240)["late tag"])
    assert steps.health.text == f"the rover is found; 2 {DROPPED}"


def test_a_camera_that_shows_the_same_picture_all_the_time_is_dropped_and_counted_from_its_fourth_tag_on() -> None:
    steps = Steps()
    steps.find_rover(200)
    tag = steps.tag(220)
    for i in range(6):
        t_ms = 220 + 20 * i
        steps.step(t_ms, steps.odometry(t_ms), steps.rover(t_ms), replace(tag, t_ns=t_ms * MS))
        assert ("tag" in sensors(steps)) is (i < 3)
    assert steps.health.text == f"the rover is found; 3 {DROPPED}"


@pytest.mark.parametrize(("range_m", "possible"), [(16.0, True), (17.0, False)])
def test_a_range_up_to_a_tenth_longer_than_the_greatest_one_of_the_sensor_is_possible(
    range_m: float, possible: bool
) -> None:
    """UWB measures up to 15 m."""
    steps = Steps()
    steps.find_rover(200)
    uwb = steps.uwb(220)
    far = replace(uwb, ranges=tuple(replace(r, range_m=range_m) for r in uwb.ranges))
    steps.step(220, steps.odometry(220), steps.rover(220), far)
    assert steps.health.text == ("the rover is found" if possible else f"the rover is found; 4 {DROPPED}")


@pytest.mark.parametrize(("age_ms", "used"), [(50, True), (80, False)])
def test_a_tag_and_ranges_are_used_only_where_the_vehicles_attitude_of_their_time_is_known(
    age_ms: int, used: bool
) -> None:
    """To 60 ms from an odometry."""
    steps = Steps()
    steps.find_rover(200)
    late_ms = 200 + age_ms
    steps.step(late_ms, steps.tag(late_ms), steps.uwb(late_ms))
    assert sensors(steps) == ({"tag", "uwb"} if used else set())


def test_an_altimeter_without_a_reading_and_a_round_without_ranges_are_nothing() -> None:
    steps = Steps()
    steps.find_rover(200)
    steps.step(220, steps.altimeter(220, None), replace(steps.uwb(220), ranges=()))
    assert not sensors(steps)
    assert steps.health.text == "the rover is found"


def test_odometry_that_is_old_or_of_another_epoch_is_not_used() -> None:
    steps = Steps()
    steps.find_rover(200)
    for odometry in (steps.odometry(200), steps.odometry(190), steps.odometry(220, epoch_id=2)):
        steps.step(220, odometry)
        assert not sensors(steps)
    steps.step(220, steps.odometry(220))
    assert sensors(steps) == {"autopilot_position", "autopilot_velocity"}


@pytest.mark.parametrize(
    ("yaw_rad", "std_yaw_rad", "used"), [(0.1, 0.02, True), (None, None, False), (0.1, None, False)]
)
def test_the_heading_by_the_tags_is_used_where_it_comes_with_its_standard_deviation(
    yaw_rad: float | None, std_yaw_rad: float | None, used: bool
) -> None:
    steps = Steps()
    steps.find_rover(200)
    steps.step(220, steps.tag(220, yaw_rad, std_yaw_rad))
    assert sensors(steps) == ({"tag", "tag_yaw"} if used else {"tag"})
    noises = [float(i.cov_noise[0, 0]) for i in steps.innovations if i.sensor == "tag_yaw"]
    assert noises == ([pytest.approx(0.02**2)] if used else [])


@pytest.mark.parametrize(("ahead_m", "used"), [(0.1, True), (0.6, False), (-0.6, False)])
def test_the_altimeter_is_used_over_the_platform_and_not_beside_it(ahead_m: float, used: bool) -> None:
    """The platform is 1 m wide."""
    steps = Steps(rel_m=(ahead_m, 0.0, -1.0))
    steps.find_rover(300)
    lens_m = 1.0 + steps.vehicle.airframe.height_stand_m - steps.vehicle.altimeter.pos_altimeter_frd_m[2]
    steps.step(320, steps.odometry(320), steps.altimeter(320, lens_m))
    residuals_m = [float(i.residual[0]) for i in steps.innovations if i.sensor == "altimeter"]
    assert residuals_m == ([pytest.approx(0.0, abs=0.03)] if used else [])


def test_each_range_of_a_round_counts_at_its_own_time() -> None:
    """A vehicle with 5 m/s flies 15 cm during the round."""
    steps = Steps(rel_m=(-4.0, 0.5, -3.0), vel_mps=(5.0, 0.0, 0.0))
    steps.find_rover(600, start_ms=300, uwb=False)
    steps.step(620, steps.odometry(620), steps.tag(620), steps.uwb(620))
    (innovation,) = [i for i in steps.innovations if i.sensor == "uwb"]
    assert innovation.residual == pytest.approx(innovation.residual.mean(), abs=0.02)


def test_a_vehicle_that_rolls_makes_a_tag_of_an_uncertain_time_uncertain_to_the_side() -> None:
    """At 0.5 rad/s and 4.1 m above the platform, 0.05 s are 10 cm."""
    steps = Steps(EstimatorConfig(std_time_s=0.05))
    steps.find_rover(200)
    steps.step(220, steps.odometry(220, rates_rps=(0.5, 0.0, 0.0)), steps.tag(220))
    (noise_m2,) = [i.cov_noise for i in steps.innovations if i.sensor == "tag"]
    assert noise_m2[1, 1] - noise_m2[0, 0] == pytest.approx(0.1**2, rel=0.2)


# -- what is published -------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [50, 25])
def test_the_estimate_is_published_with_the_rate_of_the_parameter(rate_hz: int) -> None:
    steps = Steps(EstimatorConfig(tuning=Tuning(rate_relative_hz=rate_hz)))
    for t_ms in range(1000, 2000, 20):
        steps.step(t_ms, steps.odometry(t_ms))
    assert len(steps.relatives) == rate_hz


def test_the_rovers_position_is_published_with_10_hz() -> None:
    steps = Steps()
    for t_ms in range(1000, 2000, 20):
        steps.step(t_ms, steps.odometry(t_ms))
    assert [rover.t_ns for rover in steps.rovers] == [t_ms * MS for t_ms in range(1000, 2000, 100)]


def test_without_odometry_an_invalid_estimate_is_published_with_10_hz() -> None:
    steps = Steps()
    steps.find_rover(200)
    begun = len(steps.relatives)
    for t_ms in range(300, 1300, 10):
        steps.step(t_ms)
    assert len(steps.relatives) - begun == pytest.approx(10, abs=1)
    assert (steps.relative.valid, steps.relative.reason) == (False, "no odometry of the vehicle")


def test_without_a_clock_nothing_is_published_and_the_health_waits_for_it_and_then_for_odometry() -> None:
    steps = Steps(clock=False)
    steps.step(1000)
    assert not steps.relatives
    assert (steps.health.state, steps.health.text) == ("degraded", "waiting for the vehicle's clock")
    steps.step(1100, Clock(t_ns=1100 * MS, epoch_id=1, wall_ns=0))
    assert (steps.health.state, steps.health.text) == ("degraded", "waiting for odometry")
    assert (steps.relative.t_ns, steps.relative.valid) == (1100 * MS, False)
    steps.find_rover(1200, start_ms=1120)
    assert (steps.health.state, steps.health.text) == ("ok", "the rover is found")


def test_before_the_rover_is_found_there_is_no_position_of_it() -> None:
    steps = Steps()
    steps.find_rover(200, uwb=False, tag=False)
    relative, rover = steps.relative, steps.rovers[-1]
    assert (relative.pos_uav_rel_rover_ned_m, relative.vel_uav_rel_rover_ned_mps) == ((0.0, 0.0, 0.0),) * 2
    assert relative.cov[0] == pytest.approx(1e10) and relative.fused_t_ns == 0
    assert (rover.pos_rover_ned_m, rover.valid) == ((0.0, 0.0, 0.0), False) and rover.std_pos_m > 100.0
    steps.find_rover(400, start_ms=220)
    assert steps.relative.pos_uav_rel_rover_ned_m == pytest.approx(REL_M, abs=0.02)
    assert steps.relative.cov[0] < 0.01 and steps.rovers[-1].std_pos_m < 0.1
    assert steps.rovers[-1].pos_rover_ned_m == pytest.approx(POS_ROVER_NED_M, abs=0.02)


def test_the_rovers_position_is_that_of_its_time_when_its_own_odometry_is_newer_than_the_vehicles() -> None:
    """At 10 m/s, 40 ms are 0.4 m."""
    steps = Steps()
    steps.find_rover(200)
    for t_ms in range(220, 420, 20):
        pos_m = add(add(POS_ROVER_NED_M, REL_M), (0.01 * (t_ms - 200), 0.0, 0.0))
        odometry = replace(steps.odometry(t_ms), pos_uav_ned_m=pos_m, vel_uav_ned_mps=(10.0, 0.0, 0.0))
        steps.step(t_ms, odometry, steps.rover(t_ms + 40))
    rover = steps.rovers[-1]
    assert rover.t_ns == 440 * MS
    assert rover.pos_rover_ned_m == pytest.approx(POS_ROVER_NED_M, abs=0.2)


# -- why the estimate is invalid ---------------------------------------------------------------------------


@pytest.mark.parametrize(("silent_ms", "valid"), [(280, True), (320, False)])
def test_the_estimate_is_valid_up_to_0_3_s_after_the_newest_odometry(silent_ms: int, valid: bool) -> None:
    steps = Steps()
    steps.find_rover(200)
    steps.step(200 + silent_ms, steps.tag(200 + silent_ms))
    assert steps.relative.valid is valid
    assert steps.relative.reason == ("" if valid else "no odometry of the vehicle")


UWB_ADVICE, TAG_ADVICE = "three or more anchors are powered and within their range", "the tags are in view and lit"


@pytest.mark.parametrize(
    ("uwb", "tag", "selected", "advice"),
    [
        (True, False, "UWB", UWB_ADVICE),
        (False, True, "tag", TAG_ADVICE),
        (True, True, "UWB and tag", f"{UWB_ADVICE} and that {TAG_ADVICE}"),
    ],
)
def test_five_seconds_after_the_last_range_and_tag_the_estimate_is_invalid_and_says_what_to_check(
    uwb: bool, tag: bool, selected: str, advice: str
) -> None:
    steps = Steps(EstimatorConfig(tuning=Tuning(use_uwb=uwb, use_tag=tag, std_vel_uav_mps=0.001)))
    steps.find_rover(1000, start_ms=700, uwb=uwb, tag=tag)
    for t_ms in range(1150, 6701, 300):
        steps.step(t_ms, steps.odometry(t_ms), steps.rover(t_ms))
        assert steps.relative.valid is (t_ms < 6000)
    assert steps.relative.reason == f"nothing measured by {selected} for 6 s: check that {advice}"


@pytest.mark.parametrize(
    ("uwb", "tag", "reason"),
    [
        (False, False, "neither UWB nor tag is selected"),
        (True, False, "the rover has not been found yet by UWB"),
        (False, True, "the rover has not been found yet by tag"),
        (True, True, "the rover has not been found yet by UWB and tag"),
    ],
)
def test_a_rover_that_is_not_found_is_told_with_the_inputs_that_should_find_it(
    uwb: bool, tag: bool, reason: str
) -> None:
    steps = Steps(EstimatorConfig(tuning=Tuning(use_uwb=uwb, use_tag=tag)))
    steps.find_rover(200, uwb=False, tag=False)
    assert (steps.relative.valid, steps.relative.reason, steps.relative.contradicted) == (False, reason, False)


def test_a_rover_without_odometry_is_told_to_be_missing() -> None:
    steps = Steps()
    steps.step(20, steps.odometry(20))
    assert steps.relative.reason == "the rover has not been found yet by UWB and tag; the rover's odometry is missing"


def test_a_position_from_a_parameter_alone_is_not_valid() -> None:
    """It is known well enough, but nothing has measured it."""
    steps = Steps()
    request = SetParameters(pos_rover_ned_m=POS_ROVER_NED_M, std_rover_m=0.1)
    assert steps.ask(0, topics.SET_PARAMETERS, request).accepted
    steps.find_rover(200, uwb=False, tag=False)
    assert (steps.relative.valid, steps.relative.reason) == (False, "nothing measured by UWB and tag yet")
    assert steps.relative.pos_uav_rel_rover_ned_m == pytest.approx(REL_M, abs=0.05)


@pytest.mark.parametrize("name", ["UWB", "the tag"])
def test_an_invalid_estimate_names_the_input_that_arrives_late_where_it_is_selected(name: str) -> None:
    for selected in (True, False):
        tuning = Tuning(use_uwb=(name == "UWB") is selected, use_tag=(name == "the tag") is selected)
        steps = Steps(EstimatorConfig(tuning=tuning))
        for t_ms in range(600, 700, 20):
            late: list[Message] = [steps.uwb(t_ms - 500) if name == "UWB" else steps.tag(t_ms - 500)]
            steps.step(t_ms, steps.odometry(t_ms), steps.rover(t_ms), *late)
        assert not steps.relative.valid
        assert steps.relative.reason.startswith(f"measurements by {name} arrive 0.5") is selected


# -- selections --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "after", "restarts"),
    [
        ((True, True), (True, True), False),
        ((True, True), (True, False), True),
        ((True, True), (False, True), True),
        ((True, False), (True, True), False),
        ((False, True), (True, True), False),
        ((True, False), (False, True), True),
    ],
)
def test_the_filter_starts_again_where_an_input_is_left_out_and_goes_on_where_one_is_added(
    before: tuple[bool, bool], after: tuple[bool, bool], restarts: bool
) -> None:
    """An input that is left out may have led the filter astray."""
    steps = Steps(EstimatorConfig(tuning=Tuning(use_uwb=before[0], use_tag=before[1])))
    steps.find_rover(1000, start_ms=700)
    assert steps.relative.valid
    steps.ask(1010, topics.SET_PARAMETERS, SetParameters(use_uwb=after[0], use_tag=after[1]))
    steps.find_rover(1020, start_ms=1020, uwb=False, tag=False)
    assert steps.relative.valid is not restarts
    assert (steps.relative.use_uwb, steps.relative.use_tag) == after


@pytest.mark.parametrize(
    ("request_", "restarts"),
    [
        (SetParameters(std_uwb_m=0.05, rate_relative_hz=40.0), False),
        (SetParameters(pos_rover_ned_m=POS_ROVER_NED_M), True),
        (SetParameters(pos_rover_ned_m=POS_ROVER_NED_M, std_rover_m=50.0), True),
    ],
)
def test_a_position_of_the_rover_starts_the_filter_again_and_another_parameter_does_not(
    request_: SetParameters, restarts: bool
) -> None:
    steps = Steps()
    steps.find_rover(1000, start_ms=700)
    assert steps.ask(1010, topics.SET_PARAMETERS, request_).accepted
    steps.find_rover(1020, start_ms=1020, uwb=False, tag=False)
    assert steps.relative.valid is not restarts
    steps.find_rover(1200, start_ms=1040)
    assert steps.relative.valid
    steps.ask(1210, topics.SET_PARAMETERS, request_)  # the same position again begins again, too
    steps.find_rover(1220, start_ms=1220, uwb=False, tag=False)
    assert steps.relative.valid is not restarts


def test_a_refused_position_of_the_rover_leaves_the_estimate() -> None:
    steps = Steps()
    steps.find_rover(1000, start_ms=700)
    request = SetParameters(pos_rover_ned_m=POS_ROVER_NED_M, std_uwb_m=50.0)
    assert not steps.ask(1010, topics.SET_PARAMETERS, request).accepted
    steps.find_rover(1020, start_ms=1020, uwb=False, tag=False)
    assert steps.relative.valid


def with_uwb_left_out() -> Steps:
    """An estimator that leaves UWB out: for 1.5 s all its ranges were 1 m too long, and the tags were right."""
    steps = Steps()
    steps.find_rover(200)
    for t_ms in range(250, 1750, 50):
        steps.step(t_ms, steps.odometry(t_ms), steps.rover(t_ms), steps.tag(t_ms), steps.uwb(t_ms, longer_m=1.0))
    return steps


def test_an_input_that_is_left_out_degrades_the_health_until_another_goal_uses_it_again() -> None:
    steps = with_uwb_left_out()
    assert steps.relative.valid and "uwb" not in steps.relative.inputs
    assert steps.health.state == "degraded"
    assert steps.health.text.startswith("UWB is left out, as it contradicts the tag: check the order")
    assert steps.ask(1760, topics.LEASE, Lease(goal_id="land-1", use_uwb=True, use_tag=True)).accepted
    steps.find_rover(1820, start_ms=1780)
    assert (steps.health.state, steps.health.text) == ("ok", "the rover is found")
    assert "uwb" in steps.relative.inputs


@pytest.mark.parametrize(("uwb", "contradicted"), [(True, True), (False, False)])
def test_an_estimate_that_is_invalid_while_an_input_is_left_out_is_contradicted_where_that_input_is_selected(
    uwb: bool, contradicted: bool
) -> None:
    """A better view of the rover helps only where no selected input contradicts the others."""
    steps = with_uwb_left_out()
    assert not steps.relative.contradicted
    steps.ask(1760, topics.SET_PARAMETERS, SetParameters(use_uwb=uwb, pos_rover_ned_m=POS_ROVER_NED_M))
    steps.step(1780, steps.odometry(1780), steps.rover(1780))
    assert not steps.relative.valid
    assert steps.relative.reason.startswith("UWB is left out, as it contradicts the tag: check the order")
    assert steps.relative.contradicted is contradicted


def test_a_new_epoch_ends_the_lease_and_drops_what_the_former_epoch_measured() -> None:
    steps = Steps()
    steps.find_rover(400)
    assert steps.ask(410, topics.LEASE, Lease(goal_id="land-1", use_uwb=True, use_tag=True)).accepted
    steps.step(510, Clock(t_ns=510 * MS, epoch_id=2, wall_ns=0))
    assert (steps.relative.epoch_id, steps.relative.goal_id) == (2, "")
    assert steps.ask(520, topics.GET_PARAMETERS, GetParameters()).lease is None
    steps.step(540, steps.odometry(540, epoch_id=2), steps.tag(500))
    assert not steps.relative.valid and "tag" not in sensors(steps)
    for t_ms in (560, 580):
        steps.step(t_ms, steps.odometry(t_ms, epoch_id=2), steps.rover(t_ms), steps.tag(t_ms - 10))
    assert (steps.relative.reason, steps.relative.fused_t_ns) == ("", 570 * MS)


def test_the_same_clock_again_changes_nothing() -> None:
    steps = Steps()
    steps.find_rover(200)
    steps.step(210, Clock(t_ns=210 * MS, epoch_id=1, wall_ns=0))
    steps.find_rover(220, start_ms=220, uwb=False, tag=False)
    assert steps.relative.valid


def test_a_tag_of_a_new_epoch_that_comes_before_the_odometry_of_this_epoch_is_not_used() -> None:
    steps = Steps()
    steps.find_rover(400)
    steps.step(410, Clock(t_ns=410 * MS, epoch_id=2, wall_ns=0))
    steps.step(510, steps.tag(420))
    assert (steps.relative.valid, steps.relative.reason) == (False, "no odometry of the vehicle")
    steps.step(530, steps.odometry(530, epoch_id=2))
    assert steps.relative.reason == "the rover has not been found yet by UWB and tag; the rover's odometry is missing"


@pytest.mark.parametrize(("silent_ms", "named"), [(800, True), (1200, False)])
def test_an_input_is_named_for_a_second_after_its_last_fused_measurement(silent_ms: int, named: bool) -> None:
    steps = Steps()
    steps.find_rover(1500, start_ms=1300)
    steps.find_rover(1700, start_ms=1520, tag=False)
    t_ms = 1500 + silent_ms
    steps.step(t_ms, steps.odometry(t_ms), steps.rover(t_ms), steps.uwb(t_ms))
    assert steps.relative.inputs == ("odometry", "rover", "uwb", *(["tag"] if named else []))
    assert steps.relative.fused_t_ns == (t_ms - 15) * MS  # the middle of the round
