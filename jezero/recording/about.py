"""What a recording says about its origin."""

import subprocess
from functools import cache
from importlib.metadata import version
from pathlib import Path

from jezero.base.config import ConfigError, config_directory, world_file
from jezero.base.files import NOT_UTF8, describe_os_error


def about(**extra: str) -> dict[str, str]:
    """Metadata of a recording: version and commit of jezero, the settings files, the world, and the fields given.

    Raises:
        ConfigError: a settings file can't be read.
    """
    settings, world = {}, world_file()
    files = {f"settings/{path.name}": path for path in sorted(config_directory().glob("*.toml"))}
    if world is not None:
        extra["world"] = world.stem
        files[f"settings/worlds/{world.name}"] = world
    for name, path in files.items():
        try:
            settings[name] = path.read_text(encoding="utf-8")
        except OSError as error:
            raise ConfigError(describe_os_error(error)) from None
        except UnicodeDecodeError:
            raise ConfigError(f"{path} {NOT_UTF8}") from None
    return {"version": version("jezero"), "commit": commit(), **extra, **settings}


@cache
def commit() -> str:
    """Commit of the checkout that runs, with `-dirty` for one with changes; "" outside of a checkout."""
    folder = Path(__file__).parent
    words = ("git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*")
    try:
        found = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False, timeout=5.0)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return found.stdout.strip() if found.returncode == 0 else ""
