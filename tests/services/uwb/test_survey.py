"""The places of the anchors are found from noisy ranges, and what can't be known is said."""

import random
from math import dist
from statistics import median

import pytest

from jezero.base.frames import Vec3
from jezero.services.uwb.statistics import statistics_of
from jezero.services.uwb.survey import Sighting, locate

TRUTH: dict[int, Vec3] = {0: (0.52, 0.41, 0.03), 1: (0.45, -0.5, -0.02), 2: (-0.4, -0.45, 0.0), 3: (-0.5, 0.38, 0.1)}
START: dict[int, Vec3] = {0: (0.45, 0.45, 0.0), 1: (0.45, -0.45, 0.0), 2: (-0.45, -0.45, 0.0), 3: (-0.45, 0.45, 0.0)}
PLACES: tuple[Vec3, ...] = (
    (1.5, 0.0, 0.3), (0.0, 1.5, 0.3), (-1.5, 0.0, 0.3), (0.0, -1.5, 0.3),
    (1.0, 1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, -1.0), (1.0, -1.0, -1.0),
)  # fmt: skip
STD_M = 0.1


def measured(a: Vec3, b: Vec3, rng: random.Random, count: int = 200) -> float:
    return median(dist(a, b) + rng.gauss(0.0, STD_M) for _ in range(count))


@pytest.mark.parametrize("seed", range(10))
def test_anchors_are_found_within_5_cm_from_ranges_with_a_standard_deviation_of_10_cm(seed: int) -> None:
    rng = random.Random(seed)
    sightings = [Sighting(place, {a: measured(place, at, rng) for a, at in TRUTH.items()}) for place in PLACES]
    located = locate(sightings, START)
    for anchor, found in located.anchors.items():
        assert dist(found.pos_rover_body_m, TRUTH[anchor]) < 0.05
        assert max(found.std_m) < 0.05


@pytest.mark.parametrize("seed", range(10))
def test_ranges_between_the_anchors_find_those_that_were_not_measured_by_hand(seed: int) -> None:
    rng = random.Random(seed)
    truth: dict[int, Vec3] = {
        0: (0.5, 0.5, 0.0),
        1: (0.5, -0.5, 0.0),
        2: (-0.5, -0.5, 0.6),
        3: (-0.5, 0.5, 0.0),
        4: (0.0, 0.0, -1.2),
    }
    known = {anchor: truth[anchor] for anchor in (0, 1, 2, 3)}
    between = {(a, b): measured(truth[a], truth[b], rng, 1000) for a in truth for b in truth if a < b}
    located = locate([], {**known, 4: (0.2, 0.1, -0.8)}, between, known)
    assert set(located.anchors) == {4}
    assert dist(located.anchors[4].pos_rover_body_m, truth[4]) < 0.05


def test_places_of_the_tag_in_one_plane_leave_the_anchors_height_over_it_uncertain() -> None:
    flat: list[Vec3] = [(x, y, 0.0) for x, y, _ in PLACES]
    sightings = [Sighting(place, {a: dist(place, at) for a, at in START.items()}) for place in flat]
    assert all(found.std_m[2] > 1.0 for found in locate(sightings, START).anchors.values())


def test_an_anchor_on_the_other_side_of_the_tags_plane_is_found_by_a_place_outside_of_it() -> None:
    truth: Vec3 = (0.4, 0.3, 0.8)
    places: list[Vec3] = [*((x, y, 0.0) for x, y, _ in PLACES), (0.0, 0.0, -0.7)]
    sightings = [Sighting(place, {0: dist(place, truth)}) for place in places]
    found = locate(sightings, {0: (0.4, 0.3, -0.6)}).anchors[0]
    assert found.pos_rover_body_m == pytest.approx(truth, abs=1e-3)


def test_the_statistics_of_an_anchor_leave_outliers_out_of_the_spread() -> None:
    rng = random.Random(1)
    ranges = [3.0 + rng.gauss(0.0, 0.02) for _ in range(1000)] + [5.0] * 10
    found = statistics_of(ranges, 50_500_000_000)
    assert found.outliers == 10
    assert found.rate_hz == pytest.approx(20.0)
    assert found.median_m == pytest.approx(3.0, abs=0.005)
    assert found.std_m == pytest.approx(0.02, rel=0.1)
