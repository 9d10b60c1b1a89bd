"""Pixels on an edge: what they show is the light of more than one surface.

A pixel of a photo is the mean over its footprint and, with most reconstruction filters, a little more. Beside the edge
of a dark table before a bright wall it is neither the table's nor the wall's, but its ray hits one of them. Which
pixels these are is known: the mesh says what the rays beside them hit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Integer, inlined, kernel
from ..base.parallel import BLOCK, over_blocks, over_each
from ..model.capture import Camera
from ..rays.tracer import Tracer
from .primary_rays import NEIGHBOURS, NO_PIXEL, Lattice, PixelSamples, trace_view

SAME_DIRECTION = 0.7
"""Cosine between the normals of neighbouring pixels below which there is a crease between them."""
AS_BRIGHT = 0.98
"""Share of its value that the pixel beside it reaches, if a mixed one may have all its light from there."""


def mixed_pixels(
    tracer: Tracer, samples: PixelSamples, regions: NDArray[np.integer], cameras: Sequence[Camera], stride: int
) -> NDArray[np.bool_]:
    """(n,) pixels beside one that shows another region, beyond a crease or off their plane, or misses the mesh.

    Between the pixels of a coarse lattice (see :func:`.samples.pixel_lattice`) something thin may go unnoticed.

    Args:
        regions: (F,) part per face.
    """
    mixed = _beside_others(samples, regions, cameras, stride)
    if stride == 1:
        return mixed
    # The next pixel of the lattice is further than the footprint reaches: ask the true neighbours.
    bounds = np.searchsorted(samples.view, np.arange(len(cameras) + 1))

    def probe(index: int) -> None:
        rows = bounds[index] + np.flatnonzero(mixed[bounds[index] : bounds[index + 1]])
        if len(rows):
            mixed[rows] = _probe(tracer, samples.pixel[rows], regions, cameras[index])

    over_each(range(len(cameras)), probe)
    return mixed


def _probe(
    tracer: Tracer, pixel: NDArray[np.integer], regions: NDArray[np.integer], camera: Camera
) -> NDArray[np.bool_]:
    """(k,) which of some pixels of one photo are mixed, by rays through them and those beside them."""
    row, column = np.divmod(pixel.astype(np.int64), camera.width)
    wanted = np.zeros(camera.height * camera.width, bool)
    wanted[pixel] = True
    for down, across in NEIGHBOURS:
        near = np.clip(row + down, 0, camera.height - 1), np.clip(column + across, 0, camera.width - 1)
        wanted[near[0] * camera.width + near[1]] = True
    traced = trace_view(tracer, camera, 0, np.flatnonzero(wanted).astype(np.int32))
    mixed = np.ones(camera.height * camera.width, bool)
    mixed[traced.pixel] = _beside_others(traced, regions, [camera], 1)
    return mixed[pixel]


def _beside_others(
    samples: PixelSamples, regions: NDArray[np.integer], cameras: Sequence[Camera], stride: int
) -> NDArray[np.bool_]:
    lattice = Lattice.of(samples.view, samples.pixel, cameras, stride, margin=1)
    surface = _Surface(regions[samples.face], samples.position, samples.normal, samples.footprint, stride)
    mixed = np.empty(len(surface.region), bool)

    def work(block: slice) -> None:
        _mark_mixed(block.start, lattice.slot[block], lattice.pitch[block], lattice.occupant, surface, mixed[block])

    over_blocks(len(mixed), BLOCK, work)
    return mixed


class _Surface(NamedTuple):
    """What pixels show: (n,) part, (n, 3) position and normal, (n,) footprint; and the step of their lattice."""

    region: NDArray[np.integer]
    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    footprint: NDArray[np.float32]
    stride: int


@inlined
def _apart(surface: _Surface, a: Integer, b: Integer) -> Any:
    """Whether two pixels show different regions, or lie off each other's plane."""
    p, n = surface.position, surface.normal
    above = below = 0.0
    for axis in range(3):
        step = p[b, axis] - p[a, axis]
        above += step * n[a, axis]
        below += step * n[b, axis]
    reach = surface.stride * min(surface.footprint[a], surface.footprint[b])
    return surface.region[a] != surface.region[b] or max(abs(above), abs(below)) > reach


@inlined
def _crease(surface: _Surface, a: Integer, b: Integer) -> bool:
    cosine = 0.0
    for axis in range(3):
        cosine += surface.normal[a, axis] * surface.normal[b, axis]
    return cosine < SAME_DIRECTION


@kernel
def _mark_mixed(
    first: int,
    slot: NDArray[np.int64],
    pitch: NDArray[np.int64],
    occupant: NDArray[np.int32],
    surface: _Surface,
    mixed: NDArray[np.bool_],
) -> None:
    for k in range(len(slot)):
        own, found = first + k, False
        for down in range(-1, 2):
            for across in range(-1, 2):
                near = occupant[slot[k] + down * pitch[k] + across]
                if near == NO_PIXEL:
                    found = True
                elif near >= 0 and near != own and not found:
                    found = _crease(surface, own, near) or _apart(surface, own, near)
        mixed[k] = found


def outshone_by(
    samples: PixelSamples,
    z: NDArray[np.floating],
    mixed: NDArray[np.bool_],
    regions: NDArray[np.integer],
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
    surface = _Surface(regions[samples.face], samples.position, samples.normal, samples.footprint, stride)
    brightest, rows = np.full(len(mixed), -1, np.int32), np.flatnonzero(mixed)
    level = z.mean(1)

    def work(block: slice) -> None:
        _find_brightest(rows[block], lattice.slot, lattice.pitch, lattice.occupant, surface, level, brightest)

    over_blocks(len(rows), BLOCK, work)
    return brightest


@kernel
def _find_brightest(
    rows: NDArray[np.int64],
    slot: NDArray[np.int64],
    pitch: NDArray[np.int64],
    occupant: NDArray[np.int32],
    surface: _Surface,
    level: NDArray[np.floating],
    brightest: NDArray[np.int32],
) -> None:
    for own in rows:
        least = AS_BRIGHT * level[own]
        for down in range(-1, 2):
            for across in range(-1, 2):
                near = occupant[slot[own] + down * pitch[own] + across]
                if near < 0 or near == own:
                    continue
                # A thing may lie before itself: among equals, another region.
                other = surface.region[near] != surface.region[own]
                if (level[near] > least or (other and level[near] >= least)) and _apart(surface, own, near):
                    brightest[own], least = near, level[near]
