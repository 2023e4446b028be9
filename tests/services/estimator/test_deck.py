"""What shows that the platform heaves: its tilt by the rover's IMU, and its height by the tags."""

from math import cos, pi, sin

import numpy as np
import pytest

from jezero.base.vehicle_config import PlatformConfig
from jezero.services.estimator.config import Tuning, ValidityConfig
from jezero.services.estimator.deck import STILL_AFTER_NS, DeckMonitor
from jezero.services.estimator.measurements import (
    Measurement,
    OdometryMeasurement,
    RoverOdometryMeasurement,
    TagMeasurement,
)
from jezero.services.estimator.relative_filter import RelativeFilter
from tests.services.estimator.test_filter import MS, POS_ROVER_M

S = 1_000_000_000
NOISE = np.random.default_rng(1).normal(size=(2000, 3))


def watched(seconds: float, *, tilt_rad: float = 0.0, heave_m: float = 0.0, drift_mps: float = 0.0) -> DeckMonitor:
    """A monitor after some seconds of waves of 5 s, with the noise of IMU and tags."""
    deck = DeckMonitor()
    for step in range(int(seconds * 25)):
        t_s = step / 25
        wave = sin(2.0 * pi * t_s / 5.0)
        roll_noise, pitch_noise, height_noise = NOISE[step]
        deck.add_tilt(step * 40 * MS, tilt_rad * wave + 0.002 * roll_noise, 0.002 * pitch_noise)
        deck.add_height(step * 40 * MS, heave_m * wave + drift_mps * t_s + 0.02 * height_noise, 0.02)
    return deck


def test_a_deck_that_stands_still_does_not_move_by_noise_and_by_the_drift_of_the_autopilots_height() -> None:
    assert not watched(60.0).moves
    assert not watched(60.0, drift_mps=0.08).moves


@pytest.mark.parametrize("motion", [{"tilt_rad": 0.03}, {"heave_m": 0.2}])
def test_a_deck_moves_that_tilts_or_heaves(motion: dict[str, float]) -> None:
    assert watched(2.5, **motion).moves


def test_a_height_that_jumps_is_not_that_of_a_deck() -> None:
    deck = DeckMonitor()
    for step in range(50):
        deck.add_height(step * 40 * MS, 0.5 * (step > 25), 0.02)
        assert not deck.moves


@pytest.mark.parametrize(
    ("period_ms", "count", "moves"), [(40, 15, False), (400, 5, False), (40, 45, True), (100, 20, True)]
)
def test_few_heights_and_those_of_a_moment_say_nothing(period_ms: int, count: int, moves: bool) -> None:
    """The measured height grows by half a metre per second in each case."""
    deck = DeckMonitor()
    for step in range(count):
        deck.add_height(100 * S + step * period_ms * MS, -0.5e-3 * step * period_ms, 0.02)
    assert deck.moves is moves


@pytest.mark.parametrize(
    ("climb_mps", "std_m", "moves"),
    [(0.08, 0.005, False), (0.15, 0.005, True), (0.15, 0.1, False), (0.6, 0.1, True), (0.9, 0.2, False)],
)
def test_a_deck_moves_that_climbs_faster_than_a_tenth_of_a_metre_per_second_and_than_its_heights_are_uncertain(
    climb_mps: float, std_m: float, moves: bool
) -> None:
    """A standard deviation of 0.1 m of each of the 25 heights of a second is one of 0.07 m/s; heights of more than
    0.15 m count for nothing."""
    deck = DeckMonitor()
    for step in range(50):
        deck.add_height(step * 40 * MS, -climb_mps * 0.04 * step, std_m)
    assert deck.moves is moves


@pytest.mark.parametrize(
    ("tilt_rad", "period_s", "moves"), [(0.015, 1.0, False), (0.03, 1.0, True), (0.03, 9.0, False)]
)
def test_a_deck_moves_whose_tilt_changes_by_more_than_a_degree_within_two_seconds(
    tilt_rad: float, period_s: float, moves: bool
) -> None:
    """The tilt grows evenly by `tilt_rad` in `period_s`; a rover that drives onto a slope does so slowly."""
    for tilts_roll in (True, False):
        deck = DeckMonitor()
        for step in range(51):
            angle_rad = tilt_rad * min(step * 0.04 / period_s, 1.0)
            deck.add_tilt(step * 40 * MS, angle_rad if tilts_roll else 0.1, -0.2 if tilts_roll else angle_rad)
        assert deck.moves is moves


