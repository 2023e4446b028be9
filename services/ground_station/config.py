"""Settings of the ground station."""

from typing import Annotated

from msgspec import Meta

from jezero.base.config import Config


class GroundStationConfig(Config, frozen=True, kw_only=True):
    """Where the ground station listens, who may fly, and how often its pages get new values.

    Attributes:
        listen: IP address on which the pages are served. On another one than the loopback address, a password and a
            certificate are needed.
        port: TCP port. Another one is taken when it is busy.
        certificate: file of the TLS certificate, PEM; "" for none.
        key: file of the certificate's private key, PEM.
        insecure: serves another address than the loopback address without TLS. Whoever reads the network's traffic
            reads the password too.
        host_names: names of this machine by which browsers find it, besides its own host name and its addresses.
        password_file: file of the password's hash, which `jezero ground --set-password` writes; "" for
            `~/.config/jezero/ground_station.password`.
        session_idle_s: a log-in ends when its pages were not used for this time.
        session_max_s: a log-in ends after this time in any case.
        rate_hz: how often a page gets new values.
        rate_camera_hz: how often a page gets a new image of the camera, while it shows the images.
    """

    listen: str = "127.0.0.1"
    port: Annotated[int, Meta(ge=1, le=65535)] = 8080
    certificate: str = ""
    key: str = ""
    insecure: bool = False
    host_names: tuple[str, ...] = ()
    password_file: str = ""
    session_idle_s: Annotated[float, Meta(ge=60.0, le=86400.0)] = 1800.0
    session_max_s: Annotated[float, Meta(ge=60.0, le=604800.0)] = 43200.0
    rate_hz: Annotated[float, Meta(ge=0.5, le=30.0)] = 10.0
    rate_camera_hz: Annotated[float, Meta(ge=0.1, le=15.0)] = 5.0
