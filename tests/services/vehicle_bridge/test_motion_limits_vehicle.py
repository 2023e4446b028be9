"""The bridge holds the limits of height, distance and speed, whoever sends the setpoints."""

from math import hypot, sqrt

import pytest

from jezero.base.frames import norm
from jezero.base.vehicle_config import VehicleConfig, VehicleLimitsConfig
from jezero.runtime.service import Health
from jezero.schemas.commands import Hover, Phase
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import HOVER
from jezero.services.vehicle_bridge.motion_limits import limited_target, slowed_target
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot
from tests.services.vehicle_bridge.rig import Rig

LIMITS = VehicleLimitsConfig(altitude_max_m=30.0, distance_max_m=40.0, speed_max_mps=6.0)


def flying() -> tuple[Rig, str]:
    """A vehicle that flies a goal, and the goal's control id."""
    rig = Rig(robot=VehicleConfig(limits=LIMITS)).fly()
    return rig, rig.go("go_to", Phase.GO_TO)


@pytest.mark.parametrize(
    ("at_ned_m", "fields", "expected_ned_m"),
    [
        ((0.0, 0.0, -31.0), {"pos_ned_m": (0.0, 0.0, -227.0)}, (0.0, 0.0, -32.0)),
        ((0.0, 0.0, -31.0), {"pos_ned_m": (5.0, 0.0, -227.0)}, (5.0, 0.0, -32.0)),
        ((41.0, 0.0, -5.0), {"pos_ned_m": (433.0, 0.0, -5.0)}, (42.0, 0.0, -5.0)),
        ((-24.6, 32.8, -5.0), {"pos_ned_m": (-240.0, 320.0, -5.0)}, (-25.2, 33.6, -5.0)),
        ((45.0, 0.0, -5.0), {"pos_ned_m": (46.0, 0.0, -5.0)}, (45.0, 0.0, -5.0)),
        ((45.0, 0.0, -5.0), {"pos_ned_m": (30.0, 0.0, -5.0)}, (30.0, 0.0, -5.0)),
        ((39.0, 0.0, -5.0), {"pos_ned_m": (40.0, 0.0, -5.0)}, (40.0, 0.0, -5.0)),
        ((0.0, 0.0, -29.0), {"pos_ned_m": (0.0, 0.0, -30.0)}, (0.0, 0.0, -30.0)),
    ],
)
def test_a_point_beyond_a_limit_reaches_the_autopilot_as_one_at_most_2_m_beyond(
    at_ned_m: tuple[float, ...], fields: dict[str, object], expected_ned_m: tuple[float, ...]
) -> None:
    rig, control_id = flying()
    rig.autopilot.pos[:] = at_ned_m
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.GO_TO, **fields))
    sent = rig.autopilot.setpoints[-1]
    assert (sent.x, sent.y, sent.z) == pytest.approx(expected_ned_m, abs=1e-3)
    assert rig.status.in_charge == "goal"


def test_a_speed_towards_a_limit_is_one_from_which_the_vehicle_stops_there() -> None:
    rig, control_id = flying()
    rig.autopilot.pos[:] = (38.0, 0.0, -5.0)
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=None, vel_ned_mps=(6.0, 1.0, 0.0)))
    sent = rig.autopilot.setpoints[-1]
    assert (sent.vx, sent.vy) == pytest.approx((sqrt(2.0 * 1.0 * 4.0), 1.0), abs=1e-3)
    rig.autopilot.pos[:] = (0.0, 0.0, -40.0)
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=None, vel_ned_mps=(0.0, 0.0, -3.0)))
    assert rig.autopilot.setpoints[-1].vz == pytest.approx(0.0, abs=1e-3)
    text = [output.text for output in rig.outputs if isinstance(output, Health)][-1]
    assert text.endswith("held back 1 times, the last time by the greatest distance of 40 m")


def test_no_setpoint_is_faster_than_the_vehicle_may_fly() -> None:
    rig, control_id = flying()
    fast = {"vel_ned_mps": (900.0, -900.0, 100.0), "acc_ned_mps2": (1e11, 0.0, 0.0), "pos_ned_m": None}
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.GO_TO, **fast))
    sent = rig.autopilot.setpoints[-1]
    assert hypot(sent.vx, sent.vy, sent.vz) == pytest.approx(8.0, abs=1e-3)
    assert sent.afx == pytest.approx(10.0)
    same = Target((1.0, 0.0, -2.0), (4.0, 4.0, 1.0), (1.0, 0.0, 0.0), 0.0)
    assert slowed_target(LIMITS, same) == (same, "")


