"""Corners of the tags in a picture."""

from functools import cache
from typing import Any

import cv2
import numpy as np
from pupil_apriltags import Detector

from jezero.schemas.sensors import CameraFrame, CornersOfTag
from jezero.services.estimator.tag_detector.config import TagDetectorConfig

HALF_PIXEL = 0.5
"""The library's origin is the first pixel's edge, ours is its middle."""
BORDER_PX = 2.0
"""A tag with a corner this near to the picture's edge may be cut off."""
IN_PICTURE_ORDER = (1, 0, 3, 2)
"""Indices of the library's corners in our order: top left, top right, bottom right, bottom left."""


class _Detector(Detector):  # type: ignore[misc]
    """The library's detector, which is never freed: it frees its parts in the wrong order and crashes."""

    def __del__(self) -> None: ...


@cache
def _detector(decimate: float) -> _Detector:
    """The detector of this process, shared because each one needs 37 MB."""
    return _Detector(families="tag36h11", nthreads=1, quad_decimate=decimate)


class Finder:
    """Finds AprilTags of the family 36h11 with the AprilTag 3 library."""

    def __init__(self, config: TagDetectorConfig) -> None:
        self._config = config
        self._detector = _detector(config.decimate)

    def find(self, frame: CameraFrame) -> tuple[CornersOfTag, ...]:
        """All tags that are wholly in the picture, of any board."""
        pixels = np.frombuffer(frame.pixels, np.uint8).reshape(frame.height_px, frame.width_px, 3)
        found = self._detector.detect(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))
        return tuple(tag for each in found if (tag := self._tag(each, frame)) is not None)

    def _tag(self, found: Any, frame: CameraFrame) -> CornersOfTag | None:
        if found.hamming > 0 or found.decision_margin < self._config.margin_min:
            return None
        corners_px = found.corners - HALF_PIXEL
        high = np.array((frame.width_px - 1 - BORDER_PX, frame.height_px - 1 - BORDER_PX))
        if (corners_px < BORDER_PX).any() or (corners_px > high).any():
            return None
        first, second, third, fourth = ((float(corners_px[i][0]), float(corners_px[i][1])) for i in IN_PICTURE_ORDER)
        return CornersOfTag(tag_id=int(found.tag_id), corners_px=(first, second, third, fourth))
