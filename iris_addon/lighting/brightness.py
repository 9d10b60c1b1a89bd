"""How bright the surface is: what photos show of it at the least, in nearly every view.

It is collected on cells. A cell is a patch, except on scans. The triangles of a scan are smaller than a patch and the
edge of a lamp crosses patches, so there each bright face is a cell of its own, with its own pixels; or each spot of a
pixel's width where faces are smaller yet.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import group_sums, order_in_groups
from ..response.observations import Observations
from ..response.photometry import Photometry
from ..response.radiance import Linearised, group_radiance
from ..surface.photo_samples import PhotoSamples

VIEW_QUANTILE = 0.25
"""Quantile over views at which a patch's radiance is tested: emission is seen in all views, a highlight in few."""
USUAL_QUANTILE = 0.9
"""Quantile over the measured cells of a lamp that what clips is at least as bright as."""
SPOTS_ALONG_PATCH = 1024
"""Pixels along a patch, more than any has."""


@dataclass(frozen=True)
class Brightness:
    """Radiance of each of C cells as photos show it, clipped views included; scene-linear Rec.709.

    Attributes:
        floor: (C, 3) radiance that nearly all views reach: a low quantile over unclipped views, raised to the highest
            bound where clipped views prevail.
        measured: (C, 3) radiance from unclipped views, NaN without one.
        bound: (C, 3) lower bound from clipped views.
    """

    floor: NDArray[np.float64]
    measured: NDArray[np.float64]
    bound: NDArray[np.float64]

    def at_least(self, cells: NDArray[np.integer]) -> NDArray[np.float64]:
        """(k, 3) radiance of some ``cells`` of one lamp: measured, or else no less than their bound, and than most that
        are measured. A cell of which every photo clips a part has neither a measurement nor a bound."""
        measured = self.measured[cells]
        usual = np.zeros(3)
        for channel, values in enumerate(measured.T):
            if np.isfinite(values).any():
                usual[channel] = np.nanquantile(values, USUAL_QUANTILE)
        return np.where(np.isnan(measured), np.maximum(self.bound[cells], usual), measured)

    @property
    def clips(self) -> NDArray[np.bool_]:
        """(C, 3) channels of which no more is known than that nearly all views clip."""
        return (self.bound >= self.floor) & (self.floor > 0)


def brightness(
    observations: Observations, linear: Linearised, n_patches: int, specular: NDArray[np.floating] | None = None
) -> Brightness:
    """Brightness of every seen patch, without the ``specular`` radiance (M, 3) of the observations if known."""
    o = observations
    group = group_radiance(linear, o.patch, o.count, n_patches)
    value = least_radiance(linear, specular)
    floor = [_low_quantile(value[:, c], linear.unclipped[:, c], o.count, o.patch, n_patches) for c in range(3)]
    return Brightness(np.stack(floor, -1), np.where(group.known, group.radiance, np.nan), group.bound)


def least_radiance(linear: Linearised, specular: NDArray[np.floating] | None) -> NDArray[np.float64]:
    """(M, 3) least radiance of each observation, measured or a bound, without its ``specular`` part (M, 3)."""
    value = np.where(linear.unclipped, linear.radiance, linear.bound)
    return value if specular is None else np.maximum(value - specular, 0.0)


def _low_quantile(
    value: NDArray[np.float64],
    unclipped: NDArray[np.bool_],
    count: NDArray[np.floating],
    patch: NDArray[np.integer],
    n: int,
) -> NDArray[np.float64]:
    """(n,) low quantile over views of the least radiance of each patch in one channel.

    Args:
        value: (M,) least radiance of each observation.
        unclipped: (M,) bool; clipped observations can only raise the result.
        count: (M,) pixels.
        patch: (M,) patch of each observation, below ``n``.
    """
    result = np.zeros(n)
    bound = np.zeros(n)
    np.maximum.at(bound, patch, np.where(unclipped, 0.0, value))
    use = np.flatnonzero(unclipped)
    order = use[order_in_groups(value[use], patch[use])]
    in_order = patch[order]
    weight = count[order].astype(np.float64)
    total = np.bincount(in_order, weight, n)
    running = np.cumsum(weight) - np.concatenate([[0], np.cumsum(total)])[in_order]
    reached = running >= VIEW_QUANTILE * total[in_order]
    chosen = np.flatnonzero(reached & np.concatenate([[True], (in_order[1:] != in_order[:-1]) | ~reached[:-1]]))
    result[in_order[chosen]] = value[order][chosen]
    unclipped_share = total / np.maximum(np.bincount(patch, count, n), 1e-9)
    return np.where(unclipped_share > VIEW_QUANTILE, result, np.maximum(result, bound))


def reflectance_needed(seen: Brightness, irradiance: NDArray[np.floating]) -> NDArray[np.float64]:
    """(P,) reflectance that would explain the brightness of each patch; ``irradiance`` (C, 3) is irradiance / pi."""
    return (seen.floor / np.maximum(irradiance, 1e-6)).max(1)


