"""The monitor of a flight: when something holds a vehicle near the ground, and when it only looks so."""

from typing import Any

import pytest

from jezero.base.frames import quat_from_euler
from jezero.schemas.units import NS_PER_S
from jezero.services.vehicle_bridge.flight_monitor import FlightMonitor
from jezero.services.vehicle_bridge.vehicle import OFFBOARD, Target, VehicleSnapshot

CLIMB = Target(None, (0.0, 0.0, -1.0), None, 0.0)
PUSH = Target(None, (0.0, 0.0, 0.5), None, 0.0)


def at(
    seconds: float,
    *,
    tilt_rad: float = 0.1,
    height_m: float = 0.4,
    speed_mps: float = 0.0,
    mode: str = OFFBOARD,
    telemetry_age_s: float = 0.0,
) -> VehicleSnapshot:
    return VehicleSnapshot(
        t_ns=int(seconds * NS_PER_S),
        timer_ns=int(seconds * NS_PER_S),
        armed=True,
        pos_ned_m=(0.0, 0.0, -height_m),
        vel_ned_mps=(speed_mps, 0.0, 0.0),
        q_ned_from_frd=quat_from_euler(tilt_rad, 0.0, 0.0),
        height_m=height_m,
        mode=mode,
        telemetry_age_s=telemetry_age_s,
    )


def reason_after(seconds: float, target: Target | None = CLIMB, *, flying: bool = True, **vehicle: Any) -> str:
    """Reason to cut the motors of a vehicle that has been in the same state for this time."""
    monitor = FlightMonitor(router_timeout_s=10.0)
    monitor.update(at(0.0), None, flying=False)
    for tenth in range(1, round(10 * seconds) + 1):
        monitor.update(at(tenth / 10, **vehicle), target, flying=flying)
    return monitor.kill_reason(at(seconds, **vehicle))


@pytest.mark.parametrize(
    "target",
    [
        CLIMB,
        Target(None, (0.4, 0.0, 0.0), None, 0.0),
        Target((0.0, 0.0, -3.0), None, None, 0.0),
        Target((0.0, 0.0, -1.0), (0.0, 0.0, 0.0), None, 0.0),
    ],
    ids=["climb", "sideways", "position", "a path that waits for the vehicle"],
)
def test_a_vehicle_near_the_ground_that_does_not_move_to_its_target_is_wedged(target: Target) -> None:
    assert reason_after(4.5, target) == ""
    reason = reason_after(5.5, target)
    assert reason.startswith("motors cut: the vehicle is wedged near the ground, tilted by 6 degrees, and has not")
    assert "free it from what holds it" in reason


def test_a_vehicle_that_hangs_below_the_edge_of_a_high_platform_is_wedged() -> None:
    assert "wedged near the ground" in reason_after(5.5, height_m=0.9)


@pytest.mark.parametrize(
    ("target", "vehicle"),
    [
        (CLIMB, {"height_m": 1.1}),
        (CLIMB, {"speed_mps": 0.3}),
        (CLIMB, {"mode": "POSCTL"}),
        (CLIMB, {"telemetry_age_s": 1.5}),
        (PUSH, {}),
        (Target((0.2, 0.0, -0.4), None, None, 0.0), {}),
        (None, {}),
    ],
    ids=[
        "in the air",
        "moving",
        "following somebody else",
        "telemetry missing",
        "pushed down on a slope",
        "in place against the wind",
        "nothing commanded",
    ],
)
def test_what_only_looks_like_a_wedge_is_none(target: Target | None, vehicle: dict[str, Any]) -> None:
    assert reason_after(20.0, target, **vehicle) == ""


def test_a_vehicle_that_somebody_else_flies_is_left_alone() -> None:
    assert reason_after(20.0, flying=False) == ""
