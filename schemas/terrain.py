"""Ground of the simulator, for people to look at. Nothing that flies may read it: a real vehicle has no such map."""

from typing import Annotated

from msgspec import Meta

from jezero.schemas.struct import NonNegative, Payload, PositionNed, Text

SIDE_MAX = 128
ROCKS_MAX = 300
HeightMm = Annotated[int, Meta(ge=-100_000, le=100_000)]
Row = Annotated[tuple[HeightMm, ...], Meta(max_length=SIDE_MAX)]


class GetGround(Payload, frozen=True, kw_only=True):
    """Request for the ground; it has no fields."""


class Rock(Payload, frozen=True, kw_only=True):
    """One rock, half buried.

    Attributes:
        pos_rock_ned_m: position of its middle.
        radius_m: mean distance of its surface from the middle.
    """

    pos_rock_ned_m: PositionNed
    radius_m: NonNegative


class Ground(Payload, frozen=True, kw_only=True):
    """Reply to `GetGround`: heights on a grid of squares, and the rocks.

    Positions are in the frame of `Truth`: NED with its origin where the vehicle first stood. The world frame differs
    from it by the autopilot's error. Beyond the grid the ground is level, with the height of the grid's edge.

    Attributes:
        reason: reason why there is no ground, for people; "" with one.
        spacing_m: distance between two neighbours of the grid.
        corner_ned_m: point of the first height of the first row, at height 0.
        heights_mm: heights above the corner's z, positive up; rows to the north, columns to the east.
        rocks: all rocks.
    """

    reason: Text = ""
    spacing_m: NonNegative = 0.0
    corner_ned_m: PositionNed = (0.0, 0.0, 0.0)
    heights_mm: Annotated[tuple[Row, ...], Meta(max_length=SIDE_MAX)] = ()
    rocks: Annotated[tuple[Rock, ...], Meta(max_length=ROCKS_MAX)] = ()
