"""One frozen struct per service, read once from `deploy/config/<name>.toml`."""

import os
from importlib import import_module
from pathlib import Path
from typing import Literal, TypeVar

import msgspec

from jezero.base.files import describe_os_error
from jezero.base.mistakes import mistake

S = TypeVar("S", bound=msgspec.Struct)


class Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every service's settings: unknown fields and values out of range are refused."""


class ConfigError(ValueError):
    """A setting is wrong; the message names the file, the field and the expected value."""


def config_directory() -> Path:
    """`JEZERO_CONFIG_DIR` if it is set, otherwise the folder that jezero ships."""
    given = os.environ.get("JEZERO_CONFIG_DIR")
    return Path(given) if given else Path(import_module("jezero.deploy").__path__[0]) / "config"


def load_config(kind: type[S], name: str, directory: Path | None = None) -> S:
    """Read `<name>.toml`; missing fields get their defaults.

    Raises:
        ConfigError: the file is missing or malformed, or a field is unknown or out of range.
    """
    path = (directory or config_directory()) / f"{name}.toml"
    try:
        return msgspec.toml.decode(path.read_bytes(), type=kind)
    except FileNotFoundError:
        raise ConfigError(f"{path} is missing: each service reads its settings from there") from None
    except OSError as error:
        raise ConfigError(describe_os_error(error)) from None
    except msgspec.ValidationError as error:
        raise ConfigError(f"{path}: {mistake(error, kind, 'setting')}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: {error}") from error


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
