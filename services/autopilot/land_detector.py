"""Whether the vehicle stands on something, from motion, thrust and what was asked of it.

Three stages, each of which must hold for a while: contact (it shall descend and doesn't), maybe landed (and the thrust
is low), landed. Source: PX4's multicopter land detector, thresholds `LNDMC_*`.
"""

from math import hypot

from jezero.frames import Vec3
from jezero.services.autopilot.config import LandDetectorConfig

DESCENT_WANTED = 1.1
"""A descent is wanted when the setpoint is faster than this many times the speed that counts as moving."""
DESCENT_DONE = 0.5
"""It doesn't happen when less than this share of it is seen."""
CLIMB_WANTED_MPS = 0.1
"""A setpoint that is faster upwards wants to leave, which low thrust must not keep from having more of it."""
TOUCHES_S = 0.2
UNTOUCHED_S = 0.2
"""What kept the vehicle from descending for the one time touches it, until it hasn't done so for the other."""
LOW_THRUST = 0.3
"""Share of the thrust that hovers."""
TIPS_RPS = 0.035
"""About a horizontal axis: what stands doesn't turn like that, what slowly begins to fall over an edge does."""


class LandDetector:
    """Attributes: contact: the vehicle shall descend and something holds it; landed: it stands there for good."""

    def __init__(self, config: LandDetectorConfig) -> None:
        self.configure(config)
        self.reset()

    def configure(self, config: LandDetectorConfig) -> None:
        """New settings."""
        self._config = config

    def reset(self) -> None:
        """The vehicle stands on the ground."""
        self.contact = True
        self.landed = True
        self._contact_s = self._low_s = self._blocked_s = self._untouched_s = 0.0

    def lifted_off(self) -> None:
        """The vehicle flies."""
        self.contact = False
        self.landed = False
        self._contact_s = self._low_s = self._blocked_s = 0.0
        self._untouched_s = UNTOUCHED_S

    @property
    def touches(self) -> bool:
        """Something keeps the vehicle from descending for longer than a bump does, or did a moment ago."""
        return self._untouched_s < UNTOUCHED_S

    def step(
        self, dt: float, vel_ned_mps: Vec3, rates_frd_rps: Vec3, down_wanted_mps: float, thrust_of_hover: float
    ) -> None:
        """Advance by `dt` seconds of armed flight.

        Args:
            vel_ned_mps: of the estimate; its horizontal part 0 where that isn't flown by, as it may have gone astray.
            down_wanted_mps: vertical velocity setpoint, positive down.
            thrust_of_hover: thrust as a share of the thrust that hovers.
        """
        c = self._config
        moves = abs(vel_ned_mps[2]) > c.lndmc_z_vel_max_mps or hypot(vel_ned_mps[0], vel_ned_mps[1]) > (
            c.lndmc_xy_vel_max_mps
        )
        wanted = down_wanted_mps > DESCENT_WANTED * c.lndmc_z_vel_max_mps
        blocked = wanted and vel_ned_mps[2] < DESCENT_DONE * down_wanted_mps
        climbs = down_wanted_mps < -CLIMB_WANTED_MPS
        held_down = (blocked or thrust_of_hover < LOW_THRUST) and not (moves or climbs)
        self._contact_s = self._contact_s + dt if held_down else 0.0
        self.contact = self._contact_s >= c.contact_s
        self._blocked_s = self._blocked_s + dt if blocked else 0.0
        self._untouched_s = 0.0 if self._blocked_s >= TOUCHES_S else self._untouched_s + dt
        turns = max(abs(rate) for rate in rates_frd_rps) > c.lndmc_rot_max_rps
        tips = hypot(rates_frd_rps[0], rates_frd_rps[1]) > TIPS_RPS
        rests = self.contact and thrust_of_hover < LOW_THRUST and not (turns or tips)
        self._low_s = self._low_s + dt if rests else 0.0
        self.landed = self._low_s >= c.maybe_landed_s + c.landed_s
