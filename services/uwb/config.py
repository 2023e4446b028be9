"""Settings of the UWB driver, `deploy/config/uwb.toml`."""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.base.config import Config

Format = Literal["dwm1001", "nooploop", "json"]


class UwbDriverConfig(Config, frozen=True, kw_only=True):
    """Where the vehicle's UWB module is, and what it speaks. The anchors are in `vehicle.toml`.

    Attributes:
        link: the module's line: `serial:/dev/ttyACM1:115200`, `udpin:ADDRESS:PORT` (the module sends there),
            `udpout:HOST:PORT` (it listens there) or `tcp:HOST:PORT`; "" where there is none.
        format: what the module speaks: `dwm1001`, the shell of a DWM1001, which the driver starts; `nooploop`, the
            frames Node_Frame2 and Node_Frame3 of Nooploop's LinkTrack; `json`, one object a line with the range in
            metres by each module's id, `{"ranges_m": {"022E": 3.44, "1A2B": 5.01}}`.
        delay_s: time from the measurement until its bytes have arrived. The modules send no time stamps.
    """

    link: str = ""
    format: Format = "dwm1001"
    delay_s: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.03
