"""The autopilot's link to ground stations: on the loopback as shipped, and signed where it leaves this computer.

The time stamp of signatures is kept in a file: after a restart no message from before it is accepted.
"""

import os
import sys
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path

from msgspec.structs import replace

from jezero.base.config import ConfigError
from jezero.base.files import describe_os_error, write_whole
from jezero.keys.bundle import INSECURE_VARIABLE, VARIABLE, mavlink_key
from jezero.keys.members import KeysError
from jezero.services.autopilot.config import AutopilotConfig, SigningConfig

HOST_VARIABLE = "JEZERO_GCS_HOST"
"""Environment variable with the IPv4 address of the computer of the ground stations."""
LOOPBACK = "127.0.0.1"
STAMP_NAME = "mavlink_stamp"
"""The file in the run folder. It outlasts the stack."""
FUTURE_MAX_S = 60
"""Time by which an accepted message's time stamp may be ahead of the clock; the same as `mavlink.Signing.WINDOW`."""


def ground_host() -> str:
    """The computer of the ground stations, by `JEZERO_GCS_HOST`.

    Raises:
        ConfigError: it is no IPv4 address.
    """
    given = os.environ.get(HOST_VARIABLE) or LOOPBACK
    try:
        IPv4Address(given)
    except AddressValueError:
        raise ConfigError(f"{HOST_VARIABLE} is {given!r}: write the IPv4 address of one computer, no port") from None
    return given


def is_local(host: str) -> bool:
    """Whether the link stays on this computer."""
    return IPv4Address(host).is_loopback


def insecurity(signing: SigningConfig, host: str) -> str:
    """What a link without signatures to another computer means, for people; "" for any other link."""
    if is_local(host) or signing.key:
        return ""
    return f"the MAVLink link to {host} is insecure: everybody on its network may fly"


def with_signatures(config: AutopilotConfig, host: str) -> AutopilotConfig:
    """The settings with signatures on a link that leaves this computer, by the key in `autopilot.toml` or the bundle's.

    Raises:
        ConfigError: such a link has no key, and nobody has permitted that.
    """
    if is_local(host):
        return config
    signing = config.signing
    try:
        key = signing.key or mavlink_key(os.environ.get(VARIABLE)).hex()
    except KeysError as error:
        raise ConfigError(f"{HOST_VARIABLE}: {error}") from None
    if not key and os.environ.get(INSECURE_VARIABLE) == "1":
        return config
    if not key:
        raise ConfigError(
            f"{HOST_VARIABLE} is {host}: without signatures everybody on its network could fly by MAVLink. Name the "
            f"bundle of `jezero keys` with {VARIABLE}: the ground station needs its mavlink.key too. Or set "
            f"{INSECURE_VARIABLE}=1 on a network that you trust"
        )
    return replace(config, signing=SigningConfig(key=key, links=tuple(dict.fromkeys(("gcs", *signing.links)))))


# -- the time stamp of signatures ------------------------------------------------------------------------


def kept_stamp_path() -> Path | None:
    """The file below `JEZERO_RUN_DIR`; None without a run folder."""
    run_dir = os.environ.get("JEZERO_RUN_DIR")
    return Path(run_dir).absolute() / STAMP_NAME if run_dir else None


def load_stamp(path: Path | None, now_10us: int) -> int:
    """The kept time stamp; -1 when none was ever kept.

    A file that can't be read counts as the latest time stamp that can have been accepted until now.

    Args:
        path: the file; None without a run folder.
        now_10us: present time, in the units of time stamps.
    """
    if path is None:
        return -1
    try:
        return int(path.read_text("ascii"))
    except FileNotFoundError:
        return -1
    except (OSError, ValueError) as error:
        why = describe_os_error(error) if isinstance(error, OSError) else f"{path} is damaged"
        print(f"{why}: no signed message is accepted for about {FUTURE_MAX_S} s", file=sys.stderr, flush=True)
        return now_10us + 100_000 * FUTURE_MAX_S


def save_stamp(path: Path | None, stamp_10us: int) -> None:
    """Write the time stamp into its file.

    It doesn't wait for the disk (fsync), which takes some ten milliseconds, in which nobody controls the motors: a loss
    of power may lose what was written in the last seconds. When the file can't be written, the message is accepted all
    the same, because whoever flies needs the link more.
    """
    if path is None:
        return
    try:
        write_whole(path, f"{stamp_10us}\n".encode("ascii"))
    except OSError as error:
        why = describe_os_error(error)
        print(f"{why}: after a restart a captured MAVLink message could be accepted", file=sys.stderr, flush=True)
