"""Mixed pixels: those on an edge, which show the light of more than one surface.

A pixel is the mean over its footprint and, with most reconstruction filters, a little more. At the edge of a dark table
before a bright wall it has the colour of neither, although its ray hits one of them. The mesh tells which pixels these
are: the rays of their neighbours hit another surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from ..base.compiled import Integer, inlined, kernel
from ..base.parallel import BLOCK, over_blocks, over_each
from ..model.capture import Camera
from .photo_samples import PhotoSamples
from .primary_rays import NO_PIXEL, Lattice, PixelSamples

CREASE_COSINE = 0.7
"""Cosine between the normals of neighbouring pixels below which there is a crease between them."""
OUTLINE_STEP = 2.0
"""Distance of a neighbour off a pixel's plane, in errors of the outline, from which on there is an outline between."""
OUTLINE_MAX_PIXELS = 12
"""Pixels of the lattice over which an outline is uncertain, at most."""
INNER = 2
"""Pixels around an inner pixel of which none is mixed: as far as blur and the shared color of JPEG files reach."""
NEIGHBOUR_BRIGHTNESS = 0.98
"""Brightness of a neighbour over that of a mixed pixel from which on all light of the pixel may come from there."""


@dataclass(frozen=True)
class MixedPixels:
    """Which of n pixels are mixed, and with what.

    Attributes:
        mask: (n,) bool.
        inner: (n,) bool, pixels that are further than INNER pixels from all mixed ones. These alone show one surface
            in photos that are blurred, or in which pixels share a color, as in most JPEG files.
        brighter_neighbour: (n,) int32 for a mixed pixel the brightest neighbour on another surface, from which all its
            light may come; -1 where all neighbours are darker.
    """

    mask: NDArray[np.bool_]
    inner: NDArray[np.bool_]
    brighter_neighbour: NDArray[np.int32]

    @staticmethod
    def of(
        photos: PhotoSamples, regions: NDArray[np.integer], cameras: Sequence[Camera], outline_error: float = 0.0
    ) -> MixedPixels:
        """The mixed pixels among those of ``photos``, taken by ``cameras``, on faces of ``regions`` (F,).

        Args:
            outline_error: distance in metres by which outlines of the mesh may be beside those of the photos.
        """
        mask = mixed_pixels(photos.samples, regions, cameras)
        if outline_error > 0:
            mask |= beside_outlines(photos.samples, cameras, outline_error)
        inner = off_edges(photos.samples, mask, cameras)
        return MixedPixels(mask, inner, brighter_neighbours(photos.samples, photos.z, mask, regions, cameras))

    def take(self, kept: NDArray[np.integer]) -> MixedPixels:
        """Those of the pixels ``kept`` (k,), ascending, which are all of some photos."""
        number = np.full(len(self.mask) + 1, NO_PIXEL, np.int32)  # the last entry is that of -1
        number[kept] = np.arange(len(kept), dtype=np.int32)
        return MixedPixels(self.mask[kept], self.inner[kept], number[self.brighter_neighbour[kept]])


def mixed_pixels(samples: PixelSamples, regions: NDArray[np.integer], cameras: Sequence[Camera]) -> NDArray[np.bool_]:
    """(n,) pixels with a neighbour that shows another region, lies beyond a crease or off their plane, or misses the
    mesh.

    Something thinner than a pixel, between the rays of two, goes unnoticed.

    Args:
        regions: (F,) region of each face.
        cameras: of all views, in the order of ``samples.view``.
    """
    lattice = Lattice.of(samples.view, samples.pixel, cameras, margin=1)
    surface = _Surface(regions[samples.face], samples.position, samples.normal, samples.footprint)
    mixed = np.empty(len(surface.region), bool)

    def work(block: slice) -> None:
        _mark_mixed(block.start, lattice.slot[block], lattice.pitch[block], lattice.occupant, surface, mixed[block])

    over_blocks(len(mixed), BLOCK, work)
    return mixed


def off_edges(samples: PixelSamples, mixed: NDArray[np.bool_], cameras: Sequence[Camera]) -> NDArray[np.bool_]:
    """(n,) pixels with no ``mixed`` (n,) one within INNER pixels."""
    lattice = Lattice.of(samples.view, samples.pixel, cameras, margin=INNER)
    result, rows = ~mixed, np.flatnonzero(mixed)
    for down in range(-INNER, INNER + 1):
        for across in range(-INNER, INNER + 1):
            near = lattice.pixel_at(rows, down, across)
            result[near[near >= 0]] = False
    return result


