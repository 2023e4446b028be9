"""One frozen struct per service, read once from `deploy/config/<name>.toml`.

A world is one file more, such as `deploy/config/worlds/mars.toml`: a table for each file of settings that it changes.
"""

import os
import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec

from jezero.base.files import NOT_UTF8, describe_os_error
from jezero.base.mistakes import mistake, unknown

S = TypeVar("S", bound=msgspec.Struct)


class Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every service's settings: unknown fields and values out of range are refused."""


class ConfigError(ValueError):
    """A setting is wrong; the message names the file, the field and the expected value."""


def config_directory() -> Path:
    """`JEZERO_CONFIG_DIR` if it is set, otherwise the folder that jezero ships."""
    given = os.environ.get("JEZERO_CONFIG_DIR")
    return Path(given) if given else _shipped_directory()


def _shipped_directory() -> Path:
    return Path(import_module("jezero.deploy").__path__[0]) / "config"


def settings_path(file: str) -> Path:
    """Path of a file that a setting names: as it is, in the folder of the settings, or in the one that jezero ships."""
    path = config_directory() / file
    shipped = _shipped_directory() / file
    return shipped if shipped.is_file() and not path.is_file() else path


def load_config(kind: type[S], name: str, directory: Path | None = None) -> S:
    """Read `<name>.toml`, and what the chosen world changes in it; missing fields get their defaults.

    Args:
        directory: folder of the settings, which no world changes; None for `config_directory` and the chosen world.

    Raises:
        ConfigError: the file is missing or malformed, a field is unknown or out of range, or there is no such world.
    """
    path = (directory or config_directory()) / f"{name}.toml"
    world = None if directory else world_file()
    changes = None if world is None else _read_world(world).get(name)
    try:
        if changes is None:
            return msgspec.toml.decode(path.read_bytes(), type=kind)
        merged = _merged(tomllib.loads(path.read_text(encoding="utf-8")), changes)
        return msgspec.convert(merged, type=kind)
    except FileNotFoundError:
        raise ConfigError(f"{path} is missing: each service reads its settings from there") from None
    except OSError as error:
        raise ConfigError(describe_os_error(error)) from None
    except msgspec.ValidationError as error:
        source = f"{path}" if changes is None else f"{path} with the table [{name}] of {world}"
        raise ConfigError(f"{source}: {mistake(error, kind, 'setting')}") from error
    except UnicodeDecodeError:
        raise ConfigError(f"{path} {NOT_UTF8}") from None
    except (msgspec.DecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: {error}") from error


# -- worlds ----------------------------------------------------------------------------------------------

WORLD_VARIABLE = "JEZERO_WORLD"


def world_file() -> Path | None:
    """File of the chosen world; None without any.

    Raises:
        ConfigError: there is no such world.
    """
    given = os.environ.get(WORLD_VARIABLE)
    return find_world(given) if given else None


def find_world(name: str) -> Path:
    """File of a world by its name, or by its path.

    Args:
        name: of a file in the folder `worlds` of the settings, without `.toml`, or the path of a file.

    Raises:
        ConfigError: there is no such world.
    """
    if name.endswith(".toml"):
        path = Path(name)
        if not path.is_file():
            raise ConfigError(f"{name} is no file: a world is the path of a .toml file, or one of {_known_words()}")
        return path.resolve()
    worlds = known_worlds()
    if name not in worlds:
        raise ConfigError(f"{unknown('world', name, sorted(worlds))}, or the path of a .toml file")
    return worlds[name]


def known_worlds() -> dict[str, Path]:
    """Files of the worlds by name; those beside the settings in use hide shipped ones of the same name."""
    folders = (_shipped_directory() / "worlds", config_directory() / "worlds")
    return {path.stem: path for folder in folders for path in sorted(folder.glob("*.toml"))}


def _known_words() -> str:
    return ", ".join(sorted(known_worlds())) or "none"


def _read_world(path: Path) -> dict[str, Any]:
    """Tables of a world by the names of the files of settings that they change.

    Raises:
        ConfigError: the file is malformed, or a table has the name of no file of settings.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(describe_os_error(error)) from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path} {NOT_UTF8}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: {error}") from error
    names = sorted(file.stem for file in config_directory().glob("*.toml"))
    for name, table in tables.items():
        if name not in names:
            raise ConfigError(f"{path}: {unknown('file of settings', name, names)}")
        if not isinstance(table, dict):
            raise ConfigError(f"{path}: {name} must be a table, [{name}]: the changes of {name}.toml")
    return tables


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """The settings with the changes: tables are merged, everything else is replaced."""
    merged = dict(base)
    for key, value in changes.items():
        before = merged.get(key)
        merged[key] = _merged(before, value) if isinstance(before, dict) and isinstance(value, dict) else value
    return merged


class _AutopilotChoice(msgspec.Struct, frozen=True):
    """The one field of `autopilot.toml` that others than the autopilot need."""

    autopilot: Literal["embedded", "px4"] = "embedded"


def chosen_autopilot() -> str:
    """The autopilot that the stack runs, "embedded" or "px4": `JEZERO_AUTOPILOT`, else that of `autopilot.toml`.

    Raises:
        ConfigError: there is no such autopilot, or the file is missing or malformed.
    """
    given = os.environ.get("JEZERO_AUTOPILOT")
    if given and given not in ("embedded", "px4"):
        raise ConfigError(f'JEZERO_AUTOPILOT is "{given}", expected "embedded" or "px4"')
    return given or load_config(_AutopilotChoice, "autopilot").autopilot
