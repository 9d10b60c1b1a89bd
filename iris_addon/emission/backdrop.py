"""What cameras see where the mesh has holes: the surfaces that a scan missed, not the light that comes through.

Light from outside the mesh stands for everything beyond it together, lamps among it. To a camera that looks through a
hole under a table it would be a glaring patch. The photos show what is there; low harmonics of it are enough for a
background.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..photo_samples import BeyondMesh
from ..photometry import Photometry
from ..result.sh import fit_sh, sh_basis

MIN_SHARE = 2e-3
"""Share of all pixels from which what lies beyond the mesh is worth a background."""
RIDGE = 0.02
"""Directions that no photo shows stay near the mean."""
OUTLIER, LEAST_SCALE = 0.5, 0.01
"""Relative deviation of an outlier, and of the mean, from which on radiance counts as bright."""
ROUNDS = 4


def fit_backdrop(beyond: BeyondMesh, photometry: Photometry) -> NDArray[np.float64] | None:
    """(9, 3) spherical harmonics of the radiance of the pixels that miss the mesh, None where hardly any do."""
    if beyond.share < MIN_SHARE:
        return None
    linear = photometry.linearise_pixels(beyond.z, beyond.view, beyond.pixel)
    radiance = np.where(linear.open, linear.radiance, linear.bound).astype(np.float64)
    mean = radiance.mean(1)
    if not mean.any():
        return np.zeros((9, 3))
    # Half of it may be black: a render before an empty world.
    scale = mean + max(float(np.median(mean)), LEAST_SCALE * float(mean.mean()))
    weight = 1 / scale**2
    for _ in range(ROUNDS - 1):
        sh = fit_sh(beyond.direction, radiance, weight / weight.sum(), RIDGE)
        off = np.abs(sh_basis(beyond.direction, 9) @ sh - radiance).mean(1) / scale / OUTLIER
        weight = 1 / scale**2 / (1 + off**2)
    return fit_sh(beyond.direction, radiance, weight / weight.sum(), RIDGE)
