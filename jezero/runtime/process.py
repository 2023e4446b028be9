"""The process of one service: it is built, runs over Zenoh until a signal, and says what is wrong."""

import os
import secrets
import signal
import sys
from collections.abc import Callable, Mapping

from jezero.os_errors import describe_os_error
from jezero.private_files import keep_private
from jezero.runtime.bus_address import service_instance
from jezero.runtime.config import ConfigError, Instance
from jezero.runtime.links import SocketLink
from jezero.runtime.service import Service
from jezero.runtime.zenoh_bus import ServiceLoop
from jezero.runtime.zenoh_session import AlreadyRunningError


def new_boot_id() -> int:
    """An id that differs between two runs of a service, on any host."""
    return secrets.randbits(48)


Build = Callable[[Instance, int], tuple[Service, Mapping[str, SocketLink]]]
"""Makes a service and its links from the instance and a fresh boot id."""


def run_process(name: str, build: Build) -> int:
    """Build a service and run its process until SIGTERM or SIGINT.

    Args:
        name: the service's, for error messages.
        build: makes the service and its links.

    Returns:
        Exit code of the process; EX_CONFIG when the settings are wrong, so that a restart would not help.
    """
    boot_id = new_boot_id()
    keep_private()
    try:
        instance = service_instance()
        service, links = build(instance, boot_id)
    except (ConfigError, OSError) as error:
        print(f"{name}: {describe_os_error(error) if isinstance(error, OSError) else error}", file=sys.stderr)
        return os.EX_CONFIG if isinstance(error, ConfigError) else 1
    return run_service(service, instance, boot_id, links)


def run_service(
    service: Service, instance: Instance, boot_id: int, links: Mapping[str, SocketLink] | None = None
) -> int:
    """Run a service until SIGTERM or SIGINT.

    Args:
        links: one for each name in the service's `Spec.links`.

    Returns:
        Exit code of the process.
    """
    loop = ServiceLoop(service, instance, boot_id, dict(links or {}))
    signal.signal(signal.SIGTERM, loop.stop)
    signal.signal(signal.SIGINT, loop.stop)
    try:
        loop.run()
    except AlreadyRunningError as error:
        print(f"{service.spec.name}: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"{service.spec.name}: {describe_os_error(error)}", file=sys.stderr)
        return 1
    finally:
        loop.close()
    return 0
