"""Base classes and checked number types of every message."""

import math
from collections.abc import Iterable
from typing import Annotated, Any, ClassVar, Self

import msgspec
from msgspec import Meta


class Payload(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of everything that travels on the bus.

    Decoding refuses unknown fields and values out of range, and frees texts of control characters.

    Attributes:
        has_lines: whether its texts may have several lines; otherwise decoding joins them to one.
    """

    has_lines: ClassVar[bool] = False

    def __deepcopy__(self, memo: object) -> Self:
        """The same payload: nothing changes it, so that the copy of a state shares it."""
        return self


class Message(Payload, frozen=True, kw_only=True):
    """Payload of a topic.

    Attributes:
        t_ns: vehicle time at which the content was true.
    """

    t_ns: "TimeNs"


class WithAttachment:
    """Mixin of a payload with bytes that travel beside the JSON of its other fields, as they are.

    Attributes:
        attached_field: name of the field that has these bytes; it is empty in a payload without its attachment.
    """

    __slots__ = ()
    attached_field: ClassVar[str]

    @property
    def attachment(self) -> bytes:
        """Bytes that travel beside the JSON."""
        data: bytes = getattr(self, self.attached_field)
        return data

    def with_attachment(self, data: bytes) -> Self:
        """Copy of the payload with another attachment, which only `check_attachment` checks."""
        return msgspec.structs.replace(self, **{self.attached_field: data})  # type: ignore[type-var]

    def check_attachment(self) -> None:
        """Compare the attachment with the other fields.

        Raises:
            ValueError: they don't fit; the text says why.
        """
        raise NotImplementedError


class WithReadings:
    """Mixin of a message with a list of readings, each of which stands for itself: a bad one is left out.

    Attributes:
        readings_field: name of the field that has them.
    """

    __slots__ = ()
    readings_field: ClassVar[str]

    @property
    def readings(self) -> tuple[Any, ...]:
        """The readings."""
        found: tuple[Any, ...] = getattr(self, self.readings_field)
        return found

    def with_readings(self, readings: Iterable[Any]) -> Self:
        """Copy of the message with other readings."""
        return msgspec.structs.replace(self, **{self.readings_field: tuple(readings)})  # type: ignore[type-var]


class WithPixels(WithAttachment):
    """Mixin of a payload whose attachment is pixels as they are.

    A subclass declares the fields `width_px`, `height_px` and `pixels`.

    Attributes:
        width_px: number of columns.
        height_px: number of rows.
        pixels: rows from the top, three bytes per pixel: red, green, blue.
    """

    __slots__ = ()
    attached_field = "pixels"
    width_px: int
    height_px: int
    pixels: bytes

    def check_attachment(self) -> None:
        """Raise ValueError where the pixels are not three bytes for each pixel."""
        if len(self.pixels) != 3 * self.width_px * self.height_px:
            size = f"{self.width_px} x {self.height_px}"
            raise ValueError(f"{len(self.pixels)} bytes are not {size} pixels of three bytes")


TimeNs = Annotated[int, Meta(ge=0, le=2**62)]
"""Vehicle time in ns since the time master's start."""

Finite = Annotated[float, Meta(ge=-1e12, le=1e12)]
"""Any finite number; the bounds also refuse NaN and infinity."""

NonNegative = Annotated[float, Meta(ge=0.0, le=1e12)]
"""Finite number from 0."""
Position = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Coordinate in metres."""
NearPosition = Annotated[float, Meta(ge=-1e5, le=1e5)]
"""Measured or estimated coordinate in metres: sums and differences of two or three are within `Position`."""
Speed = Annotated[float, Meta(ge=-1e3, le=1e3)]
"""Velocity component in m/s."""
Angle = Annotated[float, Meta(ge=-6.2832, le=6.2832)]
"""Angle in radians."""
Unit = Annotated[float, Meta(ge=-1.0001, le=1.0001)]
"""Component of a unit vector or quaternion."""
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
"""Number from 0 to 1."""

PositionNed = tuple[Position, Position, Position]
RallyPoints = Annotated[tuple[tuple[Position, Position], ...], Meta(max_length=100)]
"""(n, 2) north and east of places on the ground where a vehicle that returns may land."""
NearPositionNed = tuple[NearPosition, NearPosition, NearPosition]
VelocityNed = tuple[Speed, Speed, Speed]
QuatNedFromFrd = tuple[Unit, Unit, Unit, Unit]
"""Attitude [w, x, y, z] that turns body FRD into world NED, w >= 0; see `require_rotation`."""
Vector = tuple[Finite, Finite, Finite]

END = r"$(?!\n)"
"""End of a pattern, in Python and in JSON Schema: a plain `$` also matches before a line feed at the end of a text."""

Name = Annotated[str, Meta(max_length=64, pattern=rf"^[A-Za-z0-9_.-]+{END}")]
"""Identifier that is safe within a key."""
TEXT_MAX = 2000
Text = Annotated[str, Meta(max_length=TEXT_MAX)]
"""A sentence for people, in one line."""


def require_rotation(field: str, q: tuple[float, float, float, float]) -> None:
    """Check that a field holds a quaternion of unit length, for the `__post_init__` of a message.

    One that is not finite can't arrive, as JSON has no such numbers.

    Raises:
        ValueError: its length is another one.
    """
    length = math.hypot(*q)
    if math.isfinite(length) and not 0.99 <= length <= 1.01:
        raise ValueError(f"{field} has the length {length:.3g}: a quaternion of length 1 is expected")
