"""From a setpoint to motor commands: on the ground, lifting off, in the air, touching down."""

from jezero.frames import Vec3
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.control import Controller, Kinematics, Setpoint
from jezero.services.autopilot.estimator import Estimator
from jezero.services.autopilot.land_detector import CLIMB_WANTED_MPS, LandDetector
from jezero.services.autopilot.mixer import Commands
from jezero.tilt_contact import is_tilted_by_contact

OUTER_STEPS = 4
"""The velocity loop runs with every fourth IMU sample."""
SPOOL_UP_S = 0.5
LIFTED_MPS = 0.2
LIFTED_M = 0.1


class Flight:
    """Runs the controllers and the land detector.

    Attributes:
        detector: whether the vehicle stands on something.
    """

    def __init__(self, config: AutopilotConfig, estimator: Estimator) -> None:
        self.detector = LandDetector(config.land_detector)
        self._estimator = estimator
        self._controller = Controller(config.control, config.airframe)
        self._step = 0
        self._outer_s = 0.0
        self._armed_s = 0.0
        self._lifting_from_m: float | None = None

    def configure(self, config: AutopilotConfig) -> None:
        """New settings, effective at once."""
        self._controller.configure(config.control)
        self.detector.configure(config.land_detector)

    @property
    def vel_setpoint_ned_mps(self) -> Vec3:
        """What position and velocity of the setpoint come to."""
        return self._controller.vel_setpoint_ned_mps

    @property
    def tips_ned(self) -> tuple[float, float] | None:
        """North and east part of where the vehicle leans over, held up on the other side; None when it doesn't."""
        detector = self.detector
        if detector.landed or not (detector.touches or detector.contact):
            return None
        r = self._estimator.R_ned_from_frd
        up_ned = (-r[2], -r[5])
        return up_ned if is_tilted_by_contact(up_ned, self._controller.up_wanted_ned[:2]) else None

    def leave(self) -> None:
        """Away from what it touches."""
        self.detector.lifted_off()
        self._controller.leave()

    def stopped(self) -> Commands:
        """Disarmed: motors still, everything forgotten."""
        self.detector.reset()
        self._armed_s = 0.0
        self._lifting_from_m = None
        return self._controller.stopped(self._estimator.yaw_rad)

    def step(self, dt: float, setpoint: Setpoint, *, may_lift: bool) -> Commands:
        """Armed: (4,) motor commands from 0 to 1.

        Args:
            may_lift: a setpoint above the vehicle makes it take off.
        """
        self._armed_s += dt
        self._outer_s += dt
        self._step += 1
        if self._step % OUTER_STEPS == 0:
            self._outer(self._outer_s, setpoint, may_lift=may_lift)
            self._outer_s = 0.0
        estimator = self._estimator
        if self.detector.landed and self._lifting_from_m is None:
            return self._controller.idle(estimator.yaw_rad)
        return self._controller.inner(dt, estimator.rates_frd_rps, estimator.R_ned_from_frd)

    def _outer(self, dt: float, setpoint: Setpoint, *, may_lift: bool) -> None:
        at = self.kinematics
        detector, controller = self.detector, self._controller
        if not detector.landed:
            controller.outer(dt, at, setpoint, airborne=True, held_down=detector.contact)
            down_mps = controller.vel_setpoint_ned_mps[2]
            if detector.touches and down_mps < -CLIMB_WANTED_MPS:
                controller.leave()
            vel_ned_mps = (0.0, 0.0, at.vel_ned_mps[2]) if setpoint.lets_drift else at.vel_ned_mps
            detector.step(dt, vel_ned_mps, self._estimator.rates_frd_rps, down_mps, controller.thrust_hover)
            return
        climbs = controller.wanted_velocity(at, setpoint)[2] < -CLIMB_WANTED_MPS
        if not (may_lift and climbs and self._armed_s >= SPOOL_UP_S):
            self._lifting_from_m = None
            return
        if self._lifting_from_m is None:
            self._lifting_from_m = at.pos_ned_m[2]
        controller.outer(dt, at, setpoint, airborne=False)
        if at.vel_ned_mps[2] < -LIFTED_MPS or self._lifting_from_m - at.pos_ned_m[2] > LIFTED_M:
            self._lifting_from_m = None
            detector.lifted_off()

    @property
    def kinematics(self) -> Kinematics:
        """What the estimate says of position and motion."""
        e = self._estimator
        return Kinematics(e.pos_ned_m, e.vel_ned_mps, e.acc_ned_mps2, e.yaw_rad)
