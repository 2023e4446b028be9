"""Optional packages, and the extra of jezero that installs each: the client alone needs none of them."""

from importlib.util import find_spec

EXTRAS = {
    "click": "cli", "rich": "cli", "yaml": "cli", "PIL": "cli", "mcap": "cli", "zstandard": "cli", "numpy": "cli",
    "defusedxml": "cli", "shapefile": "cli",
    "pyproj": "gis",
    "foxglove": "foxglove",
    "matplotlib": "report", "shapely": "report",
    "nicegui": "ground", "uvicorn": "ground", "fastapi": "ground", "starlette": "ground", "itsdangerous": "ground",
    "argon2": "ground", "websockets": "ground",
    "scipy": "services", "pymavlink": "services", "fastcrc": "services", "filterpy": "services", "cv2": "services",
    "pupil_apriltags": "services", "serial": "services", "pynmeagps": "services",
    "pybullet": "sim", "moderngl": "sim",
}  # fmt: skip
"""Extra of each optional package, by the name that is imported."""


class MissingExtraError(ModuleNotFoundError):
    """An optional package is not installed; the message names the extra that installs it."""


def extra_hint(module: str | None) -> str:
    """How to install an optional package, as the end of a sentence; "" for a package of no extra.

    Args:
        module: the name of a module that was not found, such as `PIL.Image`.
    """
    package = (module or "").partition(".")[0]
    extra = EXTRAS.get(package)
    return "" if extra is None else f"needs {package}, which is not installed: pip install 'jezero[{extra}]'"


def require(purpose: str, *packages: str) -> None:
    """Check that optional packages are installed, without importing them.

    Args:
        purpose: what needs them, such as `jezero.recording`.

    Raises:
        MissingExtraError: one is not.
    """
    for package in packages:
        if find_spec(package) is None:
            raise MissingExtraError(f"{purpose} {extra_hint(package)}", name=package)
