"""The systemd unit that starts a stack at boot, as text. Source: systemd.exec(5), systemd.service(5)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template

STATE_FOLDERS = Path("/var/lib")
"""Where systemd makes the folder that `StateDirectory` names."""

_UNIT = Template("""\
# Written by `jezero install-service`, which also removes it. docs/how-to/start-at-boot.md
[Unit]
Description=jezero, $profiles
# Neither unit is waited for unless this computer starts it anyway: on a field is no network, and the time of flights is
# the flight controller's. With certificates enable one that waits for the right date, such as chrony-wait.service.
After=network.target time-sync.target
# A vehicle has nobody at hand who would start it again.
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
ExecStart=$command
Restart=on-failure
RestartSec=2
# The launcher itself starts frozen services again; this is for a launcher that is frozen.
WatchdogSec=30
# The launcher stops its services one after the other.
KillMode=mixed
TimeoutStopSec=60

User=$user
$groups$environment$folder
# The services write into the run folder and into memory only. PrivateDevices and ProtectClock would hide serial lines.
NoNewPrivileges=yes
ProtectSystem=strict
ProtectHome=read-only
PrivateTmp=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectControlGroups=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
RestrictNamespaces=yes
RestrictSUIDSGID=yes
LockPersonality=yes
UMask=0077

[Install]
WantedBy=multi-user.target
""")


def unit_name(profiles: Sequence[str]) -> str:
    """File name of the unit for some profiles."""
    return f"jezero-{'-'.join(profiles)}.service"


def unit_text(
    profiles: Sequence[str],
    command: Sequence[str],
    user: str,
    groups: Sequence[str],
    environment: Mapping[str, str],
    run_folder: Path | None,
) -> str:
    """Text of a unit that runs `jezero up`, which supervises all services.

    Args:
        profiles: those that it runs.
        command: program and arguments.
        user: name of the user, not root.
        groups: the user's further groups, which may open serial lines and cameras.
        environment: variables of the stack.
        run_folder: absolute path of the run folder; None for one that systemd makes in `STATE_FOLDERS`.
    """
    state = unit_name(profiles).removesuffix(".service")
    made = f"StateDirectory={state}\nStateDirectoryMode=0700\n"
    folder = made if run_folder is None else f"ReadWritePaths={_quoted(str(run_folder))}\n"
    variables = {**environment, "JEZERO_RUN_DIR": str(run_folder or STATE_FOLDERS / state)}
    return _UNIT.substitute(
        profiles=" and ".join(profiles),
        command=" ".join(_quoted(word).replace("$", "$$") for word in command),
        user=user,
        groups=f"SupplementaryGroups={' '.join(groups)}\n" if groups else "",
        environment="".join(f"Environment={_quoted(f'{name}={value}')}\n" for name, value in variables.items()),
        folder=folder,
    )


def _quoted(word: str) -> str:
    """A word as systemd reads it, in quotes where it needs them."""
    word = word.replace("%", "%%")
    if not any(character in word for character in " \t\"'\\;"):
        return word
    escaped = word.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
