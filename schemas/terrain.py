"""Ground of the simulator, for people to look at. Nothing that flies may read it: a real vehicle has no such map."""

from typing import Annotated

from msgspec import Meta

from jezero.schemas.struct import NonNegative, Payload, PositionNed, Text

SIDE_MAX = 128
ROCKS_MAX = 300
TRIANGLES_MAX = 500
OBSTACLES_MAX = 220
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
CornerIndex = Annotated[int, Meta(ge=0, lt=3 * TRIANGLES_MAX)]
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


class Obstacle(Payload, frozen=True, kw_only=True):
    """A thing that stands in the terrain, as its triangles.

    A thing of more than 500 triangles comes as the box around it.

    Attributes:
        name: its name, for people.
        colour: red, green and blue of all of it, from 0 to 1.
        pos_corners_ned_m: positions of the corners.
        triangles: for each triangle the indices of its three corners, counter-clockwise from outside.
    """

    name: Text
    colour: tuple[Share, Share, Share]
    pos_corners_ned_m: Annotated[tuple[PositionNed, ...], Meta(max_length=3 * TRIANGLES_MAX)]
    triangles: Annotated[tuple[tuple[CornerIndex, CornerIndex, CornerIndex], ...], Meta(max_length=TRIANGLES_MAX)]


class Ground(Payload, frozen=True, kw_only=True):
    """Reply to `GetGround`: heights on a grid of squares, the rocks, and what else stands in it.

    Positions are in the frame of `Truth`: NED with its origin where the vehicle first stood. The world frame differs
    from it by the autopilot's error. Beyond the grid the ground is level, with the height of the grid's edge.

    Attributes:
        reason: reason why there is no ground, for people; "" with one.
        spacing_m: distance between two neighbours of the grid.
        corner_ned_m: point of the first height of the first row, at height 0.
        heights_mm: heights above the corner's z, positive up; rows to the north, columns to the east.
        rocks: all rocks.
        obstacles: all other things.
    """

    reason: Text = ""
    spacing_m: NonNegative = 0.0
    corner_ned_m: PositionNed = (0.0, 0.0, 0.0)
    heights_mm: Annotated[tuple[Row, ...], Meta(max_length=SIDE_MAX)] = ()
    rocks: Annotated[tuple[Rock, ...], Meta(max_length=ROCKS_MAX)] = ()
    obstacles: Annotated[tuple[Obstacle, ...], Meta(max_length=OBSTACLES_MAX)] = ()
