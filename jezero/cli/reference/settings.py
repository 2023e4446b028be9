"""The page of all settings, from the structs that the services read them into."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from jezero import deploy
from jezero.base.config import Config, load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.cli.reference.words import Field, description_of, escape, fields_of, json_words, summary_of, table
from jezero.runtime.instance import Instance
from jezero.services.table import SERVICES, resolve
from jezero.services.vehicle_bridge.controller_parameters import ParameterFile

FILES: dict[str, tuple[type[Config], str]] = {
    "vehicle": (
        VehicleConfig,
        "The robot: vehicle, rover platform, and what is mounted on both. Every service reads it.",
    ),
    "px4": (ParameterFile, "Parameters of a real flight controller, for `jezero px4 parameters`."),
    **{row.name: (resolve(row.settings), row.about) for row in SERVICES if row.settings},
}
"""Each file in deploy/config, with the struct that it is read into, and its subject."""
SHIPPED = Path(deploy.__path__[0]) / "config"


class Variable(NamedTuple):
    """One environment variable.

    Attributes:
        name: its name.
        value: kind of its value, for people.
        default: what holds without it, for people.
        meaning: what it does, for people.
    """

    name: str
    value: str
    default: str
    meaning: str


VARIABLES = (
    Variable("JEZERO_KEYS", "folder", "–", "folder of the bundle of `jezero keys`, for an address with `tls`."),
    Variable(
        "JEZERO_INSECURE",
        "`1`",
        "–",
        "whether links to other computers may go without TLS; `1` permits it.",
    ),
    Variable(
        "JEZERO_LISTEN",
        "addresses",
        "–",
        "where the stack's gate listens to other computers, such as `tls/0.0.0.0:7448`; several with blanks between.",
    ),
    Variable(
        "JEZERO_CONNECT",
        "addresses",
        "–",
        "gates of other computers to which the stack's gate connects, such as `tls/uav1.local:7448`.",
    ),
    Variable("JEZERO_GATE", "`0` or `1`", "`0`", "whether containers run the gate; `jezero up` sets it by the links."),
    Variable(
        "JEZERO_CAMERA",
        "`0` or `1`",
        "`0`",
        "whether containers run the driver of a real camera; `jezero up` sets it by `camera_driver.toml`.",
    ),
    Variable(
        "JEZERO_GCS_HOST",
        "IPv4 address",
        "`127.0.0.1`",
        "computer of the ground stations of the embedded autopilot; from another one it takes signed messages only.",
    ),
    Variable(
        "JEZERO_MAVLINK_KEY_FILE",
        "file",
        "–",
        "line of text whose SHA-256 signs the messages between the vehicle bridge and the flight controller.",
    ),
    Variable("JEZERO_CONFIG_DIR", "folder", "the shipped folder", "folder of the settings."),
    Variable(
        "JEZERO_WORLD", "name or file", "–", "world that changes the settings, such as `mars`; `--world` overrides it."
    ),
    Variable(
        "JEZERO_RUN_DIR",
        "folder",
        "`~/.local/state/jezero/<vehicle>`",
        "run folder of the stack, with its logs, pictures and recordings.",
    ),
    Variable("JEZERO_RECORD", "`0` or `1`", "`1`", "whether the stack records; `0` starts no recorder."),
    Variable("JEZERO_GROUND", "`0` or `1`", "`1`", "whether the stack has a ground station in the browser."),
    Variable("JEZERO_SIMULATOR", "host", "`127.0.0.1`", "computer of the simulator, for the service `rover`."),
    Variable("JEZERO_AUTOPILOT", "`embedded` or `px4`", "as in `autopilot.toml`", "autopilot that the stack runs."),
    Variable("JEZERO_PX4_DIR", "folder", "–", "folder of PX4, with `bin/px4` and `etc/`."),
)
"""The environment variables that are no fields of `Instance`."""

ENVIRONMENT = "The identity of one stack on this machine, and how it runs. All its processes read these variables."
INTRODUCTION = """# Settings

This page is the output of `jezero info page settings`. [Configure](../how-to/configure.md) explains where the files are
and how to change them. A setting that is left out takes its default; an unknown name or a value out of range ends the
service at its start with a sentence that names it.

