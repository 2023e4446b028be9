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
    "pybullet": "sim", "moderngl": "sim", "trimesh": "sim",
    "rosbags": "ros2",
}  # fmt: skip
"""Extra of each optional package, by the name that is imported."""
INCLUDED = {"cli", "foxglove", "gis", "report", "ros2", "services"}
"""The extras that the extra `sim` includes; all others but `dev` and `docs` include `cli`."""


class MissingExtraError(ModuleNotFoundError):
    """An optional package is not installed; the message names the extra that installs it."""


def pip_command(*extras: str) -> str:
    """The command that installs extras, which may be several separated by commas."""
    names = {name for extra in extras for name in extra.split(",") if name}
    for name in tuple(names):
        names -= INCLUDED if name == "sim" else {"cli"} if name != "cli" else set()
    return f"pip install 'jezero[{','.join(sorted(names))}]'"


def extra_hint(*modules: str | None, extras: str = "") -> str:
    """How to install optional packages, as the end of a sentence; "" where none of them is in an extra.

    Args:
        modules: names of modules that were not found, such as `PIL.Image`.
        extras: extras, separated by commas, that are needed too.
    """
    packages = [package for module in modules if (package := (module or "").partition(".")[0]) in EXTRAS]
    if not packages:
        return ""
    command = pip_command(*(EXTRAS[package] for package in packages), extras)
    return f"needs {' and '.join(packages)}, which {'is' if len(packages) == 1 else 'are'} not installed: {command}"


def require(purpose: str, *packages: str) -> None:
    """Check that optional packages are installed, without importing them.

    Args:
        purpose: what needs them, such as `jezero.recording`.

    Raises:
        MissingExtraError: one is not.
    """
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        raise MissingExtraError(f"{purpose} {extra_hint(*missing)}", name=missing[0])
