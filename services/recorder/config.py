"""Settings of the recorder."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config


class RecorderConfig(Config, frozen=True, kw_only=True):
    """What is recorded, and how.

    Attributes:
        file_size_max_mb: size of a recording at which the next one is begun, in 10^6 bytes.
        images: whether the camera's images are recorded.
        jpeg_quality: quality of recorded images.
    """

    file_size_max_mb: Annotated[float, Meta(ge=1.0, le=1e6)] = 1000.0
    images: bool = True
    jpeg_quality: Annotated[int, Meta(ge=1, le=95)] = 80
