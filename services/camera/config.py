"""Settings of the driver of a real camera. Its optics and its mounting are in `vehicle.toml`."""

from typing import Annotated

from msgspec import Meta

from jezero.base.config import Config
from jezero.schemas.struct import END

Seconds = Annotated[float, Meta(ge=0.0, le=2.0)]


class CameraDriverConfig(Config, frozen=True, kw_only=True):
    """Where the pictures come from, and how old they are on arrival.

    Attributes:
        source: the camera: a device such as `/dev/video0`; `rtsp://HOST/PATH`; `http://HOST:PORT/PATH` of an MJPEG
            stream; or `file:PATH` of a video or of a folder of pictures, for rehearsals. "" where there is no camera:
            the driver does not run then.
        exposure_delay_s: time from the middle of an exposure until its picture has arrived, which `jezero camera delay`
            measures.
        exposure_s: duration of an exposure, as it is published with each picture.
        pixel_format: format that a device is asked for, by the four letters of V4L2, such as `MJPG` or `YUYV`; "" for
            the device's own choice. Many USB cameras reach their full rate with `MJPG` only.
    """

    source: str = ""
    exposure_delay_s: Seconds = 0.05
    exposure_s: Seconds = 0.01
    pixel_format: Annotated[str, Meta(pattern=rf"^([A-Z0-9 ]{{4}})?{END}")] = ""
