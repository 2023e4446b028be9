"""The landing board on the rover's platform: AprilTags of the family 36h11, their ids, sides and places.

Renderer, projected camera and tag detector read the same table. Heights from which a tag is in view, camera straight
down, 80 degrees wide: the big tag (id 77) from about 1 m up; the one nested in its middle (id 1) from 0.1 m to 1.5 m;
the small ones around it from 0.4 m down to standing, also for a vehicle that stands 10 cm beside the middle, whatever
its heading.

A tag of 8 x 8 cells has a white margin of one more cell. The small tags sit where the big tag's cells meet, so that the
middles of its cells, which a detector samples, stay free. The nested one hides the four middle cells of the big tag
behind its own white margin: 77 is one of the few ids of which these four are white anyhow.
"""

from typing import Annotated

import msgspec
from msgspec import Meta

CELLS = 8
"""Along the side of a tag's black square; the margin is one cell."""

BIG_ID = 77


class BoardTag(msgspec.Struct, frozen=True, kw_only=True):
    """One tag, lying flat on the platform, the top of its picture towards the rover's nose.

    Attributes:
        side_m: of the black square.
        pos_rover_body_m: of its middle; z is 0, the platform's surface.
    """

    tag_id: Annotated[int, Meta(ge=0, le=586)]
    side_m: Annotated[float, Meta(gt=0.0, le=10.0)]
    pos_rover_body_m: tuple[float, float, float]

    @property
    def corners_rover_body_m(self) -> tuple[tuple[float, float, float], ...]:
        """(4, 3) corners of the black square: top left, top right, bottom right, bottom left of the tag's picture."""
        forward_m, right_m, down_m = self.pos_rover_body_m
        half_m = 0.5 * self.side_m
        return (
            (forward_m + half_m, right_m - half_m, down_m),
            (forward_m + half_m, right_m + half_m, down_m),
            (forward_m - half_m, right_m + half_m, down_m),
            (forward_m - half_m, right_m - half_m, down_m),
        )


def _make_board() -> tuple[BoardTag, ...]:
    big_m, nested_m, small_m = 0.6, 0.072, 0.024
    pitch_m = big_m / CELLS
    tags = [
        BoardTag(tag_id=BIG_ID, side_m=big_m, pos_rover_body_m=(0.0, 0.0, 0.0)),
        BoardTag(tag_id=1, side_m=nested_m, pos_rover_body_m=(0.0, 0.0, 0.0)),
    ]
    for row in (2, 1, 0, -1, -2):
        for column in (-2, -1, 0, 1, 2):
            if (row, column) != (0, 0):
                place = (row * pitch_m, column * pitch_m, 0.0)
                tags.append(BoardTag(tag_id=len(tags), side_m=small_m, pos_rover_body_m=place))
    return tuple(tags)


LANDING_BOARD: tuple[BoardTag, ...] = _make_board()
"""Tags 77 (big), 1 (nested) and 2–25 (small), in the order in which they are painted."""