def test_the_height_of_a_takeoff_counts_from_the_take_off_point() -> None:
    rig = Rig(robot=VehicleConfig(limits=LIMITS))
    rig.autopilot.pos[2] = -8.0
    rig.ready()
    control_id = rig.acquire("takeoff").control_id
    up = {"pos_ned_m": (0.0, 0.0, -100.0)}
    rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF, **up))
    rig.lift_off(39.0)
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.TAKEOFF, **up))
    assert rig.autopilot.setpoints[-1].z == pytest.approx(-40.0, abs=1e-3)


def test_a_hover_that_is_pushed_beyond_a_limit_stays_where_it_is() -> None:
    rig, _ = flying()
    rig.autopilot.pos[:] = (60.0, 0.0, -5.0)
    assert rig.request(HOVER, Hover()).hover_mode
    rig.run(0.5)
    assert rig.status.code == StatusCode.HOVER
    assert rig.autopilot.setpoints[-1].x == pytest.approx(60.0, abs=0.1)


def test_random_setpoints_never_lead_beyond_the_limits() -> None:
    rig, control_id = flying()
    for number in range(200):
        sign = 1.0 if number % 2 else -1.0
        rig.autopilot.pos[:] = (sign * 0.2 * number, 0.1 * number, -0.2 * number - 1.0)
        wild = {"pos_ned_m": (sign * 1e6, -1e6 + 1e4 * number, -1e6), "vel_ned_mps": (1e3, sign * 1e3, -1e3)}
        rig.setpoint(control_id, Phase.GO_TO, **wild)
        rig.step()
        sent = rig.autopilot.setpoints[-1]
        height_m, away_m = -rig.autopilot.pos[2], hypot(*rig.autopilot.pos[:2])
        assert -sent.z <= max(32.0, height_m) + 1e-2
        assert hypot(sent.x, sent.y) <= max(42.0, away_m) + 1e-2
        assert norm((sent.vx, sent.vy, sent.vz)) <= 8.0 + 1e-3


@pytest.mark.parametrize(
    ("target", "name"),
    [
        (Target(None, (12.0, 0.0, 0.0), None, 0.0), "the greatest speed of 6 m/s"),
        (Target(None, (1.0, 0.0, 0.0), (30.0, 0.0, 0.0), 0.0), "the greatest speed of 6 m/s"),
        (Target((0.0, 100.0, -5.0), None, None, 0.0), "the greatest distance of 40 m"),
        (Target((41.0, 0.0, -60.0), None, None, 0.0), "the greatest height of 30 m"),
        (Target((3.0, 0.0, -8.0), (3.0, 0.0, 0.0), (5.0, 0.0, 0.0), 0.0), ""),
    ],
)
def test_each_limit_is_named_alone_with_its_value(target: Target, name: str) -> None:
    """The walls of height and distance are far from the vehicle, but for that of a point above it."""
    vehicle = VehicleSnapshot(t_ns=0, timer_ns=0, pos_ned_m=(0.0, 0.0, -5.0))
    limited, named = limited_target(None, LIMITS, target, vehicle, floor_holds=True)
    assert named == name
    assert (limited is target) is (name == "")


def test_without_a_position_only_the_speed_is_limited() -> None:
    nowhere = VehicleSnapshot(t_ns=0, timer_ns=0)
    assert nowhere.pos_ned_m is None
    rising = Target(None, (0.0, 0.0, -20.0), None, 0.0)
    limited, name = limited_target(None, LIMITS, rising, nowhere, floor_holds=True)
    assert limited.vel_ned_mps == pytest.approx((0.0, 0.0, -8.0))
    assert name == "the greatest speed of 6 m/s"
    far = Target((0.0, 90.0, -90.0), (0.0, 0.0, -5.0), None, 0.0)
    assert limited_target(None, LIMITS, far, nowhere, floor_holds=True) == (far, "")