def test_it_counts_as_still_again_some_time_after_the_last_sign() -> None:
    deck = watched(3.0, tilt_rad=0.03)
    for ms in range(3000, 3000 + STILL_AFTER_NS // MS, 40):
        deck.add_tilt(ms * MS, 0.0, 0.0)
    assert deck.moves
    for ms in range(3000 + STILL_AFTER_NS // MS, 6000 + STILL_AFTER_NS // MS, 40):
        deck.add_tilt(ms * MS, 0.0, 0.0)
    assert not deck.moves


def test_a_new_epoch_whose_time_begins_anew_knows_nothing_of_the_last_one() -> None:
    deck = watched(10.0, tilt_rad=0.05)
    deck.restart()
    assert not deck.moves
    for step in range(100):
        deck.add_tilt(step * 40 * MS, 0.0, 0.0)
        assert not deck.moves


def test_a_deck_that_moves_again_is_observed_from_then_on() -> None:
    """What it did before the calm says nothing about the waves now."""
    deck = DeckMonitor()
    for step in range(840):
        t_s = step / 25
        calm = 10.0 < t_s < 32.0
        deck.add_tilt(step * 40 * MS, 0.0 if calm else 0.03 * sin(2.0 * pi * t_s / 2.0), 0.0)
        if not calm:
            deck.add_motion(step * 40 * MS, 0.1, 0.1)
        if step == 250:
            motion = deck.motion(0.0)
            assert motion is not None and motion.observed_s == pytest.approx(9.5, abs=0.5)
    motion = deck.motion(0.0)
    assert motion is not None and motion.observed_s == pytest.approx(1.0, abs=0.5)


def test_the_motion_of_a_deck_is_known_from_few_measurements_per_second_too() -> None:
    deck = watched(2.5, tilt_rad=0.05)
    for ms in range(2500, 4500, 200):
        deck.add_motion(ms * MS, 0.3, 0.1)
    motion = deck.motion(0.0)
    assert motion is not None
    assert motion.climb_significant_mps == pytest.approx(0.6)
    assert motion.observed_s == pytest.approx(1.8)


def test_its_motion_is_told_as_two_standard_deviations_and_the_newest_tilt_with_its_rates() -> None:
    deck = DeckMonitor()
    for step in range(1000):
        t_s = step / 25
        angle_rad = 2.0 * pi * t_s / 5.0
        deck.add_tilt(step * 40 * MS, 0.05 * sin(angle_rad), -0.02 * sin(angle_rad))
        deck.add_motion(step * 40 * MS, 0.4 * cos(angle_rad), 0.1)
        deck.add_motion(step * 40 * MS + 20 * MS, 9.0, 0.4)  # not known well enough to count
    motion = deck.motion(-0.3)
    assert motion is not None
    assert motion.acc_down_mps2 == -0.3
    assert motion.climb_significant_mps == pytest.approx(2.0 * 0.4 / 2.0**0.5, rel=0.02)
    assert motion.tilt_significant_rad == pytest.approx(2.0 * 0.05385 / 2.0**0.5, rel=0.02)
    assert motion.observed_s == pytest.approx(30.0, abs=0.2)
    angle_rad = 2.0 * pi * (999 / 25) / 5.0
    assert motion.roll_rad == pytest.approx(0.05 * sin(angle_rad))
    assert motion.roll_rate_rps == pytest.approx(0.05 * 2.0 * pi / 5.0 * cos(angle_rad - 0.18), abs=0.003)
    assert motion.pitch_rate_rps == pytest.approx(-0.4 * motion.roll_rate_rps)
    assert DeckMonitor().motion(0.0) is None


@pytest.mark.parametrize("tags", [True, False])
def test_the_motion_of_a_deck_is_observed_only_while_something_measures_its_height(tags: bool) -> None:
    """Else the filter's vertical speed of the deck is a guess, and a landing would wait for a calm that nobody sees."""
    relative = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig(), deck_moves=True)
    for ms in range(0, 1000, 20):
        rel_m = np.array((0.1, 0.0, -4.0))
        measurements: list[Measurement] = [
            OdometryMeasurement(ms * MS, np.concatenate((POS_ROVER_M + rel_m, np.zeros(3)))),
            RoverOdometryMeasurement(ms * MS, 0.0, 0.0, 0.0, 0.03, 0.03, 0.01, heaves=True),
        ]
        if tags:
            measurements.append(TagMeasurement(ms * MS, rel_m, rel_m, 1e-4 * np.eye(3), 0.0, None, 1.0))
        relative.add(measurements)
    assert (relative.deck.motion(0.0) is not None) is tags


def heaving_m(t_s: float) -> tuple[float, float]:
    """Height and vertical speed of a deck in two waves, positive down; the settings' period is a third one."""
    one_rps, other_rps = 2.0 * pi / 4.5, 2.0 * pi / 7.0
    return (
        0.2 * sin(one_rps * t_s) + 0.1 * sin(other_rps * t_s + 1.0),
        0.2 * one_rps * cos(one_rps * t_s) + 0.1 * other_rps * cos(other_rps * t_s + 1.0),
    )


@pytest.mark.parametrize("climb_mps", [0.0, 1.0, -0.5])
def test_a_vehicle_that_climbs_over_a_still_rover_moves_no_deck(climb_mps: float) -> None:
    relative = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig())
    for ms in range(0, 6000, 20):
        rel_m = np.array((0.1, 0.0, -4.0 - climb_mps * ms / 1000))
        vel_mps = np.array((0.0, 0.0, -climb_mps))
        relative.add([OdometryMeasurement(ms * MS, np.concatenate((POS_ROVER_M + rel_m, vel_mps)))])
        if ms % 60 == 0:
            relative.add([TagMeasurement(ms * MS, rel_m, rel_m, 1e-4 * np.eye(3), 0.0, None, 1.0)])
        assert not relative.deck.moves


