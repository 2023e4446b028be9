"""Reasons why a vehicle on the ground can't take off, for people."""

from collections.abc import Iterator

from jezero.frames import horizontal
from jezero.services.vehicle_bridge.autopilot_link import AutopilotLink
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.vehicle import LINK_TIMEOUT_S


def system_not_ready_reason(
    link: AutopilotLink, epoch_id: int | None, telemetry_age_s: float, timer_ns: int
) -> str | None:
    """First thing that the system lacks for a takeoff, None when it lacks nothing.

    Args:
        epoch_id: epoch of the vehicle; None before vehicle time is known.
        telemetry_age_s: age of the newest telemetry, or of the newest odometry if that is older.
    """
    return next(_missing(link, epoch_id, telemetry_age_s, timer_ns), None)


def moving_ground_reason(link: AutopilotLink, config: VehicleBridgeConfig) -> str | None:
    """Reason why nothing can take off from a moving rover, None when the vehicle stands still."""
    odometry, limit_mps = link.telemetry.odometry, config.takeoff_speed_max_mps
    speed_mps = 0.0 if odometry is None else horizontal(odometry.vel_uav_ned_mps)
    if speed_mps <= limit_mps:
        return None
    return f"the ground under the vehicle moves at {speed_mps:.2f} m/s: stop the rover, {limit_mps:g} m/s is the limit"


def _missing(link: AutopilotLink, epoch_id: int | None, telemetry_age_s: float, timer_ns: int) -> Iterator[str]:
    telemetry = link.telemetry
    if epoch_id is None:
        yield "no vehicle time yet: is the simulator running?"
    if telemetry.received_wall_ns is None:
        yield "no telemetry from the autopilot yet"
    if telemetry.odometry is None:
        yield "the autopilot sends no odometry yet: its estimator is still converging"
    if telemetry_age_s > LINK_TIMEOUT_S:
        yield f"the autopilot's telemetry has been missing for {telemetry_age_s:.0f} s"
    if telemetry.origin_deg is None:
        yield "the autopilot has no origin yet: it waits for GNSS"
    if telemetry.armed is None:
        yield "the autopilot has not reported yet whether it is armed"
    if setting := link.parameters.pending:
        yield f"the autopilot's parameters are being set: {', '.join(setting)}"
    if not telemetry.armable:
        warning = link.warning(timer_ns)
        because = f": {warning}" if warning else ""
        yield f"the autopilot's arming checks don't pass yet in mode {telemetry.mode}{because}"
