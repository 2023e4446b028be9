"""Controllers and land detector of a multicopter: from a setpoint to motor commands, with takeoff and landing."""

from jezero.base.detectors import is_tilted_by_contact
from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleConfig
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.control import CascadeController, ControlSetpoint, Kinematics
from jezero.services.autopilot.estimator import StateEstimator
from jezero.services.autopilot.land_detector import CLIMB_SETPOINT_MIN_MPS, LandDetector
from jezero.services.autopilot.mixer import Commands

OUTER_STEPS = 4
"""The velocity loop runs with every fourth IMU sample."""
SPOOLUP_TIME_S = 0.5
"""Time from arming until a takeoff can start."""
LIFTOFF_SPEED_MIN_MPS = 0.2
LIFTOFF_CLIMB_MIN_M = 0.1
"""The vehicle has lifted off when it climbs faster or higher than this."""


class MulticopterController:
    """Runs the cascade of controllers and the land detector.

    Attributes:
        detector: the land detector.
    """

    def __init__(self, config: AutopilotConfig, vehicle: VehicleConfig, estimator: StateEstimator) -> None:
        self.detector = LandDetector(config.land_detector)
        self._estimator = estimator
        self._controller = CascadeController(config.control, vehicle)
        self._step = 0
        self._outer_s = 0.0
        self._armed_s = 0.0
        self._takeoff_start_down_m: float | None = None

    def configure(self, config: AutopilotConfig) -> None:
        """Apply new settings at once."""
        self._controller.configure(config.control)
        self.detector.configure(config.land_detector)

    @property
    def vel_setpoint_ned_mps(self) -> Vec3:
        """(3,) velocity setpoint after position control and limits."""
        return self._controller.vel_setpoint_ned_mps

    def contact_lean_ned(self, sine_max: float) -> tuple[float, float] | None:
        """See `FlightController`."""
        detector = self.detector
        if detector.landed or not (detector.touching or detector.contact):
            return None
        r = self._estimator.R_ned_from_frd
        up_ned = (-r[2], -r[5])
        return up_ned if is_tilted_by_contact(up_ned, self._controller.up_setpoint_ned[:2], sine_max) else None

    def leave_contact(self) -> None:
        """Set the state to flying and allow full thrust, to get away from a contact."""
        self.detector.on_takeoff()
        self._controller.leave_contact()

    def stop(self) -> Commands:
        """Reset all controllers of a disarmed vehicle; returns commands of stopped motors."""
        self.detector.reset()
        self._armed_s = 0.0
        self._takeoff_start_down_m = None
        return self._controller.stop(self._estimator.yaw_rad)

    def step(self, dt: float, setpoint: ControlSetpoint, *, allow_takeoff: bool) -> Commands:
        """Run the controllers of an armed vehicle; returns (4,) motor commands from 0 to 1.

        Args:
            allow_takeoff: whether a climb setpoint makes a landed vehicle take off.
        """
        self._armed_s += dt
        self._outer_s += dt
        self._step += 1
        if self._step % OUTER_STEPS == 0:
            self._step_outer(self._outer_s, setpoint, allow_takeoff=allow_takeoff)
            self._outer_s = 0.0
        estimator = self._estimator
        if self.detector.landed and self._takeoff_start_down_m is None:
            return self._controller.idle(estimator.yaw_rad)
        return self._controller.step_inner(dt, estimator.rates_frd_rps, estimator.R_ned_from_frd)

    def _step_outer(self, dt: float, setpoint: ControlSetpoint, *, allow_takeoff: bool) -> None:
        at = self.kinematics
        detector, controller = self.detector, self._controller
        if not detector.landed:
            controller.step_outer(dt, at, setpoint, airborne=True, in_contact=detector.contact)
            down_mps = controller.vel_setpoint_ned_mps[2]
            if detector.touching and down_mps < -CLIMB_SETPOINT_MIN_MPS:
                controller.leave_contact()
            vel_ned_mps = (0.0, 0.0, at.vel_ned_mps[2]) if setpoint.is_horizontally_free else at.vel_ned_mps
            detector.step(dt, vel_ned_mps, self._estimator.rates_frd_rps, down_mps, controller.thrust_hover_ratio)
            return
        climbs = controller.velocity_setpoint(at, setpoint)[2] < -CLIMB_SETPOINT_MIN_MPS
        if not (allow_takeoff and climbs and self._armed_s >= SPOOLUP_TIME_S):
            self._takeoff_start_down_m = None
            return
        if self._takeoff_start_down_m is None:
            self._takeoff_start_down_m = at.pos_ned_m[2]
        controller.step_outer(dt, at, setpoint, airborne=False)
        if (
            at.vel_ned_mps[2] < -LIFTOFF_SPEED_MIN_MPS
            or self._takeoff_start_down_m - at.pos_ned_m[2] > LIFTOFF_CLIMB_MIN_M
        ):
            self._takeoff_start_down_m = None
            detector.on_takeoff()

    @property
    def kinematics(self) -> Kinematics:
        """Position, velocity, acceleration and heading of the estimate."""
        e = self._estimator
        return Kinematics(e.pos_ned_m, e.vel_ned_mps, e.acc_ned_mps2, e.yaw_rad)
