"""What the link to a real camera carries: pictures, and why there are none."""

import msgspec


class ArrivedPicture(msgspec.Struct, frozen=True, tag="picture"):
    """One picture of a camera.

    Attributes:
        arrival_ns: this computer's monotonic time at which the picture had arrived.
        width_px: width of the picture.
        height_px: height of the picture.
        pixels: rows from the top, three bytes per pixel: red, green, blue.
        broken: number of pictures so far that could not be read, as they were damaged or only half there.
    """

    arrival_ns: int
    width_px: int
    height_px: int
    pixels: bytes
    broken: int = 0


class NoPicture(msgspec.Struct, frozen=True, tag="none"):
    """There is no picture.

    Attributes:
        reason: why, for people.
        broken: number of pictures so far that could not be read.
    """

    reason: str
    broken: int = 0


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(ArrivedPicture | NoPicture)


def encode_picture(picture: ArrivedPicture | NoPicture) -> bytes:
    """The bytes for the link."""
    return _encoder.encode(picture)


def decode_picture(data: bytes) -> ArrivedPicture | NoPicture:
    """What `encode_picture` has encoded."""
    received: ArrivedPicture | NoPicture = _decoder.decode(data)
    return received
