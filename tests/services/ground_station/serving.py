"""A ground station with a password, on a loopback address: a process of its own, as NiceGUI has one app a process.

Run as a program, it is this process: it prints the address of its pages.
"""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PASSWORD = "correct horse"
ADDRESS = "127.0.0.2"
NO_ROUTER = "tcp/127.0.0.1:1"


@contextmanager
def serving(router: str = NO_ROUTER, *words: str) -> Iterator[str]:
    """The address of the pages of a ground station that runs during the block; see `serving_process`."""
    with serving_process(router, *words) as (address, _):
        yield address


@contextmanager
def serving_process(router: str = NO_ROUTER, *words: str) -> Iterator[tuple[str, int]]:
    """The address of the pages of a ground station that runs during the block, and its process id.

    Args:
        words: settings, such as `session_idle_s=60`.
    """
    command = [sys.executable, str(Path(__file__)), router]
    with subprocess.Popen([*command, *words], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().strip(), process.pid
        finally:
            process.send_signal(signal.SIGCONT)
            process.terminate()


def main() -> None:
    """Serve until SIGTERM."""
    import msgspec

    from jezero.runtime.config import load_config
    from jezero.services.ground_station.config import GroundStationConfig
    from jezero.services.ground_station.listening import Listening
    from jezero.services.ground_station.password import hash_of
    from jezero.services.ground_station.web.server import PageServer
    from jezero.vehicle_config import VehicleConfig

    router, *words = sys.argv[1:]
    settings = dict(word.split("=") for word in words)
    config = msgspec.convert(settings, GroundStationConfig, strict=False)
    listening = Listening(ADDRESS, hash_of(PASSWORD), config.certificate, config.key, frozenset())
    server = PageServer(config, listening, load_config(VehicleConfig, "vehicle"), "uav1", router)
    print(server.address, flush=True)
    server.run()


if __name__ == "__main__":
    main()
