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
from ..result.sh import sh_basis

MIN_SHARE = 2e-3
"""Share of all pixels from which what lies beyond the mesh is worth a background."""
RIDGE = 0.02
"""Relative; directions that no photo shows stay near the mean."""
OUTLIER = 0.5


def fit_backdrop(beyond: BeyondMesh, photometry: Photometry) -> NDArray[np.float64] | None:
    """(9, 3) spherical harmonics of the radiance of the pixels that miss the mesh, None where hardly any do."""
    if beyond.share < MIN_SHARE:
        return None
    linear = photometry.linearise_pixels(beyond.z, beyond.view)
    radiance = np.where(linear.open, linear.radiance, linear.bound).astype(np.float64)
    basis = sh_basis(beyond.direction, 9)
    typical = np.median(radiance.mean(1))
    weight = 1 / (radiance.mean(1) + typical) ** 2
    ridge = RIDGE * np.diag([0.0] + [1.0] * 8)
    sh = np.zeros((9, 3))
    for _ in range(4):
        w = (weight / weight.sum())[:, None]
        sh = np.linalg.solve(basis.T @ (w * basis) + ridge, basis.T @ (w * radiance))
        off = (np.abs(basis @ sh - radiance).mean(1) / (radiance.mean(1) + typical)) / OUTLIER
        weight = 1 / (radiance.mean(1) + typical) ** 2 / (1 + off**2)
    return sh
