"""Photos that lie under the pose of another: files renamed, sorted otherwise, or copied over each other.

Such a capture fits its mesh as a whole, and a solve averages the wrong photos in. Edges tell: the photo fits another
pose far better than its own, and better than the photo that lies there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .alignment import correlation, near_no_shift

EXCHANGED_PEAK = 7.0
"""Least peak of a photo's edges under another pose, in standard deviations over all shifts (experiment 0160)."""
EXCHANGED_FACTOR = 2.0
"""Multiple of both photos' peaks under their own poses that it must be. Neighbours of a scan reach 2.4 at peaks below
6, and 1.6 at higher ones."""
EXCHANGED_REACH = 2
"""Shift, in pixels of the small pictures, up to which edges count as fitting."""

Edges = NDArray[np.float32]


def exchanged(photos: Sequence[Edges], poses: Sequence[Edges]) -> dict[int, int]:
    """Photos that belong to the pose of another, and which.

    Args:
        photos: (h, w) band-passed edges of each photo.
        poses: (h, w) those of the mesh under the pose of each.
    """
    own = [peak(photo, pose) for photo, pose in zip(photos, poses, strict=True)]
    # Under another's pose, edges agree by chance alone; those that fit better need not be compared with every pose.
    suspects = [k for k, value in enumerate(own) if value < EXCHANGED_PEAK / EXCHANGED_FACTOR]
    found = {}
    for k in suspects:
        others = [(peak(photos[k], poses[j]), j) for j in suspects if j != k and poses[j].shape == photos[k].shape]
        fit, best = max(others, default=(0.0, k))
        if fit > EXCHANGED_PEAK and fit > EXCHANGED_FACTOR * max(own[k], own[best]):
            found[k] = best
    return found


def peak(photo: Edges, pose: Edges) -> float:
    """Height of the correlation near no shift, in standard deviations over all shifts; 0 where there are no edges."""
    full = correlation(photo, pose)
    if full is None:
        return 0.0
    near, reach = near_no_shift(full)
    around = slice(max(reach - EXCHANGED_REACH, 0), reach + EXCHANGED_REACH + 1)
    return float(near[around, around].max() / max(full.std(), 1e-9))
