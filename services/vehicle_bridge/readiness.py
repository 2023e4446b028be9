"""Why a vehicle on the ground can't take off, in words."""

from collections.abc import Iterator

from jezero.frames import horizontal
from jezero.services.vehicle_bridge.autopilot_link import AutopilotLink
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig


def why_not_ready(
    link: AutopilotLink, epoch_id: int | None, silent_s: float, timer_ns: int, config: VehicleBridgeConfig
) -> str:
    """The first thing that a takeoff lacks, or "".

    Args:
        epoch_id: of the vehicle; None before vehicle time is known.
        silent_s: for how long telemetry, or odometry in it, has been missing.
    """
    return next(_missing(link, epoch_id, silent_s, timer_ns, config), "")


def why_carried(link: AutopilotLink, config: VehicleBridgeConfig) -> str:
    """Why nothing can take off from what the vehicle stands on, or ""."""
    odometry, limit_mps = link.telemetry.odometry, config.takeoff_speed_max_mps
    speed_mps = 0.0 if odometry is None else horizontal(odometry.vel_uav_ned_mps)
    if speed_mps <= limit_mps:
        return ""
    return f"what the vehicle stands on moves at {speed_mps:.2f} m/s: stop it, {limit_mps:g} m/s is the limit"


def _missing(
    link: AutopilotLink, epoch_id: int | None, silent_s: float, timer_ns: int, config: VehicleBridgeConfig
) -> Iterator[str]:
    told = link.telemetry
    if epoch_id is None:
        yield "no vehicle time yet: is the simulator running?"
    if told.heard_wall_ns is None:
        yield "no autopilot heard yet"
    if told.odometry is None:
        yield "the autopilot sends no odometry yet: its estimator is still converging"
    if silent_s > config.link_timeout_s:
        yield f"the autopilot's telemetry has been missing for {silent_s:.0f} s"
    if told.origin_deg is None:
        yield "the autopilot has no origin yet: it waits for GNSS"
    if told.armed is None:
        yield "the autopilot has not told yet whether it is armed"
    if setting := link.parameters.pending:
        yield f"the autopilot's parameters are being set: {', '.join(setting)}"
    if not told.armable:
        warning = link.warning(timer_ns)
        because = f": {warning}" if warning else ""
        yield f"the autopilot's arming checks don't pass yet in mode {told.mode}{because}"
