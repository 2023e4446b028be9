"""A service made again as it was when it was recorded, or with some of its settings changed."""

import inspect
from collections.abc import Mapping
from typing import Any, get_type_hints

import msgspec

from jezero.base.mistakes import mistake, unknown
from jezero.base.plugins import PluginError
from jezero.recording.journals import leaves
from jezero.recording.mcap_file import RecordingError
from jezero.runtime.service import Service
from jezero.services.table import ACTION, resolve, services


class SettingError(ValueError):
    """A setting can't be changed; the text says why, and what to give."""


def make_service(name: str, made_with: Mapping[str, Any]) -> Service:
    """Make a service from its recorded arguments.

    Args:
        name: name of the service.
        made_with: arguments as they were recorded, see `changed`.

    Raises:
        RecordingError: this version of jezero can't make it from them.
        SettingError: a value is out of range.
    """
    row = services().get(name) or (ACTION if made_with.get("name") == name else None)
    if row is None:
        raise RecordingError(f"{name!r} is neither an action server nor a service that this version can replay")
    maker = resolve(row.maker)
    hints = get_type_hints(maker.__init__ if inspect.isclass(maker) else maker)
    if strange := [each for each in made_with if each not in hints]:
        raise RecordingError(f"this version of jezero makes {name!r} without the recorded argument {strange[0]!r}")
    arguments = {}
    for each, value in made_with.items():
        try:
            arguments[each] = msgspec.convert(value, hints[each])
        except msgspec.ValidationError as error:
            raise SettingError(f"{name}: {mistake(error, hints[each], 'setting')}") from None
    parameters = inspect.signature(maker).parameters.values()
    if missing := [each.name for each in parameters if each.default is each.empty and each.name not in arguments]:
        raise RecordingError(f"this version of jezero can't make {name!r} without {', '.join(missing)}: not recorded")
    try:
        service: Service = maker(**arguments)
    except PluginError as error:
        raise RecordingError(str(error)) from None
    return service


def changed(made_with: Mapping[str, Any], changes: Mapping[str, str]) -> dict[str, Any]:
    """Copy of recorded arguments with other settings.

    Args:
        made_with: arguments as they were recorded.
        changes: values as TOML, by the setting's name, such as `std_uwb_m`; where several settings have this name, by
            the end of the path that makes it the only one, such as `tuning.std_uwb_m`.

    Raises:
        SettingError: there is no such setting, or there are several, or the value is not TOML.
    """
    arguments: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(made_with))
    paths = {".".join(path): path for path, _ in leaves(arguments)}
    for name, text in changes.items():
        found = [path for path in paths if path == name or path.endswith(f".{name}")]
        if not found:
            names = sorted({path.rpartition(".")[2] for path in paths})
            raise SettingError(unknown("setting", name.rpartition(".")[2], names))
        if len(found) > 1:
            raise SettingError(f"{name} is the name of several settings: give one of {', '.join(found)}")
        try:
            value = msgspec.toml.decode(f"value = {text}")["value"]
        except msgspec.DecodeError:
            raise SettingError(f'{name}={text}: {text!r} is no value of TOML, such as 0.05, true or "text"') from None
        *parents, last = paths[found[0]]
        table = arguments
        for parent in parents:
            table = table[parent]
        table[last] = value
    return arguments
