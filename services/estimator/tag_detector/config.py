"""Settings of the tag detector."""

from typing import Annotated

from msgspec import Meta

from jezero.base.config import Config

Positive = Annotated[float, Meta(gt=0.0, le=1e3)]


class TagDetectorConfig(Config, frozen=True, kw_only=True):
    """Detection of tags, and the errors of their corners.

    Attributes:
        decimate: factor by which the image is made smaller for the search of quadrilaterals; corners are refined in the
            full image.
        margin_min: minimum contrast of a tag's cells, in grey levels; a tag with less is rejected.
        std_corner_px: standard deviation of the independent error of each corner.
        std_common_px: standard deviation of the error that all corners of an image share.
        reprojection_max_px: maximum RMS distance of the corners from their projection; a pose with a larger one is
            rejected.
    """

    decimate: Annotated[float, Meta(ge=1.0, le=4.0)] = 2.0
    margin_min: Positive = 25.0
    std_corner_px: Positive = 0.3
    std_common_px: Positive = 0.2
    reprojection_max_px: Positive = 1.5
