"""Interfaces of the two replaceable parts of a vehicle: the estimate of its motion and the flight controller.

`Estimator` and `MulticopterController` implement them with sensors and motors, the fault campaign's point mass without.
"""

from typing import Protocol

from jezero.base.frames import Quat, Vec3
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.config import AutopilotConfig, StateEstimatorConfig
from jezero.services.autopilot.control import ControlSetpoint, Kinematics
from jezero.services.autopilot.land_detector import LandDetector
from jezero.services.autopilot.mixer import Commands


class StateEstimate(Protocol):
    """Estimated state of the vehicle. It is updated with the measurements of the sensors as they arrive."""

    @property
    def running(self) -> bool:
        """Whether the estimate has started."""

    @property
    def invalid_reason(self) -> str:
        """Why the estimate is invalid, as a text for people; empty when it is valid."""

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
        """(3,) variance of the position, NED."""

    @property
    def origin_deg(self) -> Vec3 | None: ...
    @property
    def reset_counter(self) -> int: ...

    @property
    def reset_offset_ned_m(self) -> Vec3:
        """Sum of the steps by which resets moved the position."""

    def configure(self, config: StateEstimatorConfig) -> None: ...
    def on_imu(self, t_us: int, acc_frd_mps2: Vec3, gyro_frd_rps: Vec3) -> None: ...
    def on_fix(self, fix: Fix) -> None: ...
    def on_baro(self, altitude_pressure_m: float) -> None: ...
    def on_mag(self, field_frd_gauss: Vec3) -> None: ...

    def on_landed(self, landed: bool) -> None:
        """Update the state of the land detector."""


class FlightController(Protocol):
    """Follows setpoints and detects the landing."""

    @property
    def detector(self) -> LandDetector: ...
    @property
    def kinematics(self) -> Kinematics: ...

    @property
    def vel_setpoint_ned_mps(self) -> Vec3:
        """(3,) velocity setpoint after position control and limits."""

    def contact_lean_ned(self, sine_max: float) -> tuple[float, float] | None:
        """North and east part of the body's up axis while something on one side tilts the vehicle, otherwise None.

        Args:
            sine_max: sine of the largest tilt that doesn't count.
        """

    def configure(self, config: AutopilotConfig) -> None: ...

    def leave_contact(self) -> None:
        """Set the state to flying and allow full thrust, to get away from a contact."""

    def stop(self) -> Commands:
        """Reset all controllers of a disarmed vehicle; returns commands of stopped motors."""

    def step(self, dt: float, setpoint: ControlSetpoint, *, allow_takeoff: bool) -> Commands:
        """Run the controllers of an armed vehicle; a climb setpoint makes it take off only if `allow_takeoff`."""
