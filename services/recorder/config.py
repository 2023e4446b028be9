"""Settings of the recorder."""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.base.config import Config
from jezero.recording.images import ImageFormat


class RecorderConfig(Config, frozen=True, kw_only=True):
    """What is recorded, and how.

    Attributes:
        file_size_max_mb: size of a recording at which the next one is begun, in 10^6 bytes.
        images: how the camera's images are recorded. "jpeg" loses a little detail; a replay of the tag detector is the
            same as its flight only with "png", which takes about ten times the room.
        jpeg_quality: quality of recorded images.
    """

    file_size_max_mb: Annotated[float, Meta(ge=1.0, le=1e6)] = 1000.0
    images: Literal["jpeg", "png", "none"] = "jpeg"
    jpeg_quality: Annotated[int, Meta(ge=1, le=95)] = 80

    @property
    def image_format(self) -> ImageFormat | None:
        """Format of recorded images; None records of each image all but its pixels."""
        return None if self.images == "none" else ImageFormat(self.images, self.jpeg_quality)
