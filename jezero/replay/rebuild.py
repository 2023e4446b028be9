"""A service made again as it was when it was recorded, or with some of its settings changed."""

import inspect
from collections.abc import Mapping
from importlib import import_module
from typing import Any, cast, get_type_hints

import msgspec

from jezero.base.config import ConfigError
from jezero.base.mistakes import mistake, unknown
from jezero.base.plugins import PluginError
from jezero.recording.journals import ServiceRun, leaves
from jezero.recording.mcap_file import RecordingError
from jezero.runtime.service import Service
from jezero.services.table import ACTION, resolve, services

PLANET = frozenset({"gravity_mps2", "density_air_kgpm3"})
"""Settings that the simulator had, and the vehicle has now, in `planet`."""


class SettingError(ValueError):
    """A setting can't be changed; the text says why, and what to give."""


class OwnClassError(ValueError):
    """A class of one's own can't be replayed; the text says why, and what to do.

    Its cause is what the code of the class raised, if it did.
    """


def load_class(path: str) -> type[Service]:
    """The class of a service of one's own.

    Args:
        path: `module:class`, such as `my_package.filters:Mhe`.

    Raises:
        OwnClassError: there is no such class, or it can't be imported.
    """
    module, _, name = path.partition(":")
    if not (module and name):
        raise OwnClassError(f"{path!r} is no class: give module:class, such as my_estimator:MyEstimator")
    try:
        found = getattr(import_module(module), name, None)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise OwnClassError(f"{module} can't be imported: {error}") from error
        raise OwnClassError(
            f"there is no module {error.name!r}: give one of an installed package, or of a file in this folder"
        ) from None
    except Exception as error:
        raise OwnClassError(f"{module} can't be imported: {type(error).__name__}: {error}") from error
    if not (inspect.isclass(found) and callable(getattr(found, "step", None))):
        raise OwnClassError(f"{module} has no class {name!r} with a method `step`")
    return cast(type[Service], found)


def make_service(run: ServiceRun, changes: Mapping[str, str], own: type[Service] | None = None) -> Service:
    """Make a service again as it was recorded, with some settings changed.

    Args:
        run: the recorded run of the service.
        changes: see `changed`.
        own: class to make it from; it gets the recorded arguments that its constructor has. None: jezero's own.

    Raises:
        RecordingError: this version of jezero can't make it.
        SettingError: there is no such setting, or a value is out of range.
        OwnClassError: `own` doesn't take the arguments, or raises.
    """
    if own is not None:
        return _make_own(own, run, changes)
    name = run.service
    if not _is_of_jezero(run):
        raise RecordingError(_foreign(run))
    maker = resolve((services().get(name) or ACTION).maker)
    hints = get_type_hints(maker.__init__ if inspect.isclass(maker) else maker)
    made_with = changed(_with_planet(run.made_with), changes)
    if strange := [each for each in made_with if each not in hints]:
        raise RecordingError(f"this version of jezero makes {name!r} without the recorded argument {strange[0]!r}")
    arguments = {each: _converted(name, value, hints[each]) for each, value in made_with.items()}
    parameters = inspect.signature(maker).parameters.values()
    if missing := [each.name for each in parameters if each.default is each.empty and each.name not in arguments]:
        raise RecordingError(f"this version of jezero can't make {name!r} without {', '.join(missing)}: not recorded")
    try:
        service: Service = maker(**arguments)
    except ConfigError as error:
        raise SettingError(str(error)) from None
    except PluginError as error:
        raise RecordingError(str(error)) from None
    return service


def _with_planet(made_with: Mapping[str, Any]) -> Mapping[str, Any]:
    """Recorded arguments, those of an older recording with gravity and air moved to the vehicle's settings."""
    for name in ("config", "simulator"):
        settings, vehicle = made_with.get(name), made_with.get("vehicle")
        if isinstance(settings, dict) and isinstance(vehicle, dict) and (moved := PLANET.intersection(settings)):
            kept = {each: value for each, value in settings.items() if each not in moved}
            planet = {each: settings[each] for each in moved}
            return {**made_with, name: kept, "vehicle": {**vehicle, "planet": planet}}
    return made_with


def _converted(service: str, value: Any, kind: Any) -> Any:
    """A recorded argument of a service, or one that was changed, as its type."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise SettingError(f"{service}: {mistake(error, kind, 'setting')}") from None


def _is_of_jezero(run: ServiceRun) -> bool:
    """Whether a recorded service is one of jezero, or an action server; these all record their arguments."""
    if run.made_by.partition(".")[0] != "jezero" and (run.made_by or not run.made_with):
        return False
    return run.service in services() or run.made_with.get("name") == run.service


def _foreign(run: ServiceRun) -> str:
    """Reason why a service that is not jezero's isn't replayed, with what to give."""
    module, _, name = run.made_by.partition(":")
    if not name:
        return f"the recorded {run.service!r} is not jezero's: name its class with --class module:class"
    if module == "__main__":
        return (
            f"the recorded {run.service!r} is the class {name} of a program: name it with --class module:{name}, where "
            "the module is the program's file without .py"
        )
    return f"the recorded {run.service!r} is not jezero's: name its class with --class {run.made_by}"


def _make_own(own: type[Service], run: ServiceRun, changes: Mapping[str, str]) -> Service:
    """Make a service of one's own from those recorded arguments that its constructor has."""
    shown = f"{own.__module__}:{own.__qualname__}"
    try:
        parameters, hints = inspect.signature(own).parameters, get_type_hints(own.__init__)
    except (NameError, TypeError, ValueError) as error:
        raise OwnClassError(f"the arguments of {shown} are unknown: {error}") from error
    made_with = changed({each: value for each, value in run.made_with.items() if each in parameters}, changes)
    arguments = {
        each: _converted(run.service, value, hints.get(each, _type_of_default(parameters[each])))
        for each, value in made_with.items()
    }
    missing = [
        each.name
        for each in parameters.values()
        if each.default is each.empty
        and each.name not in arguments
        and each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD)
    ]
    if missing:
        raise OwnClassError(
            f"{shown} needs {', '.join(missing)}, which the recording doesn't have: give a default, and record the "
            "arguments in made_with of its Spec"
        )
    try:
        service = own(**arguments)
        name = service.spec.name
    except Exception as error:
        raise OwnClassError(f"{shown} can't be made: {type(error).__name__}: {error}") from error
    if name != run.service:
        raise OwnClassError(f"{shown} is the service {name!r} by its Spec, not {run.service!r}")
    return service


def _type_of_default(parameter: inspect.Parameter) -> Any:
    """Type of an argument without a hint: that of its default."""
    return Any if parameter.default in (parameter.empty, None) else type(parameter.default)


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
            if not names:
                raise SettingError(f"{name} is no setting of this service; none is recorded: see made_with of its Spec")
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
