"""What errors of the irradiance leave in the albedo of even surfaces.

Traced irradiance is right to a few percent, with errors that change slowly over a surface; divided by it, a wall has
blotches of light for paint. Paint is even over a part or has detail, so a slow change of a few percent is taken for an
error of the light, as far as the part shows no larger ones (after the retinex of Land and McCann, JOSA 1971). Where
lamps stand outside the mesh the light is further off than that: by how much, the evenest surfaces tell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..grouping import MAD, group_medians, group_sums
from ..surface.field import IrradianceField
from .bake import DIM_ALBEDO

LIGHT_ERROR, WORST_ERROR = 0.03, 0.15
"""Standard deviation of the log irradiance of patches, at least and at most."""
EVENEST, OVER_EVENEST = 0.1, 1.6
"""The error is so many times the spread of the part that this share of the patches lie on or on a more even one: the
ratio that it has where lamps are known."""
SLOW = 3.0
"""Patch sizes over which errors of the irradiance change."""
FEATURE = 10 / 3
"""Errors of the light from which a slow difference in log albedo is rather a stain."""


def residual_light(
    field: IrradianceField,
    part: NDArray[np.integer],
    even: NDArray[np.bool_],
    patch: NDArray[np.integer],
    albedo: NDArray[np.floating],
    weight: NDArray[np.floating],
) -> NDArray[np.float64]:
    """(P, 3) factor by which each patch is brighter than its traced irradiance accounts for; near 1.

    Args:
        part: (P,) part of each patch.
        even: (n_parts,) parts that may be taken for even: no metals, whose base colour is no quotient of irradiance.
        patch: (n,) patch of each pixel.
        albedo, weight: (n, 3) of each pixel, and its say.
    """
    n_patches, n_parts = len(part), len(even)
    norm = group_sums(weight, patch, n_patches)
    level = group_sums(weight * np.log(albedo + DIM_ALBEDO), patch, n_patches) / np.maximum(norm, 1e-12)
    seen = norm.min(1) > 0
    off = np.zeros((n_patches, 3))
    off[seen] = level[seen] - group_medians(level[seen], part[seen], n_parts)[part[seen]]
    around = field.kernel(SLOW, group=part)
    say = np.where(seen, np.minimum(norm.mean(1), 1.0), 0.0)[:, None]
    # Twice, or detail as fine as a patch would be in the average of ten of them.
    slow = (around @ (around @ (say * off))) / np.maximum(around @ (around @ say), 1e-12)
    spread = MAD * group_medians(np.abs(slow[seen]), part[seen], n_parts).mean(1)
    error = _light_error(spread[part[seen & even[part]]])
    share = even / np.maximum(spread / error, 1.0) ** 2
    return np.exp(share[part][:, None] * slow / (1 + (slow / (FEATURE * error)) ** 4))


def _light_error(spread: NDArray[np.floating]) -> float:
    """Standard deviation of the log irradiance, from the slow spread (n,) within the part of each patch."""
    evenest = float(np.quantile(spread, EVENEST)) if len(spread) else 0.0
    return float(np.clip(OVER_EVENEST * evenest, LIGHT_ERROR, WORST_ERROR))
