"""What a map assumes about the errors of its flight, against flights in virtual time."""

import numpy as np
import pytest

from benchmarks.quality.covering import Covering
from jezero.mapping.alignment import std_way_m
from jezero.schemas.goals import AreaCoverageGoal

STEP_S = 0.1
GOAL = AreaCoverageGoal(polygon_ned_m=((1.0, -3.0), (7.0, -3.0), (7.0, 3.0), (1.0, 3.0)), z_ned_m=-5.0, overlap=0.65)


@pytest.mark.parametrize("seed", [0, 3])
def test_the_error_of_the_way_between_two_exposures_is_the_one_that_a_map_assumes(seed: int) -> None:
    flight = Covering(seed, rendered=False)
    flight.fly(GOAL)
    assert flight.mapping_ns is not None
    t_ns = np.arange(*flight.mapping_ns, STEP_S * 1e9)
    own, true = (
        np.array([np.interp(t_ns, [m.t_ns for m in track], [m.pos_uav_ned_m[axis] for m in track]) for axis in (0, 1)])
        for track in (flight.odometry, flight.truths)
    )
    error_m = own - true
    for since_s in (1.0, 2.0, 4.0):
        steps = round(since_s / STEP_S)
        rms_m = float(np.sqrt(np.mean((error_m[:, steps:] - error_m[:, :-steps]) ** 2)))
        assert 0.6 < rms_m / std_way_m(since_s) < 1.3
