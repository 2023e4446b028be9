"""Parser of the part of the Compose Specification that plain processes need, and the order of their start.

Source: https://github.com/compose-spec/compose-spec/blob/main/spec.md
"""

import re
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import yaml

from jezero.services.table import ACTION

Condition = Literal["service_started", "service_healthy"]
Restart = Literal["no", "always", "on-failure", "unless-stopped"]

_SERVICE_KEYS = {
    "command", "environment", "depends_on", "healthcheck", "restart", "stop_grace_period", "profiles",
    "scale", "image", "build", "network_mode", "read_only", "cap_drop", "security_opt", "tmpfs", "volumes",
}  # fmt: skip
"""Those from `image` on are for container runtimes; plain processes do not use them."""
_HEALTHCHECK_KEYS = {"test", "interval", "timeout", "retries", "start_period", "disable"}
_NAME = re.compile(r"[a-zA-Z0-9._-]+")
_DURATION = re.compile(r"(?:\d+(?:\.\d+)?(?:us|ms|s|m|h))+")
_DURATION_PART = re.compile(r"(\d+(?:\.\d+)?)(us|ms|s|m|h)")
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "m": 60.0, "h": 3600.0}
_VARIABLE = re.compile(
    r"\$(?:(?P<escaped>\$)|(?P<plain>[A-Za-z_]\w*)"
    r"|\{(?P<name>[A-Za-z_]\w*)(?:(?P<operator>:?[-?+])(?P<word>[^}$]*))?\}|(?P<bad>))"
)
_DEFAULT_GRACE_S = 10.0


class ComposeError(ValueError):
    """The file is invalid; the message names the service and the field."""


@dataclass(frozen=True, kw_only=True)
class ComposeService:
    """One service, run as a process.

    Attributes:
        name: name of the service.
        command: program and arguments.
        environment: variables added to the launcher's own.
        depends_on: condition that each named service must meet before this one starts.
        optional: services of `depends_on` that may be missing or fail (`required: false`).
        has_healthcheck: whether it is ready only when it reports itself healthy.
        restart: when it is restarted.
        max_retries: number of restarts that `on-failure:N` allows; None for any number.
        stop_grace_s: time between SIGTERM and SIGKILL.
        profiles: profiles that it belongs to; an empty tuple belongs to all.
        only_with_profile: whether it runs only where one of its profiles is named (`x-only-with-profile`).
    """

    name: str
    command: tuple[str, ...]
    environment: Mapping[str, str]
    depends_on: Mapping[str, Condition]
    optional: frozenset[str] = frozenset()
    has_healthcheck: bool = False
    restart: Restart = "no"
    max_retries: int | None = None
    stop_grace_s: float = _DEFAULT_GRACE_S
    profiles: tuple[str, ...] = ()
    only_with_profile: bool = False


def parse(text: str, variables: Mapping[str, str]) -> dict[str, ComposeService]:
    """Parse a compose file; returns the services by name, in the file's order.

    Args:
        text: content of the file, YAML.
        variables: values of `${NAME}`.

    Raises:
        ComposeError: the text is not valid YAML, or a field is unknown or invalid.
    """
    try:
        document = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ComposeError(f"not YAML: {error}") from error
    if not isinstance(document, dict) or not isinstance(document.get("services"), dict):
        raise ComposeError("services: expected a mapping of service names")
    for key in document:
        if key not in ("name", "version", "services", "volumes") and not str(key).startswith("x-"):
            raise ComposeError(f"{key}: not supported; only name, services, volumes and x-… are")
    services = {
        str(name): _service(str(name), _interpolate(f"services.{name}", fields, variables))
        for name, fields in document["services"].items()
    }
    for name, fields in document["services"].items():
        if _scale(f"services.{name}.scale", fields, variables) == 0:
            del services[str(name)]
    services = _without_missing(services)
    for service in services.values():
        _check_dependencies(service, services)
    in_levels(services)
    return services


def _without_missing(services: Mapping[str, ComposeService]) -> dict[str, ComposeService]:
    """The services without the optional dependencies that are not among them."""

    def is_there(dependency: str, service: ComposeService) -> bool:
        return dependency in services or dependency not in service.optional

    return {
        name: replace(service, depends_on={d: c for d, c in service.depends_on.items() if is_there(d, service)})
        for name, service in services.items()
    }


def with_actions(services: Mapping[str, ComposeService], names: Iterable[str]) -> dict[str, ComposeService]:
    """The services, and for each name the server of an action that an installed package adds.

    A new server is like the first action server of the file; a file without one gets none.
    """
    pattern = next((s for s in services.values() if s.command[-2:] == (ACTION.module, s.name)), None)
    added = {} if pattern is None else {name: _like(pattern, name) for name in names if name not in services}
    return {**services, **added}


def _like(pattern: ComposeService, name: str) -> ComposeService:
    return replace(pattern, name=name, command=(*pattern.command[:-1], name))


