"""Messages as bytes: JSON that is finite when it is sent and checked when it arrives.

A payload with an attachment (`schemas.struct.WithAttachment`) is its JSON, a line feed, and the attachment as it is.
Texts lose their control characters when they are decoded, see `plain_text`.
"""

import math
import sys
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any, get_args, get_type_hints

import msgspec

from jezero.base.mistakes import mistake
from jezero.base.plain_text import plain, plain_json
from jezero.schemas.struct import Payload, WithAttachment, WithReadings

MAX_JSON_BYTES = 4_000_000
"""Size of a message without its attachment up to which a service decodes it."""
_WITHOUT_FLOATS = frozenset((type(None), bool, int, str, bytes))
_encoder = msgspec.json.Encoder()


class NotFiniteError(ValueError):
    """A number to be sent is NaN or infinite; JSON would write it as null."""


class BadPayloadError(ValueError):
    """A message that arrived is not valid; the text says where and why."""


def encode(payload: Payload) -> bytes:
    """JSON of a payload, joined with its attachment.

    Raises:
        NotFiniteError: a float in it is NaN or infinite.
    """
    if isinstance(payload, WithAttachment) and payload.attachment:
        return join_attachment(encode(payload.with_attachment(b"")), payload.attachment)
    data = _encoder.encode(payload)
    if b"null" in data:  # an intended None, text, or a number that is not finite
        values = msgspec.structs.astuple(payload)
        nones = 0 if payload.__struct_config__.omit_defaults else values.count(None)
        if data.count(b"null") != nones and not _are_finite(values):
            _require_finite(payload, type(payload).__name__)
    return data


def _are_finite(values: Iterable[Any]) -> bool:
    """Whether `_require_finite` accepts all values; faster, as it doesn't keep track of their names."""
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
            good = isinstance(value, str | int)  # an enumeration; rarer types are left to `_require_finite`
        if not good:
            return False
    return True


def finite_readings(message: WithReadings) -> Any:
    """A message without the readings in which a number is not finite."""
    return message.with_readings(reading for reading in message.readings if _are_finite((reading,)))


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
    """Decodes payloads of one type.

    On the in-memory bus all subscribers get the same bytes object, so the last message is kept and decoded once.
    A message with a list of readings (`schemas.struct.WithReadings`) loses its bad ones, and keeps the others.

    Args:
        kind: a type, or a union of types.
        max_json_bytes: longer messages are refused; None accepts any length. Attachments don't count.
    """

    __slots__ = ("_attached", "_decode", "_kind", "_last", "_lines", "_max_json_bytes")

    def __init__(self, kind: Any, max_json_bytes: int | None) -> None:
        self._kind = kind
        self._decode = msgspec.json.Decoder(kind).decode
        self._attached = has_attachment(kind)
        self._lines = bool(getattr(kind, "has_lines", False))
        self._max_json_bytes = sys.maxsize if max_json_bytes is None else max_json_bytes
        self._last: tuple[bytes | None, Any, tuple[str, ...]] = (None, None, ())
        """Bytes, message, and what is wrong with the readings that were left out. It is one object, so that a thread
        never sees the bytes of one message with the content of another."""

    def read(self, data: bytes) -> Any:
        """A payload.

        Raises:
            BadPayloadError: malformed, too long, an unknown field, a wrong type, a number out of its range (but for
                readings of a list), or an attachment that doesn't fit the other fields.
        """
        last = self._last
        if data is last[0]:
            return last[1]
        json, attachment = split_attachment(data) if self._attached else (data, b"")
        message, dropped = self._decode_json(json)
        if self._attached:
            message = _attach(message, attachment)
        self._last = (data, message, dropped)
        return message

    def dropped(self, data: bytes) -> tuple[str, ...]:
        """What is wrong with each reading that was left out of the message that was read last.

        Args:
            data: the very bytes of that message.
        """
        last = self._last
        return last[2] if data is last[0] else ()

    def _decode_json(self, json: bytes) -> tuple[Any, tuple[str, ...]]:
        if len(json) > self._max_json_bytes:
            raise BadPayloadError(f"{len(json)} bytes are more than {self._max_json_bytes}")
        try:
            text = plain_json(json, lines=self._lines)
            try:
                return self._decode(text), ()
            except msgspec.ValidationError:
                if not _has_readings(self._kind):
                    raise
                return _without_bad_readings(self._kind, text)
        except msgspec.ValidationError as error:
            raise BadPayloadError(mistake(error, self._kind)) from None
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise BadPayloadError(str(error)) from None
        except RecursionError:
            raise BadPayloadError("nested too deeply") from None


