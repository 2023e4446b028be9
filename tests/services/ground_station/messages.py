"""Messages for the ground station's tests."""

from dataclasses import dataclass, replace
from typing import Any

from jezero.schemas.estimate import Covariance6, Relative, RoverEstimate
from jezero.schemas.health import ServiceHealth
from jezero.schemas.images import Image
from jezero.schemas.state import Battery, Odometry, Status


@dataclass(frozen=True)
class Flight:
    """What the statuses of a test have in common."""

    position_m: tuple[float, float, float] = (1.0, 2.0, -3.0)
    epoch_id: int = 1

    def status(self, **fields: Any) -> Status:
        """A status of a vehicle that hovers, unless `fields` say otherwise."""
        odometry = Odometry(
            t_ns=0,
            epoch_id=self.epoch_id,
            pos_uav_ned_m=self.position_m,
            vel_uav_ned_mps=(0.3, -0.4, -0.5),
            q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
            rates_uav_frd_rps=(0.0, 0.0, 0.0),
            std_pos_m=0.1,
        )
        hovering: dict[str, Any] = {
            "t_ns": 0,
            "code": 3,
            "name": "HOVER",
            "odometry": odometry,
            "armed": True,
            "landed": False,
            "in_charge": "hover",
            "bridge_boot_id": 1,
            "ready": True,
            "battery": Battery(voltage_v=16.0, remaining=0.8),
        }
        return Status(**(hovering | fields))

    def at(self, *position_m: float) -> "Flight":
        """The same flight at another position."""
        north_m, east_m, down_m = position_m
        return replace(self, position_m=(north_m, east_m, down_m))


IMAGE = Image(
    index=0,
    t_ns=0,
    pos_uav_ned_m=(0.0, 0.0, -4.0),
    q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
    yaw_rad=0.0,
    pos_camera_ned_m=(0.0, 0.0, -4.0),
    q_ned_from_camera=(1.0, 0.0, 0.0, 0.0),
    pitch_camera_rad=-1.0,
    exposure_s=0.01,
    width_px=640,
    height_px=480,
    focal_px=400.0,
    center_px=(319.5, 239.5),
)


def health(service: str = "estimator", state: Any = "ok", text: str = "fine", boot_id: int = 1) -> ServiceHealth:
    """A service's health."""
    return ServiceHealth(t_ns=0, service=service, boot_id=boot_id, state=state, text=text)


def covariance(position: list[list[float]]) -> Covariance6:
    """The upper triangle of the covariance of position and velocity, of which only that of the position is not 0."""
    whole = [[position[i][j] if max(i, j) < 3 else 0.0 for j in range(6)] for i in range(6)]
    return tuple(float(whole[i][j]) for i in range(6) for j in range(i, 6))


def relative(**fields: Any) -> Relative:
    """A valid relative estimate, unless `fields` say otherwise."""
    valid: dict[str, Any] = {
        "t_ns": 0,
        "epoch_id": 1,
        "valid": True,
        "pos_uav_rel_rover_ned_m": (1.0, 2.0, -3.0),
        "vel_uav_rel_rover_ned_mps": (0.0, 0.0, 0.0),
        "cov": covariance([[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.01]]),
        "vel_rover_ned_mps": (0.0, 0.0, 0.0),
        "yaw_rover_rad": 0.5,
        "yaw_rate_rover_rps": 0.0,
        "use_uwb": True,
        "use_tag": True,
    }
    return Relative(**(valid | fields))


def rover(**fields: Any) -> RoverEstimate:
    """A valid estimate of a rover that stands, unless `fields` say otherwise."""
    valid: dict[str, Any] = {
        "t_ns": 0,
        "epoch_id": 1,
        "valid": True,
        "pos_rover_ned_m": (5.0, -3.0, -0.5),
        "vel_rover_ned_mps": (0.0, 0.0, 0.0),
        "yaw_rover_rad": 0.0,
        "std_pos_m": 0.1,
    }
    return RoverEstimate(**(valid | fields))
