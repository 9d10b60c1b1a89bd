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
from ..parallel import BLOCK, over_blocks, over_each
from ..transport.sampling import dot
from ..transport.tracer import Tracer
from .lattice import NEIGHBOURS, NO_PIXEL, Lattice
from .samples import PixelSamples, trace_view

SAME_DIRECTION = 0.7
"""Cosine between the normals of neighbouring pixels below which there is a crease between them."""
AS_BRIGHT = 0.98
"""Share of its value that the pixel beside it reaches, if a mixed one may have all its light from there."""


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

    def probe(index: int) -> None:
        rows = bounds[index] + np.flatnonzero(mixed[bounds[index] : bounds[index + 1]])
        if len(rows):
            mixed[rows] = _probe(tracer, samples.pixel[rows], parts, cameras[index])

    over_each(range(len(cameras)), probe)
    return mixed


def _probe(tracer: Tracer, pixel: NDArray[np.integer], parts: NDArray[np.integer], camera: Camera) -> NDArray[np.bool_]:
    """(k,) which of some pixels of one photo are mixed, by rays through them and those beside them."""
    row, column = np.divmod(pixel.astype(np.int64), camera.width)
    wanted = np.zeros(camera.height * camera.width, bool)
    wanted[pixel] = True
    for down, across in NEIGHBOURS:
        near = np.clip(row + down, 0, camera.height - 1), np.clip(column + across, 0, camera.width - 1)
        wanted[near[0] * camera.width + near[1]] = True
    traced = trace_view(tracer, camera, 0, np.flatnonzero(wanted).astype(np.int32))
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
        for down, across in NEIGHBOURS:
            near = lattice.pixel_at(block, down, across)
            at = np.maximum(near, 0)
            crease = dot(samples.normal[block], samples.normal[at]) < SAME_DIRECTION
            other = crease | _another_surface(samples, part, block, at, stride)
            mixed[block] |= np.where(near >= 0, other, near == NO_PIXEL)

    over_blocks(len(part), BLOCK // 2, work)
    return mixed


def _another_surface(
    samples: PixelSamples,
    part: NDArray[np.integer],
    own: slice | NDArray[np.integer],
    near: NDArray[np.integer],
    stride: int,
) -> NDArray[np.bool_]:
    """Whether pixels ``near`` show another part than ``own`` do, or lie off their plane."""
    step = samples.position[near] - samples.position[own]
    height = np.maximum(np.abs(dot(step, samples.normal[own])), np.abs(dot(step, samples.normal[near])))
    reach = stride * np.minimum(samples.footprint[own], samples.footprint[near])
    return (part[near] != part[own]) | (height > reach)


def outshone_by(
    samples: PixelSamples,
    z: NDArray[np.floating],
    mixed: NDArray[np.bool_],
    parts: NDArray[np.integer],
    cameras: Sequence[Camera],
    stride: int,
) -> NDArray[np.int32]:
    """(n,) the brightest pixel of another surface beside each mixed one, -1 where all are darker than it.

    A strip of a frame before a window looks as bright as the window: what its pixels show may be the window's light.

    Args:
        z: (n, 3) display values or radiance.
        mixed: (n,) of :func:`mixed_pixels`.
    """
    lattice = Lattice.of(samples.view, samples.pixel, cameras, stride, margin=1)
    part, level, rows = parts[samples.face], z.mean(1), np.flatnonzero(mixed)
    brightest = np.full(len(part), -1, np.int32)

    def work(block: slice) -> None:
        own = rows[block]
        least = AS_BRIGHT * level[own]
        for down, across in NEIGHBOURS:
            near = lattice.pixel_at(own, down, across)
            at = np.maximum(near, 0)
            apart = part[at] != part[own]  # A thing may lie before itself: among equals, another part.
            more = (level[at] > least) | (apart & (level[at] >= least))
            more &= (near >= 0) & _another_surface(samples, part, own, at, stride)
            brightest[own[more]], least[more] = at[more], level[at[more]]

    over_blocks(len(rows), BLOCK // 2, work)
    return brightest
