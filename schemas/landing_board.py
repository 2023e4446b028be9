"""The landing board on the rover's platform: AprilTags of the family 36h11, their ids, sides and positions.

Renderer, projected camera and tag detector use the same table. Heights from which a tag of the board of 0.6 m is in
view of a camera that points straight down and is 80 degrees wide: the big tag (id 77) from about 1 m up; the tag nested
in its middle (id 1) from 0.1 m to 1.5 m; the small tags around it from 0.4 m down to standing, also for a vehicle that
stands 10 cm beside the middle, at any heading.

A tag of 8 x 8 cells has a white margin of one more cell. The small tags sit where the big tag's cells meet, so that the
middles of its cells, which a detector samples, stay free. The nested one hides the four middle cells of the big tag
behind its own white margin: 77 is one of the few ids of which these four are white anyhow.
"""

from collections.abc import Sequence
from typing import Annotated

import msgspec
from msgspec import Meta

_Place = Annotated[float, Meta(ge=-10.0, le=10.0)]

CELLS = 8
"""Cells along the side of a tag's black square; the margin is one cell."""

BIG_ID = 77
SIDE_BIG_M = 0.6
NESTED_PER_BIG, SMALL_PER_BIG = 0.12, 0.04
"""Sides of the nested and of the small tags, relative to that of the big tag."""


class BoardTag(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One tag, lying flat on the platform, the top of its image towards the rover's nose.

    Attributes:
        tag_id: id of the tag in the family 36h11.
        side_m: side of the black square.
        pos_rover_body_m: position of the tag's middle; its z is 0, the platform's surface.
    """

    tag_id: Annotated[int, Meta(ge=0, le=586)]
    side_m: Annotated[float, Meta(gt=0.0, le=10.0)]
    pos_rover_body_m: tuple[_Place, _Place, _Place]

    @property
    def corners_rover_body_m(self) -> tuple[tuple[float, float, float], ...]:
        """(4, 3) corners of the black square: top left, top right, bottom right, bottom left of the tag's image."""
        forward_m, right_m, down_m = self.pos_rover_body_m
        half_m = 0.5 * self.side_m
        return (
            (forward_m + half_m, right_m - half_m, down_m),
            (forward_m + half_m, right_m + half_m, down_m),
            (forward_m - half_m, right_m + half_m, down_m),
            (forward_m - half_m, right_m - half_m, down_m),
        )


def make_board(side_big_m: float = SIDE_BIG_M) -> tuple[BoardTag, ...]:
    """Tags 77 (big), 1 (nested) and 2–25 (small), in the order in which they are painted."""
    pitch_m = side_big_m / CELLS
    tags = [
        BoardTag(tag_id=BIG_ID, side_m=side_big_m, pos_rover_body_m=(0.0, 0.0, 0.0)),
        BoardTag(tag_id=1, side_m=side_big_m * NESTED_PER_BIG, pos_rover_body_m=(0.0, 0.0, 0.0)),
    ]
    for row in (2, 1, 0, -1, -2):
        for column in (-2, -1, 0, 1, 2):
            if (row, column) != (0, 0):
                pos_m = (row * pitch_m, column * pitch_m, 0.0)
                tags.append(BoardTag(tag_id=len(tags), side_m=side_big_m * SMALL_PER_BIG, pos_rover_body_m=pos_m))
    return tuple(tags)


def board_refusal(board: Sequence[BoardTag], side_platform_m: float) -> str:
    """Reason why a platform can't carry these tags with their margins, or ""."""
    ids = [tag.tag_id for tag in board]
    if len(set(ids)) < len(ids):
        return "two tags of the board have the same id"
    for tag in board:
        reach_m = 0.5 * tag.side_m * (CELLS + 2) / CELLS + max(abs(at_m) for at_m in tag.pos_rover_body_m[:2])
        if reach_m > 0.5 * side_platform_m + 1e-9:
            return (
                f"tag {tag.tag_id} with its margin reaches {reach_m:.3f} m from the middle of the platform, "
                f"whose edge is at {0.5 * side_platform_m:.3f} m: make the tag smaller or the platform larger"
            )
    return ""
