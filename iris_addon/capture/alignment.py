"""How well a photo lies over the mesh: edges of the photo against edges of the geometry seen from the same camera.

Both are drawn small, blurred and correlated under all shifts of a few pixels. A pose that fits has its highest
correlation at no shift; a pose that is off has it elsewhere, and the distance says by how much. A photo whose edges are
all texture, or a mesh without edges in view, has no clear peak: then nothing is claimed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, zoom

from ..model.capture import Camera, FloatArray

WIDTH = 160
"""Width in pixels at which edges are compared."""
REACH = 12
"""Largest shift that is tried, in pixels of that width."""
CLOSE = 1.5
"""A peak within this many of those pixels counts as no shift."""
CLEAR = 3.5
"""Standard deviations by which a peak must stand out of all shifts to mean anything."""
NORMAL_EDGE = 0.5
"""Change of the normal between neighbours, as a distance of unit vectors, that counts as a full edge."""
DEPTH_EDGE = 0.05
"""Relative bend of the inverse depth between neighbours that counts as a full edge; 0 on any plane."""

Verdict = Literal["aligned", "shifted", "unclear"]


@dataclass(frozen=True)
class Alignment:
    """Result for one photo.

    Attributes:
        score: correlation of the edges at no shift, -1 to 1.
        shift: distance of the best shift in pixels of the photo.
        verdict: "aligned", "shifted" by ``shift``, or "unclear".
    """

    score: float
    shift: float
    verdict: Verdict


def small_camera(camera: Camera, width: int = WIDTH) -> Camera:
    """``camera`` with at most ``width`` pixels a row, the same field of view."""
    scale = min(1.0, width / camera.width)
    w, h = max(2, round(camera.width * scale)), max(2, round(camera.height * scale))
    x, y = w / camera.width, h / camera.height
    return replace(camera, width=w, height=h, fx=camera.fx * x, fy=camera.fy * y, cx=camera.cx * x, cy=camera.cy * y)


def geometry_edges(depth: FloatArray, normal: FloatArray) -> NDArray[np.float64]:
    """(H, W) strength 0 to 1 of silhouettes and creases.

    Args:
        depth: (H, W) along the view axis, metres; inf where no surface is seen.
        normal: (H, W, 3) unit, zero where no surface is seen.
    """
    inverse = np.where(np.isfinite(depth), 1.0 / np.maximum(depth, 1e-6), 0.0)
    smooth = gaussian_filter(normal, (1.0, 1.0, 0))  # the facets of a scan are no edges
    strength = np.zeros(depth.shape)
    for axis in (0, 1):
        # Inverse depth is linear across the image of a plane, so that its second difference is zero there.
        bend = np.abs(np.diff(inverse, 2, axis=axis))
        middle = np.take(inverse, np.arange(1, inverse.shape[axis] - 1), axis=axis)
        jump = np.clip(bend / np.maximum(middle, 1e-6) / DEPTH_EDGE, 0, 1)
        turn = np.clip(np.linalg.norm(np.diff(smooth, axis=axis), axis=-1) / NORMAL_EDGE, 0, 1)
        inner = [slice(None), slice(None)]
        inner[axis] = slice(1, -1)
        strength[tuple(inner)] = np.maximum(strength[tuple(inner)], jump)
        inner[axis] = slice(0, -1)
        strength[tuple(inner)] = np.maximum(strength[tuple(inner)], turn)
    return strength


def photo_edges(values: FloatArray) -> NDArray[np.float64]:
    """(h, w) strength 0 to 1 of the gradient of display values (h, w, 3)."""
    grey = np.asarray(values, float) @ (0.2126, 0.7152, 0.0722)
    rows, columns = np.gradient(grey)
    strength = np.hypot(rows, columns)
    return np.clip(strength / max(float(np.quantile(strength, 0.97)), 1e-3), 0, 1)


def shrink(values: FloatArray, height: int, width: int) -> NDArray[np.float64]:
    """``values`` (H, W, 3) smoothed and resampled to (height, width, 3)."""
    scale = values.shape[1] / width
    smooth = gaussian_filter(np.asarray(values, float), (0.4 * scale, 0.4 * scale, 0)) if scale > 1 else values
    factors = (height / values.shape[0], width / values.shape[1], 1)
    return np.asarray(zoom(smooth, factors, order=1, grid_mode=True, mode="nearest"))


def align(photo: FloatArray, depth: FloatArray, normal: FloatArray, pixels: float) -> Alignment:
    """Compare a small photo (h, w, 3) with depth (h, w) and normal (h, w, 3) of the mesh from its camera.

    Args:
        pixels: how many pixels of the photo one small pixel is wide.
    """
    a = gaussian_filter(photo_edges(photo), 1.0)
    b = gaussian_filter(geometry_edges(depth, normal), 1.0)
    # High-passed: broad brightness of either edge map correlates with anything.
    a, b = a - gaussian_filter(a, 8.0), b - gaussian_filter(b, 8.0)
    energy = np.sqrt((a**2).sum() * (b**2).sum())
    if energy < 1e-9:
        return Alignment(0.0, 0.0, "unclear")
    reach = min(REACH, min(a.shape) // 4)
    full = np.fft.irfft2(np.fft.rfft2(a) * np.conj(np.fft.rfft2(b)), a.shape) / energy
    near = np.roll(full, (reach, reach), axis=(0, 1))[: 2 * reach + 1, : 2 * reach + 1]
    row, column = np.unravel_index(np.argmax(near), near.shape)
    shift = float(np.hypot(row - reach, column - reach))
    clear = near.max() - near.mean() > CLEAR * near.std()
    verdict: Verdict = "unclear" if not clear else "aligned" if shift <= CLOSE else "shifted"
    return Alignment(float(near[reach, reach]), shift * pixels, verdict)
