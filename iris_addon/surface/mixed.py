"""Pixels on an edge: what they show is the light of more than one surface.

A pixel of a photo is the mean over its footprint and, with most reconstruction filters, a little more. Beside the edge
of a dark table before a bright wall it is neither the table's nor the wall's, but its ray hits one of them. Which
pixels these are is known: the mesh says what the rays beside them hit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..capture.types import Camera
from ..parallel import BLOCK, over_blocks
from ..transport.sampling import dot
from ..transport.tracer import Tracer
from .lattice import NEIGHBOURS, NO_PIXEL, Lattice
from .samples import PixelSamples, trace_view

SAME_DIRECTION = 0.7
"""Cosine between the normals of neighbouring pixels below which there is a crease between them."""


def mixed_pixels(
    tracer: Tracer, samples: PixelSamples, parts: NDArray[np.integer], cameras: Sequence[Camera], stride: int
) -> NDArray[np.bool_]:
    """(n,) pixels beside one that shows another part, beyond a crease or off their plane, or misses the mesh.

    Between the pixels of a coarse lattice (see :func:`.samples.pixel_lattice`) something thin may go unnoticed.

    Args:
        parts: (F,) part per face.
    """
    mixed = _beside_others(samples, parts, cameras, stride)
    if stride == 1:
        return mixed
    # The next pixel of the lattice is further than the footprint reaches: ask the true neighbours.
    bounds = np.searchsorted(samples.view, np.arange(len(cameras) + 1))
    for index, camera in enumerate(cameras):
        rows = bounds[index] + np.flatnonzero(mixed[bounds[index] : bounds[index + 1]])
        if len(rows):
            mixed[rows] = _probe(tracer, samples.pixel[rows], parts, camera)
    return mixed


def _probe(tracer: Tracer, pixel: NDArray[np.integer], parts: NDArray[np.integer], camera: Camera) -> NDArray[np.bool_]:
    """(k,) which of some pixels of one photo are mixed, by rays through them and those beside them."""
    row, column = np.divmod(pixel.astype(np.int64), camera.width)
    around = [
        np.clip(row + down, 0, camera.height - 1) * camera.width + np.clip(column + across, 0, camera.width - 1)
        for down, across in NEIGHBOURS
    ]
    traced = trace_view(tracer, camera, 0, np.unique(np.concatenate([pixel, *around])).astype(np.int32))
    mixed = np.ones(camera.height * camera.width, bool)
    mixed[traced.pixel] = _beside_others(traced, parts, [camera], 1)
    return mixed[pixel]


def _beside_others(
    samples: PixelSamples, parts: NDArray[np.integer], cameras: Sequence[Camera], stride: int
) -> NDArray[np.bool_]:
    lattice = Lattice.of(samples.view, samples.pixel, cameras, stride, margin=1)
    part = parts[samples.face]
    mixed = np.zeros(len(part), bool)

    def work(block: slice) -> None:
        position, normal = samples.position[block], samples.normal[block]
        for down, across in NEIGHBOURS:
            near = lattice.pixel_at(block, down, across)
            at = np.maximum(near, 0)
            step, other = samples.position[at] - position, samples.normal[at]
            height = np.maximum(np.abs(dot(step, normal)), np.abs(dot(step, other)))
            reach = stride * np.minimum(samples.footprint[block], samples.footprint[at])
            unlike = (part[at] != part[block]) | (dot(normal, other) < SAME_DIRECTION) | (height > reach)
            mixed[block] |= np.where(near >= 0, unlike, near == NO_PIXEL)

    over_blocks(len(part), BLOCK // 2, work)
    return mixed
