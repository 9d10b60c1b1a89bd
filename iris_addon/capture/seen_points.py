"""Sparse points of photos whose poses are known and whose program gives none: corners that several photos show.

Corners are found at a few sizes (Harris & Stephens 1988; the harmonic mean of the eigenvalues by Brown, Szeliski &
Winder 2005) and described by the gradients around them (Lowe, IJCV 2004), not turned, because people hold cameras
upright. Two photos that look the same way match a corner along its epipolar line. A point stands where the matches of
one corner with two photos or more agree on its distance.

Limits: poses must be those of the photos; where they mean something else than is taken here, next to no point is found.
Photos far apart share few corners. Repeated patterns leave some points in wrong places, which
:mod:`iris_addon.capture.points_to_mesh` bears. Set by experiment 0140.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter

from ..base.parallel import over_each
from ..model.capture import Camera, FloatArray, View
from .photos import load_photo, photos_at_once

SEEN_PHOTOS, SEEN_WIDTH = 48, 640
"""Photos, spread over the capture, and pixels in a row of them, at least, that are looked at."""
CORNERS, CORNER_SIZES = 1200, (1.0, 1.6, 2.6)
"""Corners of the smallest size in a photo at most, a half and a third as many of the others, and sizes in pixels."""
CELLS, CELL, BINS = 4, 4, 8
"""Squares in a row of a descriptor, samples in a row of each, and directions of the gradient in it."""
SAMPLE_STEP, SAMPLE_SPREAD = 0.9, 6.0
"""Distance of samples in sizes, and the standard deviation of their weight in samples."""
LARGEST_ENTRY = 0.2
"""Of a descriptor of unit length, so that no single edge decides (Lowe)."""
DARKEST = 0.02
"""Display value that is added before the logarithm, under which exposures are shifts."""
PARTNERS, WIDEST_ANGLE, SHORTEST_BASE = 8, np.radians(50.0), 0.03
"""Photos that each is matched with, the angle between their axes, and the least distance in extents of the cameras."""
ANGLE_WEIGHT = np.radians(30.0)
"""Angle that makes a partner as unlikely as an extent of the cameras."""
LINE_DISTANCE = 1.5
"""Pixels from the epipolar line."""
MIN_LIKENESS, MAX_RATIO = 0.8, 0.8
"""Cosine of two descriptors that match, and the distance from it over that of the next best."""
MIN_PARALLAX, SAME_DISTANCE = np.radians(2.0), 0.04
"""Angle between two rays to a point, and relative difference of distances that agree."""


@dataclass(frozen=True)
class _Corners:
    """Corners of one photo.

    Attributes:
        camera: the pinhole of the photo, as small as it was looked at.
        places: (n, 2) pixels, right and down.
        descriptors: (n, CELLS² BINS) float32 of unit length.
    """

    camera: Camera
    places: NDArray[np.float64]
    descriptors: NDArray[np.float32]

    def rays(self) -> NDArray[np.float64]:
        """(n, 3) directions in the frame of the camera, -1 along its axis backward."""
        c, (x, y) = self.camera, self.places.T
        return np.stack([(x - c.cx) / c.fx, -(y - c.cy) / c.fy, -np.ones(len(x))], axis=1)


def seen_points(views: Sequence[View], check: Callable[[], None] = lambda: None) -> FloatArray:
    """(n, 3) points in the frame of the poses that at least three of the photos show.

    Args:
        check: called often; may raise, as for a cancel.

    Raises:
        BadInput: a photo cannot be read.
    """
    posed = [view for view in views if view.photo is not None]
    some = np.unique(np.linspace(0, len(posed) - 1, min(len(posed), SEEN_PHOTOS)).round().astype(int))
    posed = [posed[k] for k in some]
    if len(posed) < 3:
        return np.empty((0, 3))
    corners = over_each(posed, _corners, lambda _: check(), photos_at_once(posed))
    partners = _partners([one.camera for one in corners])

    def of_photo(k: int) -> FloatArray:
        return _points(corners[k], [corners[other] for other in partners[k]])

    return np.concatenate(over_each(range(len(corners)), of_photo, lambda _: check()))


def _partners(cameras: Sequence[Camera]) -> list[list[int]]:
    """For each photo those that look about the same way from near."""
    places = np.array([camera.position for camera in cameras])
    axes = np.array([-camera.c2w[:3, 2] for camera in cameras])
    extent = max(float(np.median(np.linalg.norm(places - np.median(places, axis=0), axis=1))), 1e-12)
    angles = np.arccos(np.clip(axes @ axes.T, -1, 1))
    apart = np.linalg.norm(places[:, None] - places, axis=2) / extent
    cost = np.where((angles < WIDEST_ANGLE) & (apart > SHORTEST_BASE), apart + angles / ANGLE_WEIGHT, np.inf)
    order = np.argsort(cost, axis=1, kind="stable")[:, :PARTNERS]
    return [[int(k) for k in row if np.isfinite(cost[own, k])] for own, row in enumerate(order)]


# ---- Corners --------------------------------------------------------------------------------------------------------


def _corners(view: View) -> _Corners:
    small = view.reduced_to(SEEN_WIDTH)
    photo = load_photo(small)
    grey = np.log(np.maximum(photo.values, 0) @ np.array([0.2126, 0.7152, 0.0722], np.float32) + DARKEST)
    places, descriptors = [], []
    for rank, size in enumerate(CORNER_SIZES):
        rows, columns = np.gradient(gaussian_filter(grey.astype(np.float64), size))
        products = (columns * columns, columns * rows, rows * rows)
        xx, xy, yy = (gaussian_filter(product, 1.5 * size) for product in products)
        strength = (xx * yy - xy * xy) / (xx + yy + 1e-6)
        peak = (strength == maximum_filter(strength, int(2 * size + 1) | 1)) & (strength > 0) & photo.valid
        border = int(CELLS * CELL / 2 * size) + 2
        inner = np.zeros_like(peak)
        inner[border:-border, border:-border] = True
        y, x = np.nonzero(peak & inner)
        best = np.argsort(-strength[y, x], kind="stable")[: CORNERS // (rank + 1)]
        y, x = y[best].astype(np.float64), x[best].astype(np.float64)
        places.append(np.stack([x + 0.5, y + 0.5], axis=1))
        descriptors.append(_described(columns, rows, x, y, SAMPLE_STEP * size))
    return _Corners(small.camera, np.concatenate(places), np.concatenate(descriptors))


def _described(
    across: FloatArray, down: FloatArray, x: NDArray[np.float64], y: NDArray[np.float64], step: float
) -> NDArray[np.float32]:
    """(n, CELLS² BINS) histograms of the gradient, ``across`` and ``down`` (H, W), around pixels (n,), (n,)."""
    samples = CELLS * CELL
    offset = (np.arange(samples) - (samples - 1) / 2) * step
    dy, dx = np.meshgrid(offset, offset, indexing="ij")
    where = [y[:, None, None] + dy, x[:, None, None] + dx]
    gx, gy = (map_coordinates(part, where, order=1, mode="nearest") for part in (across, down))
    weight = np.hypot(gx, gy) * np.exp(-(dx**2 + dy**2) / (2 * (SAMPLE_SPREAD * step) ** 2))
    turn = np.arctan2(gy, gx) / (2 * np.pi) * BINS
    low = np.floor(turn).astype(np.int64)
    cell = np.arange(samples) // CELL
    row = np.arange(len(x))[:, None, None] * CELLS**2 + (cell[:, None] * CELLS + cell)[None]
    found = np.zeros(len(x) * CELLS**2 * BINS)
    for bin_, share in ((low, 1 - (turn - low)), (low + 1, turn - low)):
        found += np.bincount((row * BINS + bin_ % BINS).ravel(), (weight * share).ravel(), len(found))
    for largest in (LARGEST_ENTRY, np.inf):
        found = found.reshape(len(x), CELLS**2 * BINS)
        found = np.minimum(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12), largest)
    return found.astype(np.float32)


# ---- Points ---------------------------------------------------------------------------------------------------------


def _points(own: _Corners, others: Sequence[_Corners]) -> FloatArray:
    """(n, 3) places of the corners of one photo on whose distances the matches with two others agree."""
    distances = np.full((len(others), len(own.places)), np.nan)
    directions = _to_world(own)
    for row, other in zip(distances, others, strict=True):
        corner, match = _matches(own, other)
        row[corner] = _distances(own.camera, directions[corner], other.camera, _to_world(other)[match])
    if len(others) < 2:
        return np.empty((0, 3))
    with np.errstate(invalid="ignore"):
        agree = np.abs(distances[:, None] / distances[None] - 1) < SAME_DISTANCE  # (o, o, n)
    count = agree.sum(1)
    best = count.argmax(0)
    each = np.arange(len(own.places))
    among = agree[best, :, each]  # (n, o)
    known = among.sum(1) >= 2
    total = np.where(among, np.nan_to_num(distances.T), 0.0).sum(1)
    distance = total[known] / among.sum(1)[known]
    return own.camera.position + directions[known] * distance[:, None]


def _to_world(corners: _Corners) -> NDArray[np.float64]:
    """(n, 3) unit directions in the frame of the poses."""
    rays = corners.rays() @ corners.camera.c2w[:3, :3].T
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _matches(own: _Corners, other: _Corners) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of corners of two photos that match both ways, better than any other along the epipolar line."""
    none = np.empty(0, np.intp)
    if not len(own.places) or not len(other.places):
        return none, none
    a, b = own.camera, other.camera
    turn = b.c2w[:3, :3].T @ a.c2w[:3, :3]
    x, y, z = b.c2w[:3, :3].T @ (a.position - b.position)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    lines = own.rays() @ (cross @ turn).T
    off = np.abs(lines @ other.rays().T) / np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12)[:, None] * b.fx
    likeness = np.where(off < LINE_DISTANCE, own.descriptors @ other.descriptors.T, -1.0)
    each, match = np.arange(len(likeness)), likeness.argmax(1)
    best = likeness[each, match]
    mutual = likeness.argmax(0)[match] == each
    likeness[each, match] = -1.0
    distinct = (1 - best) < MAX_RATIO * (1 - likeness.max(1))
    found = np.flatnonzero((best > MIN_LIKENESS) & mutual & distinct)
    return found, match[found]


def _distances(a: Camera, from_a: NDArray[np.float64], b: Camera, from_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) distances from ``a`` along unit directions (n, 3) to where those from ``b`` pass; NaN where that is unsure
    or behind a camera."""
    base = b.position - a.position
    cosine = (from_a * from_b).sum(1)
    sine2 = np.maximum(1 - cosine**2, 1e-12)
    along_a, along_b = from_a @ base, from_b @ base
    of_a, of_b = (along_a - cosine * along_b) / sine2, (cosine * along_a - along_b) / sine2
    return np.where((sine2 > np.sin(MIN_PARALLAX) ** 2) & (of_a > 0) & (of_b > 0), of_a, np.nan)
