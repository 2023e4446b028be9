"""Bytes on the bus: JSON that is finite when it leaves and checked when it arrives.

A picture is its header in JSON, a line feed, and its pixels.
"""

import math
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import msgspec

from jezero.schemas.images import ImageReply
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.struct import Payload

MAX_PAYLOAD_BYTES = 4_000_000
MAX_PICTURE_HEADER_BYTES = 4_000
PICTURES = (CameraFrame, ImageReply)
"""Payloads whose pixels travel beside their header."""
_WITHOUT_FLOATS = frozenset((type(None), bool, int, str, bytes))
_encoder = msgspec.json.Encoder()


class NotFiniteError(ValueError):
    """A number to be sent is NaN or infinite; JSON would write it as null."""


class BadPayloadError(ValueError):
    """What arrived is no valid message; the text says where and why."""


def encode(payload: Payload) -> bytes:
    """JSON of a payload; of a picture also the pixels.

    Raises:
        NotFiniteError: a float in it is NaN or infinite.
    """
    if type(payload) in PICTURES and (pixels := payload.pixels):  # type: ignore[attr-defined]
        return join_picture(encode(msgspec.structs.replace(payload, pixels=b"")), pixels)
    data = _encoder.encode(payload)
    if b"null" in data:  # None that is meant, text, or a number that is not finite
        values = msgspec.structs.astuple(payload)
        nones = 0 if payload.__struct_config__.omit_defaults else values.count(None)
        if data.count(b"null") != nones and not _are_finite(values):
            _require_finite(payload, type(payload).__name__)
    return data


def _are_finite(values: Iterable[Any]) -> bool:
    """What `_require_finite` finds out, without the words that tell where."""
    for value in values:
        kind = type(value)
        if kind in _WITHOUT_FLOATS:
            continue
        if kind is float:
            good = math.isfinite(value)
        elif kind is tuple:
            good = _are_finite(value)
        elif kind is dict:
            good = _are_finite(value.values())
        elif issubclass(kind, msgspec.Struct):
            good = _are_finite(msgspec.structs.astuple(value))
        else:
            good = isinstance(value, str | int)  # an enumeration; rarer ones are left to the other
        if not good:
            return False
    return True


def _require_finite(value: Any, where: str) -> None:
    if isinstance(value, float):
        if not math.isfinite(value):
            raise NotFiniteError(f"{where} is {value}")
    elif isinstance(value, msgspec.Struct):
        for field in value.__struct_fields__:
            _require_finite(getattr(value, field), f"{where}.{field}")
    elif isinstance(value, Mapping):
        for name, item in value.items():
            _require_finite(item, f"{where}[{name!r}]")
    elif isinstance(value, tuple | list):
        for index, item in enumerate(value):
            _require_finite(item, f"{where}[{index}]")


class Reader:
    """Decodes payloads of one kind.

    On the in-memory bus all who listen get the same bytes: what was decoded last is kept.
    """

    __slots__ = ("_data", "_decode", "_message", "_pictures")

    def __init__(self, kind: Any) -> None:
        self._decode = msgspec.json.Decoder(kind).decode
        self._pictures = kind in PICTURES
        self._data: bytes | None = None
        self._message: Any = None

    def read(self, data: bytes) -> Any:
        """A payload.

        Raises:
            BadPayloadError: malformed, an unknown field, a wrong type, a number out of its range, or a picture that has
                not three bytes for each pixel.
        """
        if data is self._data:
            return self._message
        try:
            if self._pictures:
                return self._read_picture(data)
            if len(data) > MAX_PAYLOAD_BYTES:
                raise BadPayloadError(f"{len(data)} bytes are more than {MAX_PAYLOAD_BYTES}")
            self._message = message = self._decode(data)
            self._data = data
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise BadPayloadError(str(error)) from None
        except RecursionError:
            raise BadPayloadError("nested too deeply") from None
        return message

    def _read_picture(self, data: bytes) -> CameraFrame | ImageReply:
        header, pixels = split_picture(data)
        if len(header) > MAX_PICTURE_HEADER_BYTES:
            raise BadPayloadError(f"a header of {len(header)} bytes is more than {MAX_PICTURE_HEADER_BYTES}")
        frame: CameraFrame | ImageReply = self._decode(header)
        if frame.pixels or len(pixels) != 3 * frame.width_px * frame.height_px:
            size = f"{frame.width_px} x {frame.height_px}"
            raise BadPayloadError(f"{len(pixels)} bytes are not {size} pixels of three bytes")
        return msgspec.structs.replace(frame, pixels=pixels)


reader = cache(Reader)
"""The one of a kind: a type, or a union of types."""


def decode(kind: Any, data: bytes) -> Any:
    """A payload of type `kind` (or of one type of a union).

    Raises:
        BadPayloadError: see `Reader.read`.
    """
    return reader(kind).read(data)


def join_picture(header: bytes, pixels: bytes) -> bytes:
    """A picture as one piece."""
    return b"%b\n%b" % (header, pixels)


def split_picture(data: bytes) -> tuple[bytes, bytes]:
    """A picture's header, in JSON, and its pixels."""
    header, _, pixels = data.partition(b"\n")
    return header, pixels


def decode_request(kind: Any, data: bytes, parameters: Mapping[str, str]) -> Any:
    """The payload of a question: its JSON body, or its selector's parameters, decoded into the same struct.

    Args:
        parameters: as strings; values are JSON where they parse and text elsewhere. Names that start with `_` belong
            to Zenoh and are ignored.

    Raises:
        BadPayloadError: as `decode`; also when body and parameters are both given.
    """
    given = {name: value for name, value in parameters.items() if not name.startswith("_")}
    if data and given:
        raise BadPayloadError(f"both a payload and parameters ({', '.join(sorted(given))}): send one of them")
    if data:
        return decode(kind, data)
    fields = {name: _json_or_text(value) for name, value in given.items()}
    try:
        return msgspec.convert(fields, kind)
    except msgspec.ValidationError as error:
        raise BadPayloadError(str(error)) from None


def _json_or_text(value: str) -> Any:
    try:
        return msgspec.json.decode(value.encode())
    except (msgspec.DecodeError, UnicodeEncodeError, RecursionError):
        return value