Units are in the names. Beginnings of names: `std_` standard deviation, `tau_` time constant, `psd_` power spectral
density, `pos_` position. Frames: `ned` north, east, down; `frd` forward, right, down of the vehicle; `rover_body`
forward, right, down of the rover. Bounds of 10 000 and more are left out of the ranges.

An action of an installed package has a file of its own,
[`<action>.toml`](../how-to/write-an-action.md#settings).
"""


def page() -> str:
    """The page: a chapter for each file, a section for each of its tables."""
    contents = "\n".join(f"| [{name}.toml](#{name}toml) | {subject} |" for name, (_, subject) in FILES.items())
    chapters = (
        f"## {name}.toml\n\n{subject}\n\n" + "\n".join(_sections(name, "", kind, load_config(kind, name, SHIPPED)))
        for name, (kind, subject) in FILES.items()
    )
    return "\n".join([INTRODUCTION, "| file | subject |", f"| --- | --- |\n{contents}\n", *chapters, _environment()])


def _sections(file: str, path: str, struct: type, shipped: msgspec.Struct | None) -> Iterator[str]:
    """A section for the settings of a struct, then one for each of its tables; `path` is "" for the file itself."""
    defaults = {name: default for name, default in _defaults(struct).items() if isinstance(default, Config)}
    fields = [field for field in fields_of(struct) if field.name not in defaults]
    if fields:
        heading = f"### {file}.toml: [{path}]\n\n{escape(description_of(struct))}\n\n" if path else ""
        yield heading + table([_row(field, struct, shipped) for field in fields]) + "\n"
    for name, inner in {inner: (field.name, inner) for field in fields for inner in field.structs}.values():
        rows = [_plain_row(field) for field in fields_of(inner)]
        yield f"Each table of `{name}`: {escape(summary_of(inner))}\n\n{table(rows)}\n"
    for field in fields:
        if field.structs and (entries := getattr(shipped, field.name)):
            yield f"Tables of `{field.name}` in the file:\n\n{table([_entry(each) for each in entries])}\n"
    for name, default in defaults.items():
        if not isinstance(default, VehicleConfig):  # it has a chapter of its own
            yield from _sections(file, f"{path}.{name}".strip("."), type(default), getattr(shipped, name))


def _defaults(struct: Any) -> dict[str, Any]:
    return {field.name: field.default for field in msgspec.structs.fields(struct)}


def _row(field: Field, struct: Any, shipped: Any) -> dict[str, str]:
    """A setting; its default names the value in the shipped file where that is another one."""
    value = getattr(shipped, field.name)
    if field.structs:  # a table below shows them
        shown = field.default if not value else f"{field.default}; in the file {len(value)} tables"
        return _plain_row(field) | {"default": shown}
    shown = json_words(value)
    if value == _defaults(struct)[field.name] or shown == field.default:
        return _plain_row(field)
    shown = f"in the file: {len(value)} entries" if isinstance(value, dict) else f"{field.default}; in the file {shown}"
    return _plain_row(field) | {"default": shown}


def _entry(entry: msgspec.Struct) -> dict[str, str]:
    """The fields of one table of the file."""
    shown = msgspec.structs.asdict(entry).items()
    return {name: value if " " in str(value) else json_words(value).replace('"', "") for name, value in shown}


def _plain_row(field: Field) -> dict[str, str]:
    return {
        "setting": f"`{field.name}`",
        "value": "tables" if field.structs else field.value,
        "range": field.range,
        "default": field.default,
        "meaning": field.meaning,
    }


def _environment() -> str:
    rows = [{"variable": _variable(field)} | _plain_row(field) for field in fields_of(Instance)]
    for row in rows:
        del row["setting"]
        row["meaning"] = row["meaning"].replace(f" ({row['variable']})", "")
    for name, value, default, meaning in VARIABLES:
        rows.append({"variable": f"`{name}`", "value": value, "range": "", "default": default, "meaning": meaning})
    return f"## Environment\n\n{ENVIRONMENT}\n\n{table(rows)}\n"


def _variable(field: Field) -> str:
    """The variable that sets a field, which its description names."""
    found = re.search(r"`JEZERO_\w+`", field.meaning)
    return found[0] if found else ""
