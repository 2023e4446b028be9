"""The images of a recording, for services that have read them."""

from collections.abc import Iterable
from pathlib import Path
from zlib import crc32

import msgspec

from jezero.base.codec import join_attachment
from jezero.recording import Recording, RecordingError
from jezero.schemas.sensors import CameraFrame


class RecordedImages:
    """Finds images in the order in which a service has read them.

    Args:
        files: the recordings, in their order.

    Attributes:
        lossy: number of images that are not exactly those that the service read, because a JPEG loses detail.
    """

    def __init__(self, files: Iterable[Path]) -> None:
        self._images = (image for file in files for image in Recording(file).images())
        self.lossy = 0

    def message(self, header: bytes, checksum: int) -> bytes:
        """The encoded message of an image.

        Args:
            header: JSON of the frame without its pixels.
            checksum: CRC-32 of the pixels that the service read.

        Raises:
            RecordingError: the image is not in the recordings.
        """
        try:
            wanted = msgspec.json.decode(header, type=CameraFrame)
        except msgspec.DecodeError as error:
            raise RecordingError(f"an image in the journal is damaged: {error}") from None
        for frame, pixels in self._images:
            if frame == wanted:
                data: bytes = pixels.tobytes()
                self.lossy += crc32(data) != checksum
                return join_attachment(header, data)
        raise RecordingError(
            f"the recording doesn't have the image of {wanted.t_ns / 1e9:.3f} s, which the service read: "
            "replay a recording with images (`images` in recorder.toml)"
        )
