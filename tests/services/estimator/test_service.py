"""The estimator on the bus: what it is told to use, when it says that it isn't to be used, and what can go wrong."""

import re
from collections.abc import Iterable
from math import hypot
from random import Random
from typing import Any

import msgspec
import pytest

from benchmarks.quality.estimator_flight import Arrival, Conditions
from jezero.base.frames import add, norm, subtract
from jezero.schemas import topics
from jezero.schemas.estimate import GetParameters, Lease, SetParameters
from jezero.schemas.rows import Topic
from jezero.schemas.state import Clock
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.config import EstimatorConfig, Tuning
from jezero.services.estimator.service import SPEC
from tests.services.estimator.rig import Rig

replace = msgspec.structs.replace
TAG_ONLY = EstimatorConfig(tuning=Tuning(use_uwb=False))
STEP_NED_M = (5.0, -3.0, 1.0)


def near(rig: Rig) -> tuple[float, float, float]:
    """Where the rover is, in the autopilot's frame, by the truth: half a metre is the autopilot's own error."""
    x, y, z = rig.flight.truth(0.0).rover.pos_ned_m
    return x, y, z


def test_nothing_that_only_the_simulator_knows_is_an_input() -> None:
    assert not {topics.TRUTH, topics.SCENE} & set(SPEC.inputs)


def test_with_all_inputs_the_rover_is_found_and_stays_found() -> None:
    rig = Rig()
    rig.until(rig.flight.end_s)
    settled = [r for r in rig.relatives if r.t_ns > 3 * NS_PER_S]
    assert all(r.valid for r in settled)
    assert max(rig.error_m(r) for r in settled) < 0.3
    assert rig.relative.inputs == ("odometry", "rover", "altimeter", "uwb", "tag")
    assert rig.error_m() < 0.03
    assert len(settled) == pytest.approx(50 * (rig.flight.end_s - 3.0), abs=3)
    rover = rig.rovers[-1]
    assert rover.valid
    assert hypot(*subtract(rover.pos_rover_ned_m, near(rig))) < 1.5


def test_a_turning_rover_is_followed() -> None:
    rig = Rig(Conditions(speed_mps=1.0, yaw_rate_rps=0.2))
    relative = rig.until(rig.flight.end_s - 0.1)
    assert rig.error_m() < 0.05
    truth = rig.flight.truth(relative.t_ns / NS_PER_S)
    assert relative.vel_rover_ned_mps == pytest.approx(truth.rover.vel_ned_mps, abs=0.1)
    assert relative.yaw_rover_rad == pytest.approx(truth.rover.yaw_rad, abs=0.03)
    assert relative.yaw_rate_rover_rps == pytest.approx(0.2, abs=0.02)


def test_before_anything_is_known_it_is_not_valid_and_says_why() -> None:
    def no_rover(arrival: Arrival) -> Iterable[Arrival]:
        return () if arrival[1] in (topics.ROVER_ODOMETRY, topics.ESTIMATE_TAG) else (arrival,)

    relative = Rig(tamper=no_rover).until(3.0)
    assert not relative.valid
    assert "has not been found yet by UWB and tag" in relative.reason
    assert "the rover's odometry is missing" in relative.reason


def test_a_landing_by_tag_alone_starts_from_a_rough_position_and_is_corrected() -> None:
    rig = Rig(seed=6)
    rig.until(1.0)
    wrong_ned_m = add(near(rig), (2.0, -1.5, 0.5))
    assert rig.lease(uwb=False, tag=True, pos_ned_m=wrong_ned_m).accepted
    seen = [r for r in rig.relatives if r.goal_id]
    assert not seen
    rig.until(1.2)
    prior = rig.relative
    assert (prior.use_uwb, prior.use_tag, prior.goal_id) == (False, True, "land-1")
    assert not prior.valid or rig.error_m(prior) < 0.3
    while rig.bus.t_ns < (rig.flight.end_s - 1.0) * NS_PER_S:
        rig.bus.run_for(1.0)
        rig.lease(uwb=False, tag=True, pos_ned_m=wrong_ned_m)
    assert rig.relative.valid
    assert "uwb" not in rig.relative.inputs
    assert rig.error_m() < 0.05


