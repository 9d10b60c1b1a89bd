"""Noise taken off specular lobes: pixels side by side reflect nearly the same things.

What a lobe sees changes over the width of the lobe. Where neighbours of a pixel reflect towards less than that, their
rays serve it too. Passes with doubled steps (à trous, Dammertz et al. 2010) let 27 looks cover 225 pixels; what stops
them are the borders of parts and the turn of the reflected direction, held against the width of the lobe: mirrors keep
their images sharp.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..capture.types import Camera
from ..parallel import BLOCK, over_blocks
from ..surface.lattice import NEIGHBOURS, Lattice
from ..surface.samples import PixelSamples
from ..transport.sampling import dot
from .ggx import ray_alpha

STEPS = (1, 2, 4)
REACH = 0.6
"""Turn of the reflected direction, in GGX widths, that is one standard deviation of the filter."""
SIDE, CORNER = 0.5, 0.25
"""Say of the eight neighbours against the pixel's own: a binomial kernel."""


def denoise_lobes(
    lobes: NDArray[np.float32],
    samples: PixelSamples,
    rows: NDArray[np.integer],
    part: NDArray[np.integer],
    roughness: NDArray[np.floating],
    cameras: Sequence[Camera],
    stride: int,
) -> NDArray[np.float32]:
    """Lobes (n, C) of the pixels ``rows`` (n,), averaged over neighbours that reflect the same.

    Args:
        part, roughness: (n,) of each pixel.
        cameras: of the views, for the width of their photos.
        stride: spacing of the lattice of pixels, see :func:`iris_addon.surface.samples.pixel_lattice`.
    """
    lattice = Lattice.of(samples.view[rows], samples.pixel[rows], cameras, stride, max(STEPS))
    normal, toward = samples.normal[rows], samples.direction[rows]
    reflected = 2 * dot(normal, toward)[:, None] * normal - toward
    precision = 0.5 / (np.float32(REACH) * ray_alpha(roughness)) ** 2
    for step in STEPS:
        lobes = _average(lobes, lattice, step, part, reflected, precision)
    return lobes


def _average(
    lobes: NDArray[np.float32],
    lattice: Lattice,
    step: int,
    part: NDArray[np.integer],
    reflected: NDArray[np.floating],
    precision: NDArray[np.float32],
) -> NDArray[np.float32]:
    """One pass: the mean over a pixel and eight others, ``step`` rows and columns away."""
    result = np.empty_like(lobes)

    def work(block: slice) -> None:
        total, norm = lobes[block].copy(), np.ones(block.stop - block.start, np.float32)
        for down, across in NEIGHBOURS:
            near = lattice.pixel_at(block, step * down, step * across)
            at = np.maximum(near, 0)
            turn = reflected[at] - reflected[block]
            say = np.float32(CORNER if down and across else SIDE) * np.exp(-precision[block] * dot(turn, turn))
            say[(near < 0) | (part[at] != part[block])] = 0
            total += say[:, None] * lobes[at]
            norm += say
        result[block] = total / norm[:, None]

    over_blocks(len(lobes), BLOCK // 2, work)
    return result