def _has_readings(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, WithReadings)


def _without_bad_readings(kind: type[WithReadings], json: bytes) -> tuple[Any, tuple[str, ...]]:
    """A message without its bad readings, and what is wrong with each of those.

    Raises:
        ValidationError: something else is wrong with the message.
    """
    fields, name = msgspec.json.decode(json), kind.readings_field
    readings = fields.get(name) if isinstance(fields, dict) else None
    if not isinstance(readings, list):
        return msgspec.convert(fields, kind), ()
    (reading_type, _) = get_args(get_type_hints(kind)[name])
    good, dropped = [], []
    for number, reading in enumerate(readings):
        try:
            good.append(msgspec.convert(reading, reading_type))
        except msgspec.ValidationError as error:
            dropped.append(f"{name}[{number}]: {mistake(error, reading_type)}")
    return msgspec.convert({**fields, name: good}, kind), tuple(dropped)


def _attach(message: WithAttachment, attachment: bytes) -> WithAttachment:
    if message.attachment:
        raise BadPayloadError("the attachment is within the JSON")
    whole = message.with_attachment(attachment)
    try:
        whole.check_attachment()
    except ValueError as error:
        raise BadPayloadError(str(error)) from None
    return whole


@cache
def reader(kind: Any, max_json_bytes: int | None = MAX_JSON_BYTES) -> Reader:
    """The one `Reader` of a type: a union of types takes longer to understand than to decode."""
    return Reader(kind, max_json_bytes)


def decode(kind: Any, data: bytes) -> Any:
    """A payload of type `kind` (or of one type of a union).

    Raises:
        BadPayloadError: see `Reader.read`.
    """
    return reader(kind).read(data)


def has_attachment(kind: Any) -> bool:
    """Whether messages of a type travel with an attachment."""
    return isinstance(kind, type) and issubclass(kind, WithAttachment)


def join_attachment(json: bytes, attachment: bytes) -> bytes:
    """A message in one piece from its JSON and its attachment."""
    return b"%b\n%b" % (json, attachment)


def split_attachment(data: bytes) -> tuple[bytes, bytes]:
    """A message's JSON and its attachment, b"" when it has none."""
    json, _, attachment = data.partition(b"\n")
    return json, attachment


def decode_request(kind: Any, data: bytes, parameters: Mapping[str, str], *, needs_field: bool = False) -> Any:
    """The payload of a request: its JSON body, or its selector's parameters, decoded into the same struct.

    Args:
        parameters: as strings; values are JSON where they parse and text elsewhere. Names that start with `_` belong
            to Zenoh and are ignored.
        needs_field: refuse a request that names no field, of a type whose fields all have defaults.

    Raises:
        BadPayloadError: as `decode`; also when body and parameters are both given, or none is and one is needed.
    """
    given = {name: value for name, value in parameters.items() if not name.startswith("_")}
    if data and given:
        raise BadPayloadError(f"both a payload and parameters ({', '.join(sorted(given))}): send one of them")
    if needs_field and not given and data.translate(None, b" \t\r\n") in (b"", b"{}"):
        example = _own_fields(kind)[0]
        raise BadPayloadError(
            "the request names no field, so it may be a mistake: name at least one, such as "
            f"{example}, or a goal_id of your choice"
        )
    if data:
        return decode(kind, data)
    fields = {plain(name): _json_or_text(value) for name, value in given.items()}
    try:
        return msgspec.convert(fields, kind)
    except msgspec.ValidationError as error:
        raise BadPayloadError(mistake(error, kind)) from None


def _own_fields(kind: Any) -> list[str]:
    """Names of a struct's fields, its own before those of its base."""
    fields: tuple[str, ...] = kind.__struct_fields__
    inherited = {name for base in kind.__bases__ for name in getattr(base, "__struct_fields__", ())}
    return sorted(fields, key=lambda name: name in inherited)


def _json_or_text(value: str) -> Any:
    try:
        return msgspec.json.decode(plain_json(value.encode()))
    except (msgspec.DecodeError, UnicodeEncodeError, RecursionError):
        return plain(value)
