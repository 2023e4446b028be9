"""Setpoints: which are accepted, and how they are streamed."""

from typing import Any

import pytest

from jezero.runtime.service import Health
from jezero.schemas.commands import Phase, Setpoint
from jezero.schemas.topics import SETPOINT
from tests.services.vehicle_bridge.rig import MODES, Rig

ZERO = (0.0, 0.0, 0.0)
SOMERSAULT: Any = "somersault"
"""A phase that no version of the bridge knows; only a newer schema could carry it."""


def test_setpoints_stream_before_offboard_mode_is_commanded() -> None:
    rig = Rig().ready()
    control_id = rig.acquire().control_id
    rig.run_until(
        lambda: rig.autopilot.mode == MODES["OFFBOARD"], lambda: rig.setpoint(control_id, Phase.TAKEOFF), limit_s=1.0
    )
    assert len(rig.autopilot.setpoints) >= 10


def test_a_setpoint_of_a_phase_that_the_bridge_does_not_know_is_dropped() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    unknown = Setpoint(t_ns=rig.t_ns, control_id=control_id, sequence=99, phase=SOMERSAULT, pos_ned_m=(9.0, 0.0, -2.0))
    rig.box.put(SETPOINT, unknown)
    rig.run(0.1)
    assert rig.status.code == 4
    assert all(s.x == 0.0 for s in rig.autopilot.setpoints)


def test_the_last_setpoint_is_repeated_at_ten_hertz_while_it_is_fresh() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=(1.0, 0.0, -2.0))
    rig.step()
    rig.autopilot.setpoints.clear()
    rig.run(0.28)
    assert len(rig.autopilot.setpoints) >= 3
    assert all(s.x == 1.0 for s in rig.autopilot.setpoints)


def test_foreign_repeated_out_of_order_and_empty_setpoints_are_dropped() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    bad: tuple[dict[str, Any], ...] = (
        {"control_id": "b0-99"},
        {"sequence": rig.sequence},
        {"sequence": rig.sequence - 1},
        {"pos_ned_m": None},
        {"pos_ned_m": (float("nan"), 0.0, 0.0)},
        {"yaw_rad": float("inf")},
        {"reset_counter": 3},
        {"phase": Phase.LANDING},
        {"phase": Phase.TAKEOFF},
    )
    for fields in bad:
        given: dict[str, Any] = {
            "control_id": control_id,
            "phase": Phase.GO_TO,
            "sequence": rig.sequence + 100,
            **fields,
        }
        if "pos_ned_m" not in given:
            given["pos_ned_m"] = (9.0, 9.0, -9.0)
        rig.setpoint(**given)
    rig.run(0.1)
    assert all(s.x == 0.0 for s in rig.autopilot.setpoints)
    assert rig.status.code == 4
    health = [output.text for output in rig.outputs if isinstance(output, Health)][-1]
    assert f"; {len(bad)} setpoints dropped, the last: " in health


def test_go_to_without_its_takeoff_phase_is_dropped_on_the_ground() -> None:
    rig = Rig().ready()
    control_id = rig.acquire("go_to", do_takeoff=True).control_id
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.GO_TO))
    assert rig.codes == [0]


def test_hover_streams_at_ten_hertz_or_more() -> None:
    rig = Rig().fly()
    rig.autopilot.setpoints.clear()
    rig.run(2.0)
    assert len(rig.autopilot.setpoints) >= 20


def test_setpoints_are_passed_on_with_the_right_masks_and_never_with_nan() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=None, vel_ned_mps=(1.0, 2.0, 3.0), acc_ned_mps2=ZERO, yaw_rad=1.5)
    rig.step()
    last = rig.autopilot.setpoints[-1]
    assert last.type_mask == 0b1000_0000_0111
    assert (last.x, last.vx, last.vz, last.yaw) == pytest.approx((0.0, 1.0, 3.0, 1.5))
    rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=(1.0, 2.0, -3.0))
    rig.step()
    last = rig.autopilot.setpoints[-1]
    assert last.type_mask == 0b1001_1111_1000
    assert last.yaw == pytest.approx(1.5), "a heading that isn't given is kept"


def test_a_goal_whose_setpoints_are_all_dropped_ends_with_the_reason() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.run(1.1, lambda: rig.setpoint(control_id, Phase.LANDING))
    assert rig.status.text.startswith("the goal go to ended: none of its setpoints could be flown for 1.0")
    assert "the phase landing of the goal go to while the vehicle flies to a point" in rig.status.text


def test_setpoints_are_stamped_with_the_time_of_the_autopilots_own_clock() -> None:
    """A log of the autopilot, in which setpoints and states stand side by side, is read by these times."""
    rig = Rig().fly()
    rig.run(1.0)
    assert rig.autopilot.setpoints[-1].time_boot_ms == pytest.approx(rig.autopilot.t_us / 1000, abs=100)
