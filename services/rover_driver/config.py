"""Settings of the rover's driver, `deploy/config/rover_driver.toml`."""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.base.config import Config

Format = Literal["nmea", "json"]


class RoverDriverConfig(Config, frozen=True, kw_only=True):
    """The lines to the rover's receiver or wheels, and what they speak.

    Attributes:
        link: the line from which the odometry comes: `serial:/dev/ttyUSB0:115200`, `udpin:ADDRESS:PORT` (the rover
            sends there), `udpout:HOST:PORT` (it listens there) or `tcp:HOST:PORT`; "" where there is none.
        format: what comes from it: `nmea`, RMC and HDT of a receiver with two antennas, and GGA and ROT where it sends
            them; or `json`, one object a line:
            `{"yaw_rad": 0.5, "speed_mps": 0.2, "yaw_rate_rps": 0.0, "roll_rad": 0.0, "pitch_rad": 0.0}`, of which the
            last three may be missing; or `{"yaw_rad": 0.5, "ticks": [10250, 10311]}` with the counts of the left and
            the right wheels.
        delay_s: time from the measurement until its bytes have arrived.
        command_link: the line on which the drive commands go out, one object a line:
            `{"speed_mps": 0.2, "yaw_rate_rps": 0.0}`. The same address as `link` for the same line; "" for none: this
            rover is not driven from the bus.
        ticks_per_m: counts of a wheel per metre of its way, for `ticks`.
        track_m: distance between the left and the right wheels, for `ticks`.
    """

    link: str = ""
    format: Format = "nmea"
    delay_s: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.05
    command_link: str = ""
    ticks_per_m: Annotated[float, Meta(gt=0.0, le=1e6)] = 1000.0
    track_m: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.6
