"""PX4's flight modes, as far as this autopilot has them."""

from enum import Enum


class Mode(Enum):
    """The value is the word for people; `custom_mode` is MAVLink's."""

    POSITION = "position"
    TAKEOFF = "takeoff"
    HOLD = "hold"
    RETURN = "return"
    LAND = "land"
    DESCEND = "descend"
    """Landing without a position; MAVLink knows it as land."""
    OFFBOARD = "offboard"

    @property
    def custom_mode(self) -> int:
        """As HEARTBEAT carries it."""
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
"""What can be asked for."""
DOWN = (Mode.LAND, Mode.DESCEND, Mode.RETURN)
"""Modes that end on the ground: nothing takes off in them."""
