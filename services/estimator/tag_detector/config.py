"""Settings of the tag detector."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config

Positive = Annotated[float, Meta(gt=0.0, le=1e3)]


class TagDetectorConfig(Config, frozen=True, kw_only=True):
    """What is believed of a picture.

    Attributes:
        decimate: quads are looked for in a picture smaller by this factor; corners are refined in the full one.
        margin_min: contrast of the tag's cells, in grey levels, below which it counts as a mistake.
        border_px: a tag with a corner this near to the picture's edge may be cut off.
        std_corner_px: of each corner, independent.
        std_common_px: of what all corners of a picture have in common.
        reprojection_max_px: RMS distance of the corners from where the pose puts them; above it the picture is wrong.
        attitude_age_max_s: how far the exposure may be from the nearest known attitude.
    """

    decimate: Annotated[float, Meta(ge=1.0, le=4.0)] = 2.0
    margin_min: Positive = 25.0
    border_px: Positive = 2.0
    std_corner_px: Positive = 0.3
    std_common_px: Positive = 0.2
    reprojection_max_px: Positive = 1.5
    attitude_age_max_s: Positive = 0.06
