"""Those flight modes of PX4 that this autopilot has."""

from enum import Enum


class Mode(Enum):
    """Flight mode; the value is its name for people, `custom_mode` its number in MAVLink."""

    POSITION = "position"
    TAKEOFF = "takeoff"
    HOLD = "hold"
    RETURN = "return"
    LAND = "land"
    DESCEND = "descend"
    """Landing without a valid position; in MAVLink it has the number of land."""
    OFFBOARD = "offboard"

    @property
    def custom_mode(self) -> int:
        """Number of the mode in HEARTBEAT."""
        main, sub = MAIN_AND_SUB[self]
        return main << 16 | sub << 24


MAIN_AND_SUB = {
    Mode.POSITION: (3, 0),
    Mode.TAKEOFF: (4, 2),
    Mode.HOLD: (4, 3),
    Mode.RETURN: (4, 5),
    Mode.LAND: (4, 6),
    Mode.DESCEND: (4, 6),
    Mode.OFFBOARD: (6, 0),
}
FROM_MAIN_AND_SUB = {pair: mode for mode, pair in MAIN_AND_SUB.items() if mode is not Mode.DESCEND}
"""Modes that a command can request."""
DOWN = (Mode.LAND, Mode.DESCEND, Mode.RETURN)
"""Modes that end with a landing; arming is refused in them."""
