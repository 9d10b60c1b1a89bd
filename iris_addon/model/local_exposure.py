"""Local exposure, the gain of a camera from place to place within a photo: local tone mapping and vignetting.

A photo is z = f(L t g(p)). With y = log luminance of what reaches the sensor, B its Gaussian mean around the pixel p
and r the distance from the middle of the photo over that of its corners,

    log g(p) = -strength (B(p) - median B) - falloff r(p)^2

The first term compresses contrast between areas and keeps it within them, as the base layer of Durand & Dorsey 2002
does; phones and cameras' "shadow boost" do the same. The second is cos^4 and mechanical vignetting to first order. Both
are smooth, so a small picture of each photo is enough to find and to undo them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import filled
from .response import LUMINANCE, SATURATED, Response

ROWS, COLUMNS = 24, 32
"""Cells of small photos, whatever the shape of the large ones."""
CELL_PIXELS = 8
"""Rows and columns of pixels that are averaged in each cell; the others are skipped."""
BLACK_EXPOSURE = 1e-4
"""Relative exposure that stands for everything darker."""
INVERSION_TOLERANCE, INVERSION_MAX_STEPS = 1e-3, 40
"""Change of log exposure at which the fixed-point iteration that undoes a tone mapping ends, and its last step."""


@dataclass(frozen=True)
class LocalSettings:
    """Parameters of the model, common to all photos.

    Attributes:
        strength: share by which contrast between large areas is compressed, 0 to 1.
        scale: standard deviation of the Gaussian mean, in widths of the photo.
        headroom: relative exposure that clipped pixels are taken to have had in that mean.
        falloff: natural logarithm by which corners are darker than the middle.
    """

    strength: float = 0.0
    scale: float = 1 / 12
    headroom: float = 1.0
    falloff: float = 0.0

    def gain(self, photo: NDArray[np.floating], response: Response) -> NDArray[np.float64]:
        """(H, W, 1) factor of the exposure that the camera gave places of ``photo`` (H, W, 3), or (1, 1, 1) of 1."""
        if not self.strength and not self.falloff:
            return np.ones((1, 1, 1))
        height, width = photo.shape[:2]
        z, clipped = small_photo(photo, np.ones((height, width), bool))
        small = SmallPhotos(z[None], clipped[None], np.array([[height, width]]))
        every = np.arange(height * width)
        return small.local_exposure(self, response).at(np.zeros_like(every), every).reshape(height, width, 1)


UNIFORM = LocalSettings()
"""No local exposure: every place of a photo has the exposure of the photo."""


@dataclass(frozen=True)
class LocalExposure:
    """Gain of every place of every photo.

    Attributes:
        settings: of all photos, or of those of the first device.
        log_gain: (V, 24, 32) float32 natural logarithm.
        sizes: (V, 2) height and width of the photos.
        others: settings of the further devices, empty where those are of all photos.
    """

    settings: LocalSettings
    log_gain: NDArray[np.float32]
    sizes: NDArray[np.int64]
    others: tuple[LocalSettings, ...] = ()

    def at(self, view: NDArray[np.integer], pixel: NDArray[np.integer]) -> NDArray[np.float64]:
        """(n,) factor of the exposure at row-major pixels (n,) of views (n,)."""

        def gain(rows: slice) -> NDArray[np.float64]:
            height, width = self.sizes[view[rows]].T
            row, column = np.divmod(pixel[rows], width)
            above, down = _between((row + 0.5) / height * ROWS - 0.5, ROWS)
            left, right = _between((column + 0.5) / width * COLUMNS - 0.5, COLUMNS)
            upper, lower = (
                (1 - right) * self.log_gain[view[rows], line, left] + right * self.log_gain[view[rows], line, left + 1]
                for line in (above, above + 1)
            )
            return np.exp((1 - down) * upper + down * lower)

        return filled(np.empty(len(view)), gain)

    def arrays(self) -> dict[str, NDArray]:
        """Plain arrays for a checkpoint."""
        return {
            "local_settings": np.array(astuple(self.settings)),
            "local_log_gain": self.log_gain,
            "local_sizes": self.sizes,
            "local_others": np.array([astuple(own) for own in self.others]),
        }

    @staticmethod
    def from_arrays(arrays: Mapping[str, NDArray]) -> LocalExposure | None:
        """Inverse of :meth:`arrays`; None where there are none."""
        if "local_settings" not in arrays:
            return None
        settings = LocalSettings(*arrays["local_settings"].tolist())
        others = tuple(LocalSettings(*own) for own in arrays["local_others"].tolist())
        log_gain, sizes = arrays["local_log_gain"], arrays["local_sizes"]
        return LocalExposure(settings=settings, log_gain=log_gain, sizes=sizes, others=others)

    def raised(self, exponent: float) -> LocalExposure:
        """The local exposure under which the same photos show radiance to the power ``exponent``."""
        settings, *others = (
            replace(own, headroom=own.headroom**exponent, falloff=own.falloff * exponent)
            for own in (self.settings, *self.others)
        )
        log_gain = (self.log_gain * exponent).astype(np.float32)
        return replace(self, settings=settings, log_gain=log_gain, others=tuple(others))


@dataclass(frozen=True)
class SmallPhotos:
    """Photos of any size, averaged to one small size.

    Attributes:
        z: (V, 24, 32, 3) float32 mean display values.
        clipped: (V, 24, 32) float32 share of pixels and channels that are clipped.
        sizes: (V, 2) height and width of the photos.
    """

    z: NDArray[np.float32]
    clipped: NDArray[np.float32]
    sizes: NDArray[np.int64]

    def take(self, rows: NDArray[np.bool_]) -> SmallPhotos:
        """Some of the photos."""
        return SmallPhotos(self.z[rows], self.clipped[rows], self.sizes[rows])

    def local_exposure(self, settings: LocalSettings, response: Response) -> LocalExposure:
        """The gains of the photos under their curve ``response`` and ``settings``.

        The Gaussian mean is that of log exposures y before compression, which solve the contraction
        y = y' + strength (B(y) - median B(y)) for the log exposures y' seen in the photos.
        """
        seen = np.log(np.maximum(response.invert(np.minimum(self.z + 0.5 / 255, 1.0)) @ LUMINANCE, BLACK_EXPOSURE))
        seen += self.clipped * np.log(settings.headroom)
        shift = np.zeros(seen.shape)
        if settings.strength:
            for _ in range(INVERSION_MAX_STEPS):
                before, shift = shift, settings.strength * self._base(seen + shift, settings.scale)
                if np.abs(shift - before).max() < INVERSION_TOLERANCE:
                    break
        return LocalExposure(settings, (-shift - settings.falloff * self._radius2()).astype(np.float32), self.sizes)

    def _base(self, log_exposure: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
        """(V, 24, 32) Gaussian means over their median in each photo."""
        # Cells are square in photos of 4:3 only; the median stands for the shape of all photos.
        height, width = np.median(self.sizes, axis=0)
        base = gaussian(scale * width / height * ROWS, ROWS) @ log_exposure @ gaussian(scale * COLUMNS, COLUMNS).T
        return base - np.median(base, axis=(1, 2), keepdims=True)

    def _radius2(self) -> NDArray[np.float64]:
        """(V, 24, 32) squared distance from the middle, 1 in the corners."""
        x = (np.arange(COLUMNS) + 0.5) / COLUMNS * 2 - 1
        y = (np.arange(ROWS) + 0.5) / ROWS * 2 - 1
        height, width = self.sizes.T[:, :, None, None].astype(np.float64)
        return ((x * width) ** 2 + (y[:, None] * height) ** 2) / (width**2 + height**2)


def gaussian(deviation: float, n: int) -> NDArray[np.float64]:
    """(n, n) weights of cells in the Gaussian mean around each; the last cell continues past either end."""
    reach = int(np.ceil(4 * deviation))
    offset = np.arange(-reach, reach + 1)
    weight = np.exp(-0.5 * (offset / deviation) ** 2)
    cell = np.arange(n)[:, None]
    mean = np.zeros((n, n))
    np.add.at(mean, (np.broadcast_to(cell, (n, len(offset))), np.clip(cell + offset, 0, n - 1)), weight / weight.sum())
    return mean


def _between(position: NDArray[np.floating], n: int) -> tuple[NDArray[np.int64], NDArray[np.floating]]:
    """Index of the cell before each position among ``n``, and the way from its middle to the next one's, in [0, 1]."""
    position = np.clip(position, 0.0, n - 1.0)
    before = np.minimum(position.astype(np.int64), n - 2)
    return before, position - before