def beside_outlines(samples: PixelSamples, cameras: Sequence[Camera], outline_error: float) -> NDArray[np.bool_]:
    """(n,) pixels that may show what is on the other side of an outline, which lies up to ``outline_error`` metres
    beside its place.

    An outline runs where the next pixel shows a surface well off the plane of this one. The error is that of the nearer
    side, and spans more pixels the nearer that is.
    """
    lattice = Lattice.of(samples.view, samples.pixel, cameras, margin=1)
    width = np.empty(len(samples.view), np.float32)

    def work(block: slice) -> None:
        places = lattice.slot[block], lattice.pitch[block], lattice.occupant
        surface = samples.position, samples.normal, samples.footprint
        _measure_outlines(block.start, *places, *surface, outline_error, width[block])

    over_blocks(len(width), BLOCK, work)
    mask = np.zeros(len(width), bool)
    ends = np.searchsorted(samples.view, np.arange(len(cameras) + 1))

    def widen(index: int) -> None:
        rows, camera = slice(ends[index], ends[index + 1]), cameras[index]
        row, column = np.divmod(samples.pixel[rows], camera.width)
        widths = np.zeros((camera.height, camera.width), np.float32)
        widths[row, column] = np.minimum(width[rows], OUTLINE_MAX_PIXELS)
        reached = widths >= 0.5
        for pixels in range(1, int(widths.max()) + 1):
            reached |= np.asarray(distance_transform_edt(widths < pixels)) <= pixels
        mask[rows] = reached[row, column]

    over_each(range(len(cameras)), widen)
    return mask


@kernel
def _measure_outlines(
    first: int,
    slot: NDArray[np.int64],
    pitch: NDArray[np.int64],
    occupant: NDArray[np.int32],
    position: NDArray[np.float32],
    normal: NDArray[np.float32],
    footprint: NDArray[np.float32],
    outline_error: float,
    width: NDArray[np.float32],
) -> None:
    """Fill ``width`` with the error of the outlines beside each pixel, in pixels; 0 without one."""
    for k in range(len(slot)):
        own, widest = first + k, 0.0
        for down in range(-1, 2):
            for across in range(-1, 2):
                near = occupant[slot[k] + down * pitch[k] + across]
                if near < 0 or near == own:
                    continue
                above = below = 0.0
                for axis in range(3):
                    step = position[near, axis] - position[own, axis]
                    above += step * normal[own, axis]
                    below += step * normal[near, axis]
                if min(abs(above), abs(below)) > OUTLINE_STEP * outline_error:
                    widest = max(widest, outline_error / min(footprint[own], footprint[near]))
        width[k] = widest


class _Surface(NamedTuple):
    """What n pixels show: region (n,), position (n, 3) and footprint (n,) in metres, unit normal (n, 3)."""

    region: NDArray[np.integer]
    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    footprint: NDArray[np.float32]


@inlined
def _apart(surface: _Surface, a: Integer, b: Integer) -> Any:
    """Whether two pixels show different regions, or lie off each other's plane."""
    p, n = surface.position, surface.normal
    above = below = 0.0
    for axis in range(3):
        step = p[b, axis] - p[a, axis]
        above += step * n[a, axis]
        below += step * n[b, axis]
    reach = min(surface.footprint[a], surface.footprint[b])
    return surface.region[a] != surface.region[b] or max(abs(above), abs(below)) > reach


@inlined
def _crease(surface: _Surface, a: Integer, b: Integer) -> bool:
    """Whether the surfaces of two pixels face different ways."""
    cosine = 0.0
    for axis in range(3):
        cosine += surface.normal[a, axis] * surface.normal[b, axis]
    return cosine < CREASE_COSINE


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
                neighbour = occupant[slot[k] + down * pitch[k] + across]
                if neighbour == NO_PIXEL:
                    found = True
                elif neighbour >= 0 and neighbour != own and not found:
                    found = _crease(surface, own, neighbour) or _apart(surface, own, neighbour)
        mixed[k] = found


def brighter_neighbours(
    samples: PixelSamples,
    z: NDArray[np.floating],
    mixed: NDArray[np.bool_],
    regions: NDArray[np.integer],
    cameras: Sequence[Camera],
) -> NDArray[np.int32]:
    """(n,) for each mixed pixel the brightest neighbour on another surface, -1 where all are darker than it.

    A strip of a window's frame looks as bright as the window: the light of its pixels may be the window's.

    Args:
        z: (n, 3) display values or radiance.
        mixed: (n,) bool, the result of :func:`mixed_pixels`.
        regions: (F,) region of each face.
        cameras: of all views, in the order of ``samples.view``.
    """
    lattice = Lattice.of(samples.view, samples.pixel, cameras, margin=1)
    surface = _Surface(regions[samples.face], samples.position, samples.normal, samples.footprint)
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
        least = NEIGHBOUR_BRIGHTNESS * level[own]
        for down in range(-1, 2):
            for across in range(-1, 2):
                neighbour = occupant[slot[own] + down * pitch[own] + across]
                if neighbour < 0 or neighbour == own:
                    continue
                # One region may overlap itself in the photo: of equally bright neighbours, another region wins.
                other = surface.region[neighbour] != surface.region[own]
                if (level[neighbour] > least or (other and level[neighbour] >= least)) and _apart(
                    surface, own, neighbour
                ):
                    brightest[own], least = neighbour, level[neighbour]
