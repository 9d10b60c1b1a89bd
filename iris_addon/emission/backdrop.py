"""What cameras see where the mesh has holes: the surfaces that a scan missed, not the light that comes through.

Light from outside the mesh stands for everything beyond it together, lamps among it. To a camera that looks through a
hole under a table it would be a glaring patch, and so it would be mirrored by a varnished front. The photos show what
is there, but not how far away: pixels that miss the mesh are painted onto a shell around it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ..capture.types import Mesh, View
from ..photo_samples import BeyondMesh
from ..photometry import Photometry
from ..result.types import Backdrop
from .shell import shell_around

MIN_SHARE = 2e-3
"""Share of all pixels from which what lies beyond the mesh is worth a backdrop."""
HEIGHT = 128
"""Rows of the picture: 1.4 degrees a texel, 6 cm at two and a half metres."""
OUTLIER = 0.3
"""Deviation in log radiance of an outlier: something in front of what most photos show."""
FLOOR = 0.01
"""Of the mean radiance, added before the logarithm is taken."""
ENOUGH = 1e-3
"""Pixels per texel, from which on their surroundings are not asked."""
ROUNDS = 4


def fit_backdrop(beyond: BeyondMesh, photometry: Photometry, mesh: Mesh, views: Sequence[View]) -> Backdrop | None:
    """A shell around mesh and cameras with the radiance of the pixels that miss the mesh; None if hardly any do."""
    if beyond.share < MIN_SHARE:
        return None
    positions = np.stack([view.camera.position for view in views])
    shell = shell_around(mesh, positions)
    if shell is None:
        return None
    linear = photometry.linearise_pixels(beyond.z, beyond.view, beyond.pixel)
    radiance = np.where(linear.open, linear.radiance, linear.bound).astype(np.float64)
    texel = shell.texels(positions[beyond.view], beyond.direction, (HEIGHT, 2 * HEIGHT))
    met = texel >= 0
    if not met.any():
        return None
    return Backdrop(shell.vertices, shell.faces, _picture(texel[met], radiance[met]))


def _picture(texel: NDArray[np.integer], radiance: NDArray[np.floating]) -> NDArray[np.float32]:
    """(H, 2 H, 3) robust mean of ``radiance`` (n, 3) per texel; what no pixel shows goes with its surroundings."""
    n = 2 * HEIGHT * HEIGHT
    floor = max(FLOOR * float(radiance.mean()), np.finfo(np.float32).tiny)
    log = np.log(radiance + floor)
    weight, total, mean = np.ones(len(log)), np.zeros(n), np.zeros((n, 3))
    for _ in range(ROUNDS):
        total = np.bincount(texel, weight, n).astype(np.float64)
        sums = np.stack([np.bincount(texel, weight * channel, n) for channel in log.T], -1)
        mean = sums / np.maximum(total, 1e-12)[:, None]
        weight = 1 / (1 + (np.abs(log - mean[texel]).mean(1) / OUTLIER) ** 2)
    shape = (HEIGHT, 2 * HEIGHT)
    filled = _filled(mean.reshape(*shape, 3), total.reshape(shape))
    return np.maximum(np.exp(filled) - floor, 0.0).astype(np.float32)


def _filled(values: NDArray[np.floating], weight: NDArray[np.floating]) -> NDArray[np.float64]:
    """``values`` (H, W, 3) where ``weight`` (H, W) is, Gaussian means of ever wider surroundings where it is not."""
    known = weight > 0
    filled, missing = np.zeros(values.shape), np.ones(weight.shape)
    for sigma in (0, 1, 2, 4, 8, 16, 32):
        near = blurred_panorama(weight[..., None], sigma)[..., 0]
        sums = blurred_panorama(values * weight[..., None], sigma)
        share = missing * near / (near + ENOUGH)
        filled += (share / np.maximum(near, 1e-300))[..., None] * sums
        missing -= share
    return filled + missing[..., None] * np.average(values[known], axis=0, weights=weight[known])


def blurred_panorama(values: NDArray[np.floating], sigma: float) -> NDArray[np.float64]:
    """Gaussian mean of a panorama (H, 2 H, C), which goes on beyond its left and right edge."""
    height = len(values)
    wide = np.pad(values, ((0, 0), (height, height), (0, 0)), mode="wrap")
    return gaussian_filter(wide, (sigma, sigma, 0), mode="nearest")[:, height:-height]
