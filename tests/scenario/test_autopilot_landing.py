"""The autopilot touches down in 3 m/s wind with gusts of 0.6 m/s: upright, and disarmed within seconds."""

from math import degrees

import pytest

from benchmarks.quality.autopilot import CLIMB_S, HEIGHT_M, READY_S, Target, fly
from jezero.base.frames import horizontal, tilt_from_quat

DOWN_S = READY_S + CLIMB_S
DISARM_S = 2.0


@pytest.mark.long
@pytest.mark.parametrize(("seed", "down_mps"), [(1, 0.7), (2, 0.5), (3, 0.3)])
def test_the_vehicle_lands_upright_in_wind_and_stops_its_motors(seed: int, down_mps: float) -> None:
    def target(t_s: float) -> Target:
        return ((0.0, 0.0, -HEIGHT_M), None) if t_s < DOWN_S else (None, (0.0, 0.0, down_mps))

    flight = fly(target, seed, DOWN_S + HEIGHT_M / down_mps + 8.0)
    descent = [t for t in flight.truth if t.t_ns > DOWN_S * 1e9]
    touched = next(i for i, t in enumerate(descent) if t.contact_force_n > 0.0)
    before, after = descent[touched - 1], descent[touched:]
    assert before.vel_uav_ned_mps[2] == pytest.approx(down_mps, abs=0.15)
    assert horizontal(before.vel_uav_ned_mps) < 0.2
    assert all(t.armed_motors for t in descent[:touched])
    off = next(t for t in after if not t.armed_motors)
    assert (off.t_ns - before.t_ns) * 1e-9 < 2.0 + DISARM_S
    assert max(degrees(tilt_from_quat(t.q_ned_from_frd)) for t in after) < 15.0
    assert degrees(tilt_from_quat(after[-1].q_ned_from_frd)) < 3.0
    assert not after[-1].armed_motors
