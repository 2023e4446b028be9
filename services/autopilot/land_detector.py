"""The land detector: decides from motion, thrust and setpoint whether the vehicle stands on something.

Three stages follow each other, each after its own time: ground contact (a descent is commanded, and the vehicle does
not descend), maybe landed (the thrust is low too), landed. Source: PX4's `MulticopterLandDetector`, thresholds
`LNDMC_*`.
"""

from math import hypot

from jezero.base.frames import Vec3
from jezero.services.autopilot.config import LandDetectorConfig

DESCENT_SETPOINT_MIN_RATIO = 1.1
"""A descent is commanded when the velocity setpoint is larger than this multiple of LNDMC_Z_VEL_MAX."""
DESCENT_ACHIEVED_MAX_RATIO = 0.5
"""A commanded descent is blocked when the vehicle has less than this fraction of the commanded speed."""
CLIMB_SETPOINT_MIN_MPS = 0.1
"""An upward setpoint above this is a commanded climb. It ends the contact although the thrust is still low, because
contact limits the thrust.
"""
CONTACT_S, MAYBE_LANDED_S = 0.5, 0.25
"""Durations of the conditions of the first two stages."""
TOUCH_MIN_S = 0.2
TOUCH_HOLD_S = 0.2
"""The vehicle touches something when its descent was blocked for TOUCH_MIN_S, until TOUCH_HOLD_S after the blocking."""
LOW_THRUST_MAX_RATIO = 0.3
"""Fraction of the hover thrust."""
TIPPING_RATE_MIN_RPS = 0.035
"""Rate about a horizontal axis of a vehicle that starts to tip over an edge; one that stands rotates slower."""


class LandDetector:
    """Detects ground contact and landing.

    Attributes:
        contact: whether something blocks a commanded descent, or the thrust is low without motion.
        landed: whether the vehicle stands on something.
    """

    def __init__(self, config: LandDetectorConfig) -> None:
        self.configure(config)
        self.reset()

    def configure(self, config: LandDetectorConfig) -> None:
        """Apply new settings at once."""
        self._config = config

    def reset(self) -> None:
        """Set the state to landed."""
        self.contact = True
        self.landed = True
        self._contact_s = self._low_s = self._blocked_s = self._untouched_s = 0.0

    def on_takeoff(self) -> None:
        """Set the state to flying."""
        self.contact = False
        self.landed = False
        self._contact_s = self._low_s = self._blocked_s = 0.0
        self._untouched_s = TOUCH_HOLD_S

    @property
    def touching(self) -> bool:
        """Whether something blocks the descent, or did until a moment ago; a short bump does not count."""
        return self._untouched_s < TOUCH_HOLD_S

    def step(
        self, dt: float, vel_ned_mps: Vec3, rates_frd_rps: Vec3, vel_setpoint_down_mps: float, thrust_hover_ratio: float
    ) -> None:
        """Advance by `dt` seconds of armed flight.

        Args:
            vel_ned_mps: estimated velocity; horizontal part 0 if it is not controlled, as its estimate may drift.
            vel_setpoint_down_mps: vertical velocity setpoint, positive down.
            thrust_hover_ratio: thrust divided by the hover thrust.
        """
        c = self._config
        moving = abs(vel_ned_mps[2]) > c.lndmc_z_vel_max_mps or hypot(vel_ned_mps[0], vel_ned_mps[1]) > (
            c.lndmc_xy_vel_max_mps
        )
        descent_commanded = vel_setpoint_down_mps > DESCENT_SETPOINT_MIN_RATIO * c.lndmc_z_vel_max_mps
        blocked = descent_commanded and vel_ned_mps[2] < DESCENT_ACHIEVED_MAX_RATIO * vel_setpoint_down_mps
        climb_commanded = vel_setpoint_down_mps < -CLIMB_SETPOINT_MIN_MPS
        held = (blocked or thrust_hover_ratio < LOW_THRUST_MAX_RATIO) and not (moving or climb_commanded)
        self._contact_s = self._contact_s + dt if held else 0.0
        self.contact = self._contact_s >= CONTACT_S
        self._blocked_s = self._blocked_s + dt if blocked else 0.0
        self._untouched_s = 0.0 if self._blocked_s >= TOUCH_MIN_S else self._untouched_s + dt
        rotating = max(abs(rate) for rate in rates_frd_rps) > c.lndmc_rot_max_rps
        tipping = hypot(rates_frd_rps[0], rates_frd_rps[1]) > TIPPING_RATE_MIN_RPS
        at_rest = self.contact and thrust_hover_ratio < LOW_THRUST_MAX_RATIO and not (rotating or tipping)
        self._low_s = self._low_s + dt if at_rest else 0.0
        self.landed = self._low_s >= MAYBE_LANDED_S + c.landed_s
