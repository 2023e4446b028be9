"""The missions that come with jezero."""

from importlib import import_module
from pathlib import Path

from jezero.mission_files.reader import read_mission
from jezero.schemas.mission import Mission
from jezero.schemas.topics import ACTIONS

FOLDER = "missions"


def shipped_names() -> list[str]:
    """Names of the missions that come with jezero."""
    return sorted(path.stem for path in _folder().glob("*.yaml"))


def shipped_file(name: str) -> Path:
    """The file of a mission that comes with jezero."""
    return _folder() / f"{name}.yaml"


def shipped_mission(name: str) -> Mission:
    """Read a mission that comes with jezero. Its areas are in metres, and its actions are jezero's own."""
    return read_mission(shipped_file(name), actions=ACTIONS).mission


def _folder() -> Path:
    return Path(import_module("jezero.deploy").__path__[0]) / FOLDER
