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
from ..surface.samples import PixelSamples
from ..transport.sampling import dot

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
    slot, pitch, n_slots = _slots(samples.view[rows], samples.pixel[rows], cameras, stride)
    occupant = np.full(n_slots, -1, np.int32)
    occupant[slot] = np.arange(len(rows), dtype=np.int32)
    normal, toward = samples.normal[rows], samples.direction[rows]
    reflected = 2 * dot(normal, toward)[:, None] * normal - toward
    scale = (0.5 / (REACH * np.maximum(roughness, 0.05) ** 2) ** 2).astype(np.float32)
    for step in STEPS:
        result = np.empty_like(lobes)

        def work(block: slice, step: int = step, lobes: NDArray = lobes, result: NDArray = result) -> None:
            total, norm = lobes[block].copy(), np.ones(block.stop - block.start, np.float32)
            for down in (-1, 0, 1):
                for across in (-1, 0, 1):
                    if down == across == 0:
                        continue
                    near = occupant[slot[block] + step * (down * pitch[block] + across)]
                    turn = reflected[near] - reflected[block]
                    say = np.float32(CORNER if down and across else SIDE) * np.exp(-scale[block] * dot(turn, turn))
                    say[(near < 0) | (part[near] != part[block])] = 0
                    total += say[:, None] * lobes[near]
                    norm += say
            result[block] = total / norm[:, None]

        over_blocks(len(rows), BLOCK // 2, work)
        lobes = result
    return lobes


def _slots(
    view: NDArray[np.integer], pixel: NDArray[np.integer], cameras: Sequence[Camera], stride: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Place of each pixel in one array of all lattices with a margin, the length of its row there, the array's size."""
    margin = max(STEPS)
    wide = np.array([-(-camera.width // stride) + 2 * margin for camera in cameras])
    high = np.array([-(-camera.height // stride) + 2 * margin for camera in cameras])
    first = np.concatenate([[0], np.cumsum(wide * high)])
    row, column = np.divmod(pixel, np.array([camera.width for camera in cameras])[view])
    pitch = wide[view]
    return first[view] + (row // stride + margin) * pitch + column // stride + margin, pitch, int(first[-1])