@pytest.mark.parametrize("knows_tilt", [True, False], ids=["with the rover's IMU", "by the tags alone"])
def test_the_filter_follows_a_deck_that_heaves_and_nothing_contradicts_it(knows_tilt: bool) -> None:
    rng = np.random.default_rng(2)
    relative = RelativeFilter(Tuning(std_tag_scale=0.001), ValidityConfig(), PlatformConfig())
    errors = []
    for ms in range(0, 30_000, 20):
        t_ns, t_s = ms * MS, ms / 1000
        height_m, speed_mps = heaving_m(t_s)
        deck_m = POS_ROVER_M + np.array((0.0, 0.0, height_m))
        hover_m = POS_ROVER_M + np.array((0.1, 0.0, -3.0))
        measurements: list[Measurement] = [OdometryMeasurement(t_ns, np.concatenate((hover_m, np.zeros(3))))]
        if ms % 40 == 0:
            if knows_tilt:
                relative.deck.add_tilt(t_ns, 0.05 * sin(t_s), 0.0)
            measurements.append(
                RoverOdometryMeasurement(t_ns, 0.0, 0.0, 0.0, 0.03, 0.03, 0.01, heaves=relative.deck.moves)
            )
        if ms % 60 == 0:
            arm_m = hover_m - deck_m + rng.normal(0.0, 0.01, 3)
            measurements.append(TagMeasurement(t_ns, arm_m, arm_m, 1e-4 * np.eye(3), 0.0, None, 1.0))
        relative.add(measurements)
        estimate = relative.estimate
        assert estimate is not None and relative.consistency.left_out == ""
        if t_s > 8.0:
            acc_mps2 = (heaving_m(t_s + 0.01)[1] - heaving_m(t_s - 0.01)[1]) / 0.02
            errors.append(
                (
                    estimate.pos_rel_m[2] - (hover_m - deck_m)[2],
                    estimate.vel_rover_mps[2] - speed_mps,
                    estimate.acc_down_rover_mps2 - acc_mps2,
                )
            )
    std_m, std_mps, std_mps2 = np.std(np.array(errors), axis=0)
    assert std_m < 0.02
    assert std_mps < 0.1
    assert std_mps2 < 0.2
    motion = relative.deck.motion(0.0)
    assert motion is not None and motion.climb_significant_mps == pytest.approx(0.42, abs=0.08)
