"""The environment variables that are no fields of `Instance`."""

from typing import NamedTuple


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
        "JEZERO_GCS_HOST",
        "IPv4 address",
        "`127.0.0.1`",
        "computer of the ground stations of the embedded autopilot; from another one it takes signed messages only.",
    ),
    Variable("JEZERO_CONFIG_DIR", "folder", "the shipped folder", "folder of the settings."),
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
