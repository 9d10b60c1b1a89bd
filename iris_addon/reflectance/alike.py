"""Parts that are painted alike.

The slats of a blind, the mouldings of a window and its frame are parts of their own and one paint. What a small part
says of its colour is what light, wrong by a tenth beside a moulding, says of it; the large ones of the same paint know
better. So the parts of a room are joined as far as their colours agree within the errors of the light (DP-means,
Kulis and Jordan, ICML 2012, with the largest parts first).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..grouping import MAD, group_medians
from .bake import DIM_ALBEDO
from .paint import COLOUR, best_lit

OF_PARTS = 0.04
"""Standard deviation of the log albedo that a part of one colour is given, on even ground: its light is off as a whole
by more than it is from pixel to pixel."""
PER_TEXTURE = 0.25
"""Of the spread of its own texels, by which the median of a textured part is off."""
LEAST = 5
"""Texels of a part from which on it is asked."""


def painted_alike(
    albedo: NDArray[np.floating],
    error: NDArray[np.floating],
    part: NDArray[np.integer],
    painted: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(n_parts,) a part that stands for all that are painted as each is; their own label where there is no other.

    Args:
        albedo: (T, 3) of texels that photos show well, NaN in channels that all photos clip.
        error: (T,) standard deviation of the log irradiance behind each.
        part: (T,) part of each.
        painted: (n_parts,) parts that may share their paint.
    """
    n_parts = len(painted)
    label = np.arange(n_parts, dtype=np.int32)
    size = np.bincount(part, minlength=n_parts)
    whole = np.isfinite(albedo).all(1) & painted[part]
    log_albedo, error, part = np.log(albedo[whole] + DIM_ALBEDO), error[whole], part[whole]
    sure = best_lit(error, part, n_parts)
    log_albedo, error, part = log_albedo[sure], error[sure], part[sure]
    level = group_medians(log_albedo, part, n_parts)
    texture = group_medians(np.abs(log_albedo - level[part]), part, n_parts).max(1) * MAD
    light = group_medians(error[:, None], part, n_parts)[:, 0]
    variance = OF_PARTS**2 + light**2 + (PER_TEXTURE * texture) ** 2
    enough = np.bincount(part, minlength=n_parts) >= LEAST
    asked = np.flatnonzero(enough)[np.argsort(-size[enough], kind="stable")]
    label[asked] = asked[_joined(level[asked], variance[asked])]
    return label


def _joined(level: NDArray[np.floating], variance: NDArray[np.floating]) -> NDArray[np.int64]:
    """(k,) for each of k colours the nearest of those before it that stand for others, if it is no further than one
    standard deviation of their difference, else itself."""
    stands = np.arange(len(level))
    own = np.zeros(len(level), bool)
    for k in range(len(level)):
        others = np.flatnonzero(own[:k])
        off = level[others] - level[k]
        grey = off.mean(1)
        square = grey**2 + ((off - grey[:, None]) ** 2).sum(1) / (2 * COLOUR**2)
        distance = square / (variance[others] + variance[k])
        own[k] = not (distance <= 1).any()
        if not own[k]:
            stands[k] = others[np.argmin(distance)]
    return stands