def at_bus(services: Mapping[str, ComposeService], bus: str, run_folder: str, router: str) -> dict[str, ComposeService]:
    """The services with the variables that depend on this run: the bus at which they meet, and the run folder.

    Args:
        bus: address of the router for services.
        run_folder: path of the run folder.
        router: name of the router, which has the address for people's programs in that variable.
    """
    return {
        name: replace(
            service,
            environment={
                **service.environment,
                "JEZERO_RUN_DIR": run_folder,
                **({} if name == router else {"JEZERO_ROUTER": bus}),
            },
        )
        for name, service in services.items()
    }


def shipped_compose_file() -> Path:
    """The compose file that comes with jezero."""
    return Path(__file__).resolve().parents[1] / "compose.yaml"


def select(services: Mapping[str, ComposeService], profiles: Iterable[str] = ()) -> dict[str, ComposeService]:
    """Services of the given profiles and those without a profile.

    If no profile is given: all services but those that run only with a profile.

    Raises:
        ComposeError: a profile does not exist, or a selected service depends on one that is not selected.
    """
    wanted = set(profiles)
    known = {profile for service in services.values() for profile in service.profiles}
    if unknown := sorted(wanted - known):
        raise ComposeError(f"no service has the profile {', '.join(unknown)}; there are {', '.join(sorted(known))}")
    chosen = {
        name: service
        for name, service in services.items()
        if wanted.intersection(service.profiles) or not service.profiles or not (wanted or service.only_with_profile)
    }
    chosen = _without_missing(chosen)
    for service in chosen.values():
        for dependency in service.depends_on:
            if dependency not in chosen:
                raise ComposeError(
                    f"services.{service.name}.depends_on: {dependency} is in none of the profiles {sorted(wanted)}"
                )
    return chosen


def in_levels(services: Mapping[str, ComposeService]) -> list[list[str]]:
    """Names of the services in levels, each of which depends on earlier levels only.

    Raises:
        ComposeError: services depend on each other in a circle.
    """
    left = dict(services)
    levels: list[list[str]] = []
    while left:
        level = [name for name, service in left.items() if not any(d in left for d in service.depends_on)]
        if not level:
            raise ComposeError(f"depends_on: services wait for each other: {' → '.join(_circle(left))}")
        levels.append(level)
        for name in level:
            del left[name]
    return levels


def _circle(services: Mapping[str, ComposeService]) -> list[str]:
    """Path along dependencies from a service back to itself; each given service depends on another given one."""
    walk = [next(iter(services))]
    while True:
        following = next(d for d in services[walk[-1]].depends_on if d in services)
        if following in walk:
            return [*walk[walk.index(following) :], following]
        walk.append(following)


def _check_dependencies(service: ComposeService, services: Mapping[str, ComposeService]) -> None:
    for dependency, condition in service.depends_on.items():
        where = f"services.{service.name}.depends_on.{dependency}"
        if dependency not in services:
            raise ComposeError(f"{where}: there is no such service")
        if condition == "service_healthy" and not services[dependency].has_healthcheck:
            raise ComposeError(f"{where}: {dependency} has no healthcheck, so it never becomes healthy")


def _interpolate(where: str, value: Any, variables: Mapping[str, str]) -> Any:
    """Replace `$NAME`, `${NAME}`, `${NAME:-default}` and similar forms in every string."""
    if isinstance(value, dict):
        return {key: _interpolate(f"{where}.{key}", item, variables) for key, item in value.items()}
    if isinstance(value, list):
        return [_interpolate(f"{where}[{i}]", item, variables) for i, item in enumerate(value)]
    if isinstance(value, str):
        return _VARIABLE.sub(lambda match: _variable(where, match, variables), value)
    return value


def _variable(where: str, match: re.Match[str], variables: Mapping[str, str]) -> str:
    """Value of one `$…`. With a colon in the operator an empty variable counts as unset."""
    if match["escaped"]:
        return "$"
    if match["bad"] is not None:
        raise ComposeError(f"{where}: malformed variable, or one within another; write $$ for a dollar sign")
    name, operator, word = match["plain"] or match["name"], match["operator"] or "", match["word"] or ""
    given = variables.get(name)
    unset = given is None or (operator.startswith(":") and not given)
    if operator.endswith("+"):
        return "" if unset else word
    if not unset:
        return given or ""
    if operator.endswith("-"):
        return word
    if operator.endswith("?"):
        raise ComposeError(f"{where}: {name} is not set: {word or 'required'}")
    return ""


