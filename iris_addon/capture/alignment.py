"""How well a photo and the mesh agree: their edges, correlated under all shifts of a few pixels.

Edges of the photo and edges of the geometry seen from its camera are drawn small, blurred and correlated. A correct
pose has its highest correlation at no shift, a wrong one elsewhere, at a distance that tells its error. Where all edges
of the photo are texture, or the mesh has no edges in view, there is no clear peak, and the alignment is unclear.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter

from ..model.capture import Camera, FloatArray, Photo
from ..rays.tracer import Tracer
from .photos import shrink

ALIGN_WIDTH = 160
"""Pixels in a row of the photo and the geometry that are compared."""
ALIGN_REACH = 12
"""Largest shift that is tried, in pixels of that width."""
ALIGN_TOLERANCE = 1.5
"""A peak within this many of those pixels counts as no shift."""
ALIGN_PEAK_STD = 3.5
"""Standard deviations of all correlations by which a peak must exceed their mean to be clear."""
BORDER = 2
"""Pixels of that width beside invalid ones that show the border and no edge of the room."""
NORMAL_EDGE = 0.5
"""Change of the normal between neighbours, as a distance of unit vectors, that counts as a full edge."""
DEPTH_EDGE = 0.05
"""Relative bend of the inverse depth between neighbours that counts as a full edge; 0 on any plane."""

Verdict = Literal["aligned", "shifted", "unclear"]
EdgePair = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Band-passed edges (h, w) of a photo and of the mesh."""


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


def alignment(camera: Camera, photo: Photo, tracer: Tracer) -> tuple[float, Alignment, EdgePair]:
    """Share of the photo that shows the mesh, the alignment of its edges with those of the mesh, and both (h, w)."""
    small = camera.shrunk(ALIGN_WIDTH)
    depth, normal = seen_geometry(small, tracer)
    seen = float(np.isfinite(depth).mean())
    edges = band(shown_edges(photo, small)), band(geometry_edges(depth, normal))
    return seen, compare(*edges, camera.width / small.width), edges


def shown_edges(photo: Photo, small: Camera) -> NDArray[np.float64]:
    """(h, w) edges of ``photo`` at the size of ``small``; none where it has no valid pixels, or beside these."""
    values = photo.values / max(float(np.quantile(photo.values, 0.99)), 1e-9) if photo.hdr else photo.values
    edges = photo_edges(shrink(np.clip(values, 0, 1), small.height, small.width))
    if not photo.valid.all():
        missing = shrink((~photo.valid)[..., None].astype(np.float64), small.height, small.width)[..., 0]
        edges[maximum_filter(missing, 2 * BORDER + 1) > 0] = 0
    return edges


def seen_geometry(camera: Camera, tracer: Tracer) -> tuple[FloatArray, FloatArray]:
    """(H, W) depth along the view axis, inf where nothing is met, and (H, W, 3) normal, zero there."""
    origins, directions = camera.rays()
    hits = tracer.closest(origins, directions)
    met = hits.face >= 0
    along = hits.distance * (directions @ -camera.c2w[:3, 2])
    depth = np.where(met, along, np.inf).reshape(camera.height, camera.width)
    normal = np.where(met[:, None], tracer.normals[hits.face], 0.0).reshape(camera.height, camera.width, 3)
    return depth, normal


def align(photo: FloatArray, depth: FloatArray, normal: FloatArray, pixels: float) -> Alignment:
    """Compare a small photo (h, w, 3) with depth (h, w) and normal (h, w, 3) of the mesh from its camera.

    Args:
        pixels: how many pixels of the photo one small pixel is wide.
    """
    return compare(band(photo_edges(photo)), band(geometry_edges(depth, normal)), pixels)


def compare(photo: NDArray[np.float64], geometry: NDArray[np.float64], pixels: float) -> Alignment:
    """Compare band-passed edges (h, w) of a photo with those of the mesh; ``pixels`` as for :func:`align`."""
    full = correlation(photo, geometry)
    if full is None:
        return Alignment(0.0, 0.0, "unclear")
    near, reach = near_no_shift(full)
    row, column = np.unravel_index(np.argmax(near), near.shape)
    shift = float(np.hypot(row - reach, column - reach))
    clear = near.max() - near.mean() > ALIGN_PEAK_STD * near.std()
    verdict: Verdict = "unclear" if not clear else "aligned" if shift <= ALIGN_TOLERANCE else "shifted"
    return Alignment(float(near[reach, reach]), shift * pixels, verdict)


def band(edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """(h, w) band-passed: finest detail is noise, and broad brightness of an edge map correlates with anything."""
    smooth = gaussian_filter(edges, 1.0)
    return smooth - gaussian_filter(smooth, 8.0)


def correlation(a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.float64] | None:
    """(h, w) correlation of two maps (h, w) under every cyclic shift, [0, 0] being none; None where one is flat."""
    energy = np.sqrt((a**2).sum() * (b**2).sum())
    if energy < 1e-9:
        return None
    return np.fft.irfft2(np.fft.rfft2(a) * np.conj(np.fft.rfft2(b)), a.shape) / energy


def near_no_shift(full: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """The shifts up to a reach that is returned too, from -reach to +reach along both axes."""
    reach = min(ALIGN_REACH, min(full.shape) // 4)
    return np.roll(full, (reach, reach), axis=(0, 1))[: 2 * reach + 1, : 2 * reach + 1], reach


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
