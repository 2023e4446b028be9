"""A ground station with a password, on a loopback address: a process of its own, as NiceGUI has one app a process.

Run as a program, it is this process: it prints the address of its pages.
"""

import http.client
import signal
import socket
import ssl
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlencode, urlsplit

PASSWORD = "correct horse"
ADDRESS = "127.0.0.2"
NO_ROUTER = "tcp/127.0.0.1:1"
REPLY_TIMEOUT_S = 60.0


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


@dataclass(frozen=True)
class Reply:
    """A response, read to its end."""

    status: int
    headers: http.client.HTTPMessage
    text: str

    @property
    def cookie(self) -> str:
        """The cookie that it sets, as a browser sends it back."""
        return str(self.headers.get("Set-Cookie", "")).partition(";")[0]


def ask(
    address: str,
    method: str,
    path: str,
    fields: dict[str, str] | None = None,
    *,
    source: str = "127.0.0.1",
    **headers: str,
) -> Reply:
    """Send one request on a connection of its own.

    Args:
        source: address of the client, on the loopback.
    """
    parts = urlsplit(address)
    connection = (
        http.client.HTTPSConnection(
            parts.netloc, timeout=REPLY_TIMEOUT_S, source_address=(source, 0), context=ssl._create_unverified_context()
        )
        if parts.scheme == "https"
        else http.client.HTTPConnection(parts.netloc, timeout=REPLY_TIMEOUT_S, source_address=(source, 0))
    )
    try:
        connection.request(method, path, None if fields is None else urlencode(fields), headers)
        reply = connection.getresponse()
        return Reply(reply.status, reply.headers, reply.read().decode("utf-8", "replace"))
    finally:
        connection.close()


def opened(address: str, source: str, begun: bytes) -> socket.socket:
    """A connection on which only the begin of something was sent."""
    parts = urlsplit(address)
    connection = socket.create_connection((parts.hostname, parts.port), REPLY_TIMEOUT_S, (source, 0))
    connection.sendall(begun)
    return connection


def make_certificate(folder: Path) -> tuple[Path, Path]:
    """Make a certificate that signs itself; returns its file and its key's."""
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    request = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-subj",
               "/CN=test", "-days", "1", "-keyout", str(key), "-out", str(certificate)]  # fmt: skip
    subprocess.run(request, check=True, capture_output=True)
    return certificate, key


def main() -> None:
    """Serve until SIGTERM."""
    import msgspec

    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig
    from jezero.services.ground_station.access import Listening, hash_of
    from jezero.services.ground_station.config import GroundStationConfig
    from jezero.services.ground_station.web.server import PageServer

    router, *words = sys.argv[1:]
    settings = dict(word.split("=") for word in words)
    config = msgspec.convert({"listen": ADDRESS, **settings}, GroundStationConfig, strict=False)
    listening = Listening(config, hash_of(PASSWORD))
    server = PageServer(listening, load_config(VehicleConfig, "vehicle"), "uav1", router)
    print(server.address, flush=True)
    server.run()


if __name__ == "__main__":
    main()
