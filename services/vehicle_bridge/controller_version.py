"""Which versions of PX4 a real flight controller may have, by its AUTOPILOT_VERSION."""

VERSION_MIN = (1, 15)
"""Oldest PX4 that was flown. Older ones are refused: the vehicle is landed by their failsafes when this computer fails,
and nobody should learn in flight whether they do."""
VERSION_MAX = (1, 18)
"""Newest PX4 that was flown, as its development version of March 2026. A newer one may fly: what the bridge needs of it
has been the same through all of these, and what is missing is named."""


def version_text(version: int) -> str:
    """Name of a version for people, with a warning about one that wasn't flown.

    Args:
        version: AUTOPILOT_VERSION.flight_sw_version: major, minor, patch and type, a byte each.
    """
    if version == 0:
        return "the flight controller doesn't name its version"
    major, minor, patch = version >> 24, version >> 16 & 0xFF, version >> 8 & 0xFF
    name = f"PX4 {major}.{minor}.{patch}"
    if (major, minor) > VERSION_MAX:
        return f"{name}, which jezero was not tried with: try everything with the propellers off first"
    return name


def version_refusal(version: int | None) -> str:
    """Reason why nothing takes off with this version, or "".

    Args:
        version: as in `version_text`; None while it isn't known.
    """
    if not version or (version >> 24, version >> 16 & 0xFF) >= VERSION_MIN:
        return ""
    oldest = ".".join(map(str, VERSION_MIN))
    return f"the flight controller has {version_text(version)}, which was never tried: install {oldest} or newer"