def pixel_sized_spots(
    position: NDArray[np.floating], footprint: NDArray[np.floating], patch: NDArray[np.integer]
) -> NDArray[np.int64]:
    """(n,) label of the spot of each pixel: as wide as pixels are in the median, and within one patch.

    Args:
        position: (n, 3) metres.
        footprint: (n,) metres.
        patch: (n,) patch of each pixel, no wider than SPOTS_ALONG_PATCH spots.
    """
    width = max(float(np.median(footprint)), 1e-6)
    key = patch.astype(np.int64)
    for place in np.floor(position / width).astype(np.int64).T:
        key = key * SPOTS_ALONG_PATCH + place % SPOTS_ALONG_PATCH
    return np.unique(key, return_inverse=True)[1]


@dataclass(frozen=True)
class Cells:
    """The C cells on which brightness is collected: the P patches, and the bright faces of scans.

    Attributes:
        of_pixel: (n,) int32 cell of each pixel.
        patch: (C,) int32 patch of each cell; the first P cells are the patches themselves.
        pixels: (k,) int64 the pixels on faces that are cells.
        observation: (k,) int32 observation of each of these.
        least: (k, 3) float32 its least radiance, measured or a bound; scene-linear Rec.709.
        unclipped: (k, 3) bool, channels in which it is measured.
        n_patches: P.
    """

    of_pixel: NDArray[np.int32]
    patch: NDArray[np.int32]
    pixels: NDArray[np.int64]
    observation: NDArray[np.int32]
    least: NDArray[np.float32]
    unclipped: NDArray[np.bool_]
    n_patches: int

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return len(self.patch)

    @cached_property
    def count(self) -> NDArray[np.int64]:
        """(C,) pixels of each cell."""
        return np.bincount(self.of_pixel, minlength=self.n_cells)

    @staticmethod
    def of_patches(sample_patch: NDArray[np.int32], n_patches: int) -> Cells:
        """Patches alone, for a mesh that is no scan."""
        nothing = np.zeros((0, 3), np.float32)
        none = np.zeros(0, np.int64)
        return Cells(
            of_pixel=sample_patch,
            patch=np.arange(n_patches, dtype=np.int32),
            pixels=none,
            observation=none.astype(np.int32),
            least=nothing,
            unclipped=nothing > 0,
            n_patches=n_patches,
        )

    @staticmethod
    def on_scans(
        photos: PhotoSamples,
        photometry: Photometry,
        sample_patch: NDArray[np.int32],
        n_patches: int,
        observations: Observations,
        scanned: NDArray[np.bool_],
    ) -> Cells:
        """Patches, and each face of a scan of which a pixel is brighter than half of all pixels.

        The other faces of a scan share one cell of no brightness: what is dimmer than most of the room is no lamp.
        Where faces are smaller than pixels, spots as wide as a pixel take their place, which several views show.

        Args:
            sample_patch: (n,) patch of each pixel.
            scanned: (F,) faces of scans.
        """
        samples = photos.samples
        rows = np.flatnonzero(scanned[samples.face])
        if not len(rows):
            return Cells.of_patches(sample_patch, n_patches)
        linear = photometry.linearise_pixels(photos.z[rows], samples.view[rows], samples.pixel[rows])
        least = least_radiance(linear, None).astype(np.float32)
        level, spot = least.max(1), samples.face[rows]
        if scanned.sum() > len(rows):
            spot = pixel_sized_spots(samples.position[rows], samples.footprint[rows], sample_patch[rows])
        bright = np.zeros(int(spot.max()) + 1, bool)
        bright[spot[level > np.median(level)]] = True
        number = np.cumsum(bright) - 1
        dim = n_patches + int(bright.sum())
        of_pixel = sample_patch.copy()
        of_pixel[rows] = np.where(bright[spot], n_patches + number[spot], dim)
        patch = np.concatenate([np.arange(n_patches), np.zeros(dim + 1 - n_patches)]).astype(np.int32)
        on = bright[spot]
        patch[of_pixel[rows[on]]] = sample_patch[rows[on]]
        return Cells(
            of_pixel=of_pixel,
            patch=patch,
            pixels=rows[on],
            observation=observations.sample_to_observation[rows[on]],
            least=least[on],
            unclipped=linear.unclipped[on],
            n_patches=n_patches,
        )

    def brightness(
        self, observations: Observations, linear: Linearised, specular: NDArray[np.floating] | None = None
    ) -> Brightness:
        """Brightness of every cell, without the ``specular`` radiance (M, 3) of the observations if known."""
        of_patches = brightness(observations, linear, self.n_patches, specular)
        if not len(self.pixels):
            return of_patches
        cell, n = self.of_pixel[self.pixels] - self.n_patches, self.n_cells - self.n_patches
        value = self.least.astype(np.float64)
        if specular is not None:
            value = np.maximum(value - specular[self.observation], 0.0)
        one = np.ones(len(cell))
        floor = np.stack([_low_quantile(value[:, c], self.unclipped[:, c], one, cell, n) for c in range(3)], -1)
        bound = np.zeros((n, 3))
        np.maximum.at(bound, cell, np.where(self.unclipped, 0.0, value))
        times = group_sums(self.unclipped.astype(np.float32), cell, n)
        total = group_sums(np.where(self.unclipped, value, 0.0), cell, n)
        measured = np.where(times > 0, total / np.maximum(times, 1), np.nan)
        return Brightness(
            np.concatenate([of_patches.floor, floor]),
            np.concatenate([of_patches.measured, measured]),
            np.concatenate([of_patches.bound, bound]),
        )
