"""Noise taken off specular lobes: pixels side by side reflect nearly the same things.

What a lobe sees changes over the width of the lobe. Where neighbours of a pixel reflect towards less than that, their
rays serve it too. Passes with doubled steps (à trous, Dammertz et al. 2010) let 27 looks cover 225 pixels; what stops
them are the borders of parts and the turn of the reflected direction, held against the width of the lobe: mirrors keep
their images sharp.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..capture.types import Camera
from ..kernels import kernel
from ..parallel import BLOCK, over_blocks
from ..surface.lattice import Lattice
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
    reflected = (2 * dot(normal, toward)[:, None] * normal - toward).astype(np.float32)
    precision = 0.5 / (np.float32(REACH) * ray_alpha(roughness)) ** 2
    for step in STEPS:
        smooth, noisy = np.empty_like(lobes), lobes

        def work(block: slice, step: int, smooth: NDArray[np.float32], noisy: NDArray[np.float32]) -> None:
            places = lattice.slot[block], lattice.pitch[block], lattice.occupant
            _average(block.start, *places, step, part, reflected, precision, noisy, smooth)

        over_blocks(len(lobes), BLOCK // 4, partial(work, step=step, smooth=smooth, noisy=noisy))
        lobes = smooth
    return lobes


@kernel
def _average(
    first: int,
    slot: NDArray[np.int64],
    pitch: NDArray[np.int64],
    occupant: NDArray[np.int32],
    step: int,
    part: NDArray[np.integer],
    reflected: NDArray[np.float32],
    precision: NDArray[np.float32],
    noisy: NDArray[np.float32],
    smooth: NDArray[np.float32],
) -> None:
    """One pass: the mean over a pixel and eight others, ``step`` rows and columns away; of pixels from ``first`` on."""
    for k in range(len(slot)):
        own, norm = first + k, 1.0
        for c in range(noisy.shape[1]):
            smooth[own, c] = noisy[own, c]
        for down in range(-1, 2):
            for across in range(-1, 2):
                near = occupant[slot[k] + step * (down * pitch[k] + across)]
                if near < 0 or near == own or part[near] != part[own]:
                    continue
                turn = 0.0
                for axis in range(3):
                    turn += (reflected[near, axis] - reflected[own, axis]) ** 2
                say = (CORNER if down and across else SIDE) * math.exp(-precision[own] * turn)
                norm += say
                for c in range(noisy.shape[1]):
                    smooth[own, c] += say * noisy[near, c]
        for c in range(noisy.shape[1]):
            smooth[own, c] /= norm
