"""What a vehicle is made of: an estimate of its motion, and what flies it.

`Estimator` and `Flight` do it from sensors and with motors; the fault campaign's point mass does it without either.
"""

from typing import Protocol

from jezero.frames import Quat, Vec3
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.config import AutopilotConfig, EstimatorConfig
from jezero.services.autopilot.control import Kinematics, Setpoint
from jezero.services.autopilot.land_detector import LandDetector
from jezero.services.autopilot.mixer import Commands


class Estimate(Protocol):
    """Where the vehicle believes to be. Sensors are given to it as they arrive."""

    @property
    def running(self) -> bool:
        """There is an estimate."""

    @property
    def missing(self) -> str:
        """Why the estimate can't be flown with, in words; empty when it can."""

    @property
    def pos_ned_m(self) -> Vec3: ...
    @property
    def vel_ned_mps(self) -> Vec3: ...
    @property
    def q_ned_from_frd(self) -> Quat: ...
    @property
    def rates_frd_rps(self) -> Vec3: ...
    @property
    def yaw_rad(self) -> float: ...
    @property
    def tilt_rad(self) -> float: ...

    @property
    def var_pos_ned_m2(self) -> Vec3:
        """(3,) variance of the position."""

    @property
    def origin_deg(self) -> Vec3 | None: ...
    @property
    def reset_counter(self) -> int: ...

    @property
    def reset_offset_ned_m(self) -> Vec3:
        """Sum of the steps by which resets moved the position."""

    def configure(self, config: EstimatorConfig) -> None: ...
    def imu(self, t_us: int, acc_frd_mps2: Vec3, gyro_frd_rps: Vec3) -> None: ...
    def fix(self, fix: Fix) -> None: ...
    def baro(self, altitude_pressure_m: float) -> None: ...
    def mag(self, field_frd_gauss: Vec3) -> None: ...


class Pilot(Protocol):
    """Follows setpoints, and knows whether the vehicle stands on something."""

    @property
    def detector(self) -> LandDetector: ...
    @property
    def kinematics(self) -> Kinematics: ...

    @property
    def vel_setpoint_ned_mps(self) -> Vec3:
        """What position and velocity of the setpoint come to."""

    @property
    def tips_ned(self) -> tuple[float, float] | None:
        """North and east part of where the vehicle leans over, held up on the other side; None when it doesn't."""

    def configure(self, config: AutopilotConfig) -> None: ...

    def leave(self) -> None:
        """Away from what it touches."""

    def stopped(self) -> Commands:
        """Disarmed: motors still, everything forgotten."""

    def step(self, dt: float, setpoint: Setpoint, *, may_lift: bool) -> Commands:
        """Armed; a setpoint above the vehicle makes it take off if it `may_lift`."""