def small_photo(
    values: NDArray[np.floating], valid: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(24, 32, 3) display values and (24, 32) share that is clipped, of a photo (H, W, 3) where it is valid (H, W)."""
    height, width = valid.shape
    step = max(1, min(height // (ROWS * CELL_PIXELS), width // (COLUMNS * CELL_PIXELS)))
    values, valid = values[::step, ::step], valid[::step, ::step]
    return shrink(values, valid), shrink((values >= SATURATED).mean(-1, keepdims=True), valid)[..., 0]


def shrink(values: NDArray[np.floating], valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(24, 32, C) mean of the valid pixels (H, W) of ``values`` (H, W, C) per cell; the median of cells without any."""
    height, width = valid.shape
    rows, columns = np.arange(ROWS) * height // ROWS, np.arange(COLUMNS) * width // COLUMNS

    def sums(pixels: NDArray) -> NDArray[np.float64]:
        return np.add.reduceat(np.add.reduceat(pixels, rows, axis=0, dtype=np.float64), columns, axis=1)

    count = sums(valid[..., None])
    small = sums(np.where(valid[..., None], values, 0)) / np.maximum(count, 1)
    filled = count[..., 0] > 0
    if filled.any():
        small[~filled] = np.median(small[filled], axis=0)
    return small.astype(np.float32)
