"""Parts of a scan that are one material after all.

A scan is split where the colour of its photos steps (:mod:`iris_addon.surface.segment`), before anything is known of
the light: the edge of a shadow or of a highlight splits a cupboard's front as well as the edge of its paint does. Once
light is divided out, what is left on both sides of such a border is the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..grouping import group_equal, group_medians, group_sums

STEP = 0.06
"""Step of log albedo across a border up to which both sides are one material."""
APART = 0.25
"""Difference of mean log albedo at which they are not, however small the steps on the way."""
MIN_BORDER = 5
"""Edges of the mesh that a border must have to tell."""


def joined_parts(
    parts: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    log_albedo: NDArray[np.float64],
    pixels: NDArray[np.integer],
    scanned: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(n_parts,) material of each part: the same label for parts of a scan across whose borders albedo takes no step.

    Args:
        parts: (F,) part per face.
        log_albedo: (F, 3) of each face, where it has ``pixels`` (F,).
        scanned: (F,) faces of a scan; the parts of all others stay apart.
    """
    n = int(parts.max()) + 1
    a, b = adjacency
    told = scanned & (pixels > 0)
    border = told[a] & told[b] & (parts[a] != parts[b])
    a, b = a[border], b[border]
    swap = parts[a] > parts[b]
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    groups = group_equal(parts[a].astype(np.int64) * n + parts[b])
    step = np.abs(group_medians(log_albedo[a] - log_albedo[b], groups.group, len(groups.keys))).max(1)
    step[groups.count < MIN_BORDER] = np.inf
    weight = np.where(told, pixels, 0)[:, None].astype(np.float64)
    total, sums = group_sums(weight, parts, n), group_sums(weight * np.where(told[:, None], log_albedo, 0.0), parts, n)
    label = np.arange(n, dtype=np.int32)
    for k in np.argsort(step, kind="stable"):
        if step[k] > STEP:
            break
        one, other = label[groups.keys[k] // n], label[groups.keys[k] % n]
        if one != other and np.abs(sums[one] / total[one] - sums[other] / total[other]).max() < APART:
            sums[one] += sums[other]
            total[one] += total[other]
            label[label == other] = one
    return label