def test_a_lease_that_nobody_renews_reverts_after_three_seconds_and_leaves_nothing() -> None:
    rig = Rig()
    rig.until(2.0)
    reply = rig.lease(uwb=False, tag=True, pos_ned_m=(40.0, 40.0, 0.0))
    assert reply.until_t_ns == pytest.approx(5 * NS_PER_S, abs=NS_PER_S // 10)
    assert rig.until(4.9).goal_id == "land-1"
    relative = rig.until(6.0)
    assert (relative.goal_id, relative.use_uwb, relative.use_tag) == ("", True, True)
    assert relative.valid
    assert rig.error_m() < 0.2


def test_a_released_lease_ends_at_once() -> None:
    rig = Rig()
    rig.until(2.0)
    rig.lease(uwb=True, tag=False)
    assert not rig.until(2.2).use_tag
    rig.ask(topics.LEASE, Lease(goal_id="land-1", use_uwb=True, use_tag=False, release=True))
    relative = rig.until(2.5)
    assert (relative.goal_id, relative.use_tag) == ("", True)


def test_the_lease_can_be_read_with_the_prior_position_that_it_began_with() -> None:
    rig = Rig()
    rig.until(2.0)
    assert rig.ask(topics.GET_PARAMETERS, GetParameters()).lease is None
    rig.lease(uwb=False, tag=True, pos_ned_m=(1.0, 2.0, 0.0))
    rig.lease(uwb=True, tag=True)
    lease = Lease(goal_id="land-1", use_uwb=True, use_tag=True, pos_rover_ned_m=(1.0, 2.0, 0.0))
    assert rig.ask(topics.GET_PARAMETERS, GetParameters()).lease == lease
    rig.ask(topics.LEASE, Lease(goal_id="land-1", use_uwb=True, use_tag=False, release=True))
    assert rig.ask(topics.GET_PARAMETERS, GetParameters()).lease is None


def test_one_goal_at_a_time_holds_the_lease() -> None:
    rig = Rig()
    rig.until(2.0)
    rig.lease("first", uwb=True, tag=True)
    rejected = rig.lease("second", uwb=True, tag=False)
    assert not rejected.accepted
    assert "goal first holds the lease for" in rejected.reason
    nothing = rig.lease("first", uwb=False, tag=False)
    assert not nothing.accepted
    assert rig.until(2.5).goal_id == "first"


def test_a_restarted_estimator_is_told_again_by_the_renewal() -> None:
    rig = Rig()
    rig.until(4.0)
    rig.lease(uwb=True, tag=False)
    rig.bus.remove("estimator")
    rig.bus.run_for(0.5)
    rig.restart_estimator()
    assert rig.until(5.4).goal_id == ""
    rig.lease(uwb=True, tag=False)
    relative = rig.until(6.5)
    assert (relative.goal_id, relative.use_tag) == ("land-1", False)
    assert relative.valid
    assert rig.error_m() < 0.2


def test_parameters_are_read_and_set_while_running() -> None:
    rig = Rig()
    rig.until(2.0)
    before = rig.ask(topics.GET_PARAMETERS, GetParameters())
    assert before.version == 0
    assert before.parameters.std_uwb_m == rig.config.tuning.std_uwb_m
    changed = rig.ask(topics.SET_PARAMETERS, SetParameters(std_uwb_m=0.5, use_tag=False))
    assert changed.accepted
    assert (changed.version, changed.parameters.std_uwb_m, changed.parameters.use_tag) == (1, 0.5, False)
    relative = rig.until(4.0)
    assert (relative.parameters_version, relative.use_tag) == (1, False)
    assert "tag" not in relative.inputs
    assert rig.ask(topics.GET_PARAMETERS, GetParameters()).parameters == changed.parameters


def test_a_parameter_out_of_range_is_refused_with_the_range_and_nothing_changes() -> None:
    rig = Rig()
    rig.until(2.0)
    rejected = rig.ask(topics.SET_PARAMETERS, SetParameters(std_uwb_m=50.0, use_tag=False))
    assert not rejected.accepted
    assert "std_uwb_m = 50 is not within 0.001 to 10" in rejected.reason
    assert rig.ask(topics.GET_PARAMETERS, GetParameters()).version == 0
    assert rig.until(2.5).use_tag


def test_every_parameter_has_a_range() -> None:
    rig = Rig()
    rig.until(1.0)
    parameters = rig.ask(topics.GET_PARAMETERS, GetParameters()).parameters
    for name, value in msgspec.structs.asdict(parameters).items():
        if isinstance(value, float):
            too_large = msgspec.structs.replace(SetParameters(), **{name: 1e6})
            assert not rig.ask(topics.SET_PARAMETERS, too_large).accepted, name


def test_an_autopilot_that_moves_its_position_leaves_the_relative_one_and_moves_the_rover() -> None:
    def moved(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        if topic is topics.ODOMETRY and t_ns > 6 * NS_PER_S:
            pos = add(message.pos_uav_ned_m, STEP_NED_M)
            message = replace(message, pos_uav_ned_m=pos, reset_counter=1, reset_offset_ned_m=STEP_NED_M)
        yield t_ns, topic, message

    still, jumping = Rig(), Rig(tamper=moved)
    for rig in (still, jumping):
        rig.until(8.0)
    assert jumping.relative.valid
    for mine, theirs in zip(jumping.relatives, still.relatives, strict=True):
        assert mine.pos_uav_rel_rover_ned_m == pytest.approx(theirs.pos_uav_rel_rover_ned_m, abs=0.02)
    step_m = subtract(jumping.rovers[-1].pos_rover_ned_m, still.rovers[-1].pos_rover_ned_m)
    assert step_m == pytest.approx(STEP_NED_M, abs=0.02)
    assert jumping.rovers[-1].reset_offset_ned_m == STEP_NED_M


def test_a_rough_position_moves_with_the_autopilots_resets() -> None:
    def moved(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        if topic is topics.ODOMETRY and t_ns > 2 * NS_PER_S:
            pos = add(message.pos_uav_ned_m, STEP_NED_M)
            message = replace(message, pos_uav_ned_m=pos, reset_counter=1, reset_offset_ned_m=STEP_NED_M)
        if topic is not topics.ESTIMATE_TAG:
            yield t_ns, topic, message

    rig = Rig(tamper=moved)
    rig.until(1.0)
    prior_pos_rover_ned_m = add(near(rig), (1.0, 0.0, 0.0))
    rig.lease(uwb=False, tag=True, pos_ned_m=prior_pos_rover_ned_m)
    rig.until(1.5)
    before_m = rig.rovers[-1].pos_rover_ned_m
    assert before_m == pytest.approx(prior_pos_rover_ned_m, abs=0.3)
    rig.lease(uwb=False, tag=True, pos_ned_m=prior_pos_rover_ned_m)
    rig.until(3.0)
    assert subtract(rig.rovers[-1].pos_rover_ned_m, before_m) == pytest.approx(STEP_NED_M, abs=0.3)


def test_a_new_epoch_forgets_everything() -> None:
    def restarted(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        if topic is topics.CLOCK and t_ns >= 4 * NS_PER_S:
            message = Clock(t_ns=t_ns, epoch_id=2, wall_ns=t_ns)
        yield t_ns, topic, message

    rig = Rig(tamper=restarted)
    rig.until(3.9)
    rig.lease(uwb=True, tag=False)
    assert rig.relative.valid
    relative = rig.until(5.0)
    assert relative.epoch_id == 2
    assert (relative.valid, relative.goal_id, relative.reason) == (False, "", "no odometry of the vehicle")


def test_measurements_that_are_far_too_late_or_ahead_of_time_are_dropped_and_told() -> None:
    def shifted(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        if topic is topics.ESTIMATE_TAG:
            message = replace(message, t_ns=max(0, t_ns + (-600_000_000 if t_ns % 2 else 400_000_000)))
        yield t_ns, topic, message

    rig = Rig(tamper=shifted)
    rig.until(10.0)
    assert "tag" not in rig.relative.inputs
    assert rig.error_m() < 0.1


def test_messages_that_come_twice_or_out_of_order_change_nothing() -> None:
    def twice(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        yield arrival
        if topic not in (topics.CLOCK, topics.ODOMETRY):
            yield t_ns + 60_000_000, topic, message

    once, doubled = Rig(), Rig(tamper=twice)
    for rig in (once, doubled):
        rig.until(8.0)
    mine, theirs = doubled.relative, once.relative
    assert mine.pos_uav_rel_rover_ned_m == pytest.approx(theirs.pos_uav_rel_rover_ned_m, abs=2e-3)


def test_a_silent_odometry_makes_the_estimate_invalid() -> None:
    def ends(arrival: Arrival) -> Iterable[Arrival]:
        return () if arrival[1] is topics.ODOMETRY and arrival[0] > 5 * NS_PER_S else (arrival,)

    rig = Rig(tamper=ends)
    assert rig.until(5.0).valid
    relative = rig.until(6.0)
    assert (relative.valid, relative.reason) == (False, "no odometry of the vehicle")


def test_a_silent_uwb_is_coasted_through_for_five_seconds() -> None:
    def ends(arrival: Arrival) -> Iterable[Arrival]:
        return () if arrival[1] in (topics.UWB, topics.ESTIMATE_TAG) and arrival[0] > 4 * NS_PER_S else (arrival,)

    rig = Rig(tamper=ends)
    rig.until(8.5)
    assert rig.relative.valid
    assert rig.error_m() < 0.4
    assert rig.relative.fused_t_ns == pytest.approx(4 * NS_PER_S, abs=NS_PER_S // 10)
    relative = rig.until(9.5)
    assert not relative.valid
    assert "nothing measured by UWB and tag for" in relative.reason
    assert "check that three or more anchors are powered" in relative.reason


def test_a_position_that_is_not_known_well_enough_is_told_with_the_bound_and_what_to_check() -> None:
    shipped = EstimatorConfig()
    rig = Rig(config=replace(TAG_ONLY, validity=replace(shipped.validity, std_pos_max_m=1e-4)))
    reason = rig.until(8.0).reason
    assert "the rover's position is known to 0.0 m by tag, 0.0001 m are needed (std_pos_max_m)" in reason
    assert "the last measurement is 0.1 s old: check that the tags are in view and lit" in reason


def test_a_height_that_altimeter_and_estimate_contradict_is_named_with_both() -> None:
    """An altimeter whose window is dirty measures 0.3 m at any height."""

    def dirty(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        if topic is topics.ALTIMETER:
            message = replace(message, range_m=0.3)
        yield t_ns, topic, message

    relative = Rig(tamper=dirty).until(4.0)
    assert (relative.valid, relative.contradicted) == (False, True)
    assert "m above the platform, the altimeter 0.3 m above what is below: check the altimeter" in relative.reason


def test_a_lock_on_a_wrong_place_is_told_and_left() -> None:
    def elsewhere(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        if topic is topics.ESTIMATE_TAG and t_ns < 4 * NS_PER_S:
            message = replace(message, pos_uav_rel_rover_ned_m=add(message.pos_uav_rel_rover_ned_m, (2.0, 1.0, 0.5)))
        yield t_ns, topic, message

    rig = Rig(seed=6, config=TAG_ONLY, tamper=elsewhere)
    rig.until(rig.flight.end_s - 4.0)
    times_ns = [r.t_ns for r in rig.relatives if not r.valid and "contradict" in r.reason]
    wrong = [r for r in rig.relatives if r.valid and r.t_ns > 6 * NS_PER_S and rig.error_m(r) > 0.5]
    assert times_ns or not any(r.valid for r in rig.relatives if r.t_ns < 4 * NS_PER_S)
    assert not wrong
    assert rig.relative.valid


def test_after_half_a_second_in_which_the_tags_contradict_the_estimate_it_is_invalid_and_names_them() -> None:
    """A landing must not go on by a place that the only sensor denies."""

    def elsewhere(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        if topic is topics.ESTIMATE_TAG and t_ns > 6 * NS_PER_S:
            message = replace(message, pos_uav_rel_rover_ned_m=add(message.pos_uav_rel_rover_ned_m, (2.0, 1.0, 0.5)))
        yield t_ns, topic, message

    rig = Rig(config=TAG_ONLY, tamper=elsewhere)
    rig.until(6.6)
    step_ns = 6 * NS_PER_S
    assert all(r.valid for r in rig.relatives if step_ns - NS_PER_S < r.t_ns < step_ns + NS_PER_S // 5)
    later = [(r.valid, r.reason) for r in rig.relatives if r.t_ns > step_ns + NS_PER_S // 2]
    assert later and set(later) == {(False, "the estimate is contradicted by the tag")}


@pytest.mark.parametrize("seed", [2, 8])
def test_odometry_of_the_rover_that_is_garbage_leads_nobody_astray(seed: int) -> None:
    rng = Random(seed)

    def garbled(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        if topic is topics.ROVER_ODOMETRY and 3 * NS_PER_S < t_ns < 11 * NS_PER_S:
            yaw_rad, speed_mps = rng.uniform(-6.0, 6.0), rng.uniform(-100.0, 100.0)
            message = replace(message, yaw_rover_rad=yaw_rad, speed_rover_body_mps=speed_mps)
        yield t_ns, topic, message

    rig = Rig(seed=seed, tamper=garbled)
    rig.until(rig.flight.end_s)
    meanwhile = [r for r in rig.relatives if 3 * NS_PER_S < r.t_ns < 12 * NS_PER_S and r.valid]
    assert len(meanwhile) > 400
    assert max(rig.error_m(r) for r in meanwhile) < 0.3
    assert max(norm(r.vel_rover_ned_mps) for r in meanwhile) < 0.3
    assert rig.relative.valid


@pytest.mark.parametrize("sensor", [topics.UWB, topics.ESTIMATE_TAG])
def test_a_sensor_that_tells_the_same_again_and_again_leads_nobody_astray(sensor: Topic[Any]) -> None:
    first: list[Any] = []

    def stuck(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        if topic is sensor and 3 * NS_PER_S < t_ns < 11 * NS_PER_S:
            first.append(message)
            if topic is topics.UWB:
                ranges = zip(first[0].ranges, message.ranges, strict=False)
                message = replace(message, ranges=tuple(replace(old, t_ns=new.t_ns) for old, new in ranges))
            else:
                message = replace(first[0], t_ns=message.t_ns)
        yield t_ns, topic, message

    rig = Rig(seed=2, tamper=stuck)
    rig.until(rig.flight.end_s)
    meanwhile = [r for r in rig.relatives if 3 * NS_PER_S < r.t_ns < 12 * NS_PER_S]
    assert all(r.valid for r in meanwhile)
    assert max(rig.error_m(r) for r in meanwhile) < 0.1


def test_measurements_of_the_future_are_dropped_and_counted_in_the_health() -> None:
    def ahead(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        if topic is topics.ALTIMETER:
            message = replace(message, t_ns=message.t_ns + 10 * NS_PER_S)
        yield t_ns, topic, message

    rig, texts = Rig(tamper=ahead), list[str]()
    rig.bus.observe(
        lambda t_ns, topic, data: (
            texts.append(msgspec.json.decode(data)["text"]) if topic == topics.health_of("estimator").name else None
        )
    )
    rig.until(4.0)
    assert re.fullmatch(r".+; [1-9]\d* measurements dropped: too late, too early or impossible", texts[-1])
