"""Targets to stream: a goal's setpoint, and the bridge's own to come to rest and to press onto the ground."""

from jezero.schemas.commands import Hover, Release, Setpoint
from jezero.services.vehicle_bridge.resets import ResetHistory
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot

STOPPING_TIME_S = 0.5
"""A hover begins at the point that the present velocity reaches in this time, so that the vehicle needn't turn back."""
LOW_HEIGHT_M = 1.0
"""Height over ground or platform below which no descent comes to rest, and an aborted vehicle climbs."""
PRESS_DOWN_MPS = 0.5
"""Commanded descent on the ground until the motors stop. Source: spec §8."""


def heading_rad(previous: Target | None, vehicle: VehicleSnapshot) -> float:
    """Heading of the previous target, else of the vehicle."""
    return vehicle.yaw_rad if previous is None else previous.yaw_rad


def setpoint_target(
    setpoint: Setpoint, previous: Target | None, vehicle: VehicleSnapshot, resets: ResetHistory
) -> Target:
    """Target of an accepted setpoint, moved by the resets since it was computed; the heading stays where the setpoint
    has none."""
    yaw_rad = heading_rad(previous, vehicle) if setpoint.yaw_rad is None else setpoint.yaw_rad
    target = Target(setpoint.pos_ned_m, setpoint.vel_ned_mps, setpoint.acc_ned_mps2, yaw_rad, setpoint.yaw_rate_rps)
    if setpoint.reset_counter == resets.counter:
        return target
    return target.moved(resets.step_since(setpoint.reset_counter) or (0.0, 0.0, 0.0))


def stopping_target(previous: Target | None, vehicle: VehicleSnapshot) -> Target:
    """Hover where the vehicle comes to rest, with the same heading; a descent ends above `LOW_HEIGHT_M`."""
    pos_ned_m, vel = vehicle.pos_ned_m or (0.0, 0.0, 0.0), vehicle.vel_ned_mps
    room_m = max(0.0, (vehicle.height_m or 0.0) - LOW_HEIGHT_M)
    down_m = min(vel[2] * STOPPING_TIME_S, room_m)
    north_m, east_m = pos_ned_m[0] + vel[0] * STOPPING_TIME_S, pos_ned_m[1] + vel[1] * STOPPING_TIME_S
    return Target((north_m, east_m, pos_ned_m[2] + down_m), None, None, heading_rad(previous, vehicle))


def hover_target(request: Hover, stopping: Target) -> tuple[Target, str]:
    """Hover where a request says, with the heading of `stopping`, or at `stopping`; and the event, for people."""
    if request.hover_pos is None:
        return stopping, "hovering here"
    text = "hovering at ({:.2f}, {:.2f}, {:.2f})".format(*request.hover_pos)
    return Target(request.hover_pos, None, None, stopping.yaw_rad), text


def released_target(release: Release, stopping: Target, resets: ResetHistory) -> Target:
    """Hover where a finished goal's release says, with the heading of `stopping`; at `stopping` where it says nothing
    or its reset counter is unknown."""
    step_ned_m = resets.step_since(release.reset_counter)
    if release.hover_pos_ned_m is None or step_ned_m is None:
        return stopping
    return Target(release.hover_pos_ned_m, None, None, stopping.yaw_rad).moved(step_ned_m)


def press_down_target(previous: Target | None, vehicle: VehicleSnapshot) -> Target:
    """Keep the vehicle on the ground, or on the moving platform, until its motors stop."""
    vel = None if previous is None else previous.vel_ned_mps
    north_mps, east_mps, _ = vel or (0.0, 0.0, 0.0)
    return Target(None, (north_mps, east_mps, PRESS_DOWN_MPS), None, heading_rad(previous, vehicle))
