"""The name of a vehicle, which is a part of its keys on the bus: a wildcard would be the name of every vehicle."""

import re

from jezero.schemas.struct import END

NAME_PATTERN = rf"^[A-Za-z0-9_-]{{1,32}}{END}"
NAME_EXPECTED = "expected 1 to 32 letters, digits, '-' and '_'"


def checked_vehicle(name: object) -> str:
    """The name, which is one that a vehicle can have.

    Raises:
        ValueError: it is another one, or no text; the message shows it and what is expected.
    """
    if not (isinstance(name, str) and re.search(NAME_PATTERN, name)):
        raise ValueError(f"the vehicle's name is {name!r}: {NAME_EXPECTED}")
    return name