def _service(name: str, fields: Any) -> ComposeService:
    where = f"services.{name}"
    if not _NAME.fullmatch(name):
        raise ComposeError(f"{where}: a name consists of letters, digits, '.', '_' and '-'")
    if not isinstance(fields, dict):
        raise ComposeError(f"{where}: expected a mapping of fields")
    for key in fields:
        if key not in _SERVICE_KEYS and not str(key).startswith("x-"):
            raise ComposeError(f"{where}.{key}: not supported; there are {', '.join(sorted(_SERVICE_KEYS))}")
    restart, max_retries = _restart(f"{where}.restart", fields.get("restart", "no"))
    depends_on, optional = _depends_on(f"{where}.depends_on", fields.get("depends_on", {}))
    return ComposeService(
        name=name,
        command=_command(f"{where}.command", fields.get("command")),
        environment=_environment(f"{where}.environment", fields.get("environment", {})),
        depends_on=depends_on,
        optional=optional,
        has_healthcheck=_has_healthcheck(f"{where}.healthcheck", fields.get("healthcheck")),
        restart=restart,
        max_retries=max_retries,
        stop_grace_s=_duration_s(f"{where}.stop_grace_period", fields.get("stop_grace_period", "10s")),
        profiles=_strings(f"{where}.profiles", fields.get("profiles", [])),
        only_with_profile=_flag(f"{where}.x-only-with-profile", fields.get("x-only-with-profile", False)),
    )


def _scale(where: str, fields: Mapping[str, Any], variables: Mapping[str, str]) -> int:
    """Number of processes of a service: 1, or 0 for a service that is turned off."""
    given = fields.get("scale", 1)
    value = str(_interpolate(where, given, variables))
    if value not in ("0", "1"):
        raise ComposeError(f"{where}: {given} is {value!r}, expected 0 (off) or 1 (on)")
    return int(value)


def _flag(where: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ComposeError(f"{where}: expected true or false, got {value!r}")
    return value


def _strings(where: str, value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ComposeError(f"{where}: expected a list of strings, got {value!r}")
    return tuple(value)


def _command(where: str, value: Any) -> tuple[str, ...]:
    """Program and arguments; a string is split as a shell would, without running a shell."""
    if isinstance(value, str):
        try:
            value = shlex.split(value)
        except ValueError as error:
            raise ComposeError(f"{where}: {error}") from error
    if not value:
        raise ComposeError(f"{where}: missing; a plain process has no image to take it from")
    return _strings(where, value)


def _environment(where: str, value: Any) -> dict[str, str]:
    """Variables from a mapping or a list of `NAME=value`; those without a value are inherited."""
    if isinstance(value, list):
        pairs = [str(item).partition("=") for item in value]
        return {name: text for name, equals, text in pairs if equals}
    if not isinstance(value, dict):
        raise ComposeError(f"{where}: expected a mapping or a list, got {value!r}")
    for name, text in value.items():
        if isinstance(text, bool) or not isinstance(text, str | int | float | None):
            raise ComposeError(f"{where}.{name}: expected text or a number, got {text!r}; put it in quotes")
    return {str(name): str(text) for name, text in value.items() if text is not None}


def _depends_on(where: str, value: Any) -> tuple[dict[str, Condition], frozenset[str]]:
    """Conditions of the services on which a service depends, and which of these are optional."""
    if isinstance(value, list):
        return dict.fromkeys(_strings(where, value), "service_started"), frozenset()
    if not isinstance(value, dict):
        raise ComposeError(f"{where}: expected a mapping or a list, got {value!r}")
    conditions: dict[str, Condition] = {}
    optional: set[str] = set()
    for name, fields in value.items():
        condition = fields.get("condition") if isinstance(fields, dict) else None
        if condition not in ("service_started", "service_healthy"):
            raise ComposeError(f"{where}.{name}.condition: expected service_started or service_healthy")
        conditions[str(name)] = condition
        if not _flag(f"{where}.{name}.required", fields.get("required", True)):
            optional.add(str(name))
    return conditions, frozenset(optional)


def _has_healthcheck(where: str, value: Any) -> bool:
    """Whether a service has a health check. The launcher reads its health from the bus and never runs its `test`."""
    if value is None:
        return False
    if not isinstance(value, dict):
        raise ComposeError(f"{where}: expected a mapping, got {value!r}")
    for key in value:
        if key not in _HEALTHCHECK_KEYS:
            raise ComposeError(f"{where}.{key}: not supported; there are {', '.join(sorted(_HEALTHCHECK_KEYS))}")
    if value.get("disable") is True or value.get("test") in ("NONE", ["NONE"]):
        return False
    if "test" not in value:
        raise ComposeError(f"{where}.test: missing")
    return True


def _restart(where: str, value: Any) -> tuple[Restart, int | None]:
    if value in ("no", "always", "unless-stopped", "on-failure"):
        return value, None
    if isinstance(value, str) and (match := re.fullmatch(r"on-failure:(\d+)", value)):
        return "on-failure", int(match[1])
    hint = '; "no" needs its quotes' if value is False else ""
    raise ComposeError(f"{where}: expected no, always, on-failure[:N] or unless-stopped, got {value!r}{hint}")


def _duration_s(where: str, value: Any) -> float:
    if not isinstance(value, str) or not _DURATION.fullmatch(value):
        raise ComposeError(f"{where}: expected a duration such as 500ms or 1m30s, got {value!r}")
    return sum(float(number) * _SECONDS[unit] for number, unit in _DURATION_PART.findall(value))
