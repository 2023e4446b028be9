"""Search for a rover that is out of sight: rounds about its supposed position, each higher and wider."""

from math import cos, hypot, pi, sin

from jezero.frames import Vec3
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.config import SearchConfig

CORNERS = 6


CLIMB_M = 1.5
"""Height between two rounds."""
REACHED_M = 0.5
"""Distance at which a corner counts as reached."""
CORNER_TIMEOUT_S = 10.0


class Search:
    """Flies from corner to corner of the rounds.

    Args:
        height_m: over the platform, or over the ground at the rover's supposed position, when the search begins.

    Attributes:
        offset_m: (2,) north and east of the present corner from the rover's supposed position.
        height_m: height of the present corner.
        over: whether all rounds are flown.
    """

    def __init__(self, t_ns: int, height_m: float, config: SearchConfig) -> None:
        self._config = config
        self._height_start_m = height_m
        self._number = 0
        self._since_ns = t_ns
        self.over = False
        self._aim()

    def step(self, t_ns: int, offset_m: tuple[float, float], height_m: float) -> None:
        """Go on to the next corner when this one is reached, or its time is over.

        Args:
            offset_m: (2,) of the vehicle from the rover's supposed position.
            height_m: of the vehicle.
        """
        away_m = hypot(offset_m[0] - self.offset_m[0], offset_m[1] - self.offset_m[1], height_m - self.height_m)
        waited_s = (t_ns - self._since_ns) / NS_PER_S
        if away_m < REACHED_M or waited_s > CORNER_TIMEOUT_S:
            self._number += 1
            self._since_ns = t_ns
            self._aim()

    def _aim(self) -> None:
        """Set the next corner; each round begins over the middle, and goes around it higher than the one before."""
        config = self._config
        turn, corner = divmod(self._number, CORNERS + 1)
        self.over = turn >= config.tries
        up_m = CLIMB_M * (turn + (corner > 0))
        self.height_m = max(self._height_start_m, min(self._height_start_m + up_m, config.height_max_m))
        radius_m = 0.0 if corner == 0 else config.radius_m * (turn + 1)
        angle_rad = 2.0 * pi * (corner - 1) / CORNERS
        self.offset_m = (radius_m * cos(angle_rad), radius_m * sin(angle_rad))


def towards(offset_m: tuple[float, float, float], speed_mps: float, gain_1ps: float = 0.8) -> Vec3:
    """Velocity along an offset, proportional to its length and limited."""
    length_m = hypot(*offset_m)
    pull_1ps = min(gain_1ps, speed_mps / max(length_m, 1e-9))
    return (pull_1ps * offset_m[0], pull_1ps * offset_m[1], pull_1ps * offset_m[2])
