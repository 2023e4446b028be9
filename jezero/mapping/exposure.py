"""Gains that give all images the same brightness and colour, as if the camera had kept its exposure.

Source: Brown and Lowe 2007, Automatic panoramic image stitching using invariant features, section 6, in logarithms.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from jezero.mapping.matching import Matches
from jezero.mapping.projection import Field
from jezero.mapping.seams import SeamView, common_part

STD_RATIO = 0.02
STD_GAIN = 0.3
"""Standard deviations, in logarithms: of the ratio of two images in the same place, and of a gain."""
CELLS_MIN = 20
DARK = 4.0
"""Darker colours, such as shadows at the black end of the camera's range, say nothing about the exposure."""


def find_gains(views: Mapping[int, SeamView], matches: Sequence[Matches]) -> dict[int, Field]:
    """Find the (3,) gains of red, green and blue by which each image is to be multiplied.

    Args:
        views: the images by number.
        matches: pairs of images that show the same ground.
    """
    index = {number: i for i, number in enumerate(views)}
    normal = np.eye(len(views)) / STD_GAIN**2
    right = np.zeros((len(views), 3))
    for pair in matches:
        if pair.first not in index or pair.second not in index:
            continue
        ratio = _log_ratio(views[pair.first], views[pair.second])
        if ratio is None:
            continue
        i, j = index[pair.first], index[pair.second]
        normal[[i, j], [i, j]] += 1.0 / STD_RATIO**2
        normal[[i, j], [j, i]] -= 1.0 / STD_RATIO**2
        right[i] -= ratio / STD_RATIO**2
        right[j] += ratio / STD_RATIO**2
    gains = np.exp(np.linalg.solve(normal, right)).astype(np.float32)
    return {number: gains[i] for number, i in index.items()}


def _log_ratio(first: SeamView, second: SeamView) -> Field | None:
    """Median logarithm of the first image's colours over the second's, where both show the ground."""
    common = common_part(first.place, second.place)
    if common is None:
        return None
    a, b = first.colours[common[0]], second.colours[common[1]]
    with np.errstate(invalid="ignore"):
        usable = (np.minimum(a, b) > DARK).all(axis=2)
    if np.count_nonzero(usable) < CELLS_MIN:
        return None
    return np.asarray(np.median(np.log(a[usable] / b[usable]), axis=0), np.float32)
