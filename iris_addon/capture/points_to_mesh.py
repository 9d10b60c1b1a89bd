"""The similarities that take the sparse points of the photos onto a mesh.

Structure from motion has a frame and a unit of its own, and a mesh from elsewhere has another. What both have is walls.
Rotations are proposed by the dominant directions of both and by the up direction of the photos, scales over a range,
and shifts by the levels at which walls lie along each axis (1-D cross-correlation). The share of points near the mesh
ranks these hypotheses, and point-to-plane ICP with scale and a robust weight refines the best of them.

Limits: a symmetrical room has several similarities that fit the points equally well. All are returned; the photos tell
which of them is right (:mod:`iris_addon.capture.common_frame`).

References: Zinßer, Schmidt & Niemann, "Point set registration with integrated scale estimation", PRIP 2005; Chetverikov
et al., "The trimmed iterative closest point algorithm", ICPR 2002. Set by experiment 0140.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..base.random_streams import stream
from ..model.capture import FloatArray, Mesh, View
from .dominant_axes import dominant_axes, plane_normals, turns
from .listing import mean_up
from .similarity import Similarity

MIN_POINTS = 100
"""Fewer sparse points are not registered."""
MAX_POINTS, FEW_POINTS = 8000, 300
"""Of the points, spread over the room, that the best hypotheses, and all of them, are tried with."""
THIN, FEW_THIN = 60, 15
"""Cells in an extent of the points, of which each keeps one point."""
MESH_SAMPLES = 40_000
MAX_ROOMS = 6.0
"""Extents from the middle of the mesh beyond which its surface is a backdrop, and no wall."""
SCALES = np.geomspace(0.2, 5.0, 55)
"""Ratios of the extents of points and mesh: one may show a corner of the other."""
YAW_STEPS = 24
"""Turns about the up direction that are tried beside those of dominant directions."""
LEVEL_BINS, LEVEL_BAND = 256, (1.0, 12.0)
"""Bins of the histograms that propose shifts, and the bins over which those are smoothed and cleared of their broad
part."""
GRID_CELLS = 112
"""Cells of the distance field along the longest side of the mesh."""
NEAR = 0.04
"""Distance to the mesh, in extents of the points, at which a hypothesis explains a point."""
MATCHED = 0.03
"""As ``NEAR``, after refinement."""
MAX_GROWTH = 0.3
"""Logarithm of the change of scale by a refinement."""
WIDEST, NARROWER, TUKEY = 0.15, 0.8, 4.685
"""Width of the weight of residuals: at first, in extents of the points; from step to step; and at last, in standard
deviations."""
POLISH = 0.08
"""First width of the last refinement, with all points."""
MAX_STEP, SETTLED = 0.2, 1e-4
"""Of a refinement, in radians, logarithm of the scale and extents."""
KEPT = (400, 40, 8)
"""Hypotheses after the count of points, and the coarse and the fine refinement."""
MIN_INSIDE = 0.5
"""Share of the cameras that must lie within the bounds of the mesh."""
ALIKE_ANGLE, ALIKE_SCALE, ALIKE_SHIFT = 0.12, 0.06, 0.1
"""Radians, logarithm, and extents within which two hypotheses are one."""


@dataclass(frozen=True)
class _Breadth:
    """How many hypotheses are looked at.

    Attributes:
        levels: shifts that are proposed per axis.
        kept: hypotheses after the shifts.
        counted: points by which the share near the mesh is then estimated.
    """

    levels: int
    kept: int
    counted: int


OF_RECONSTRUCTION, OF_PHOTOS = _Breadth(3, 1000, FEW_POINTS), _Breadth(5, 3000, 150)
"""For the sparse points of a reconstruction, and for the few that photos are found to show in common: with three levels
corners of furniture hide the walls from those."""


def find_similarities(
    points: FloatArray,
    views: Sequence[View],
    mesh: Mesh,
    check: Callable[[], None] = lambda: None,
    *,
    of_photos: bool = False,
) -> list[Similarity]:
    """Similarities that bring the sparse ``points`` (n, 3) of the photos onto the mesh, the best first; may be empty.

    Args:
        views: the photos, in the frame of ``points``.
        check: called often; may raise, as for a cancel.
        of_photos: the points were found in the photos, and are no reconstruction's own: more hypotheses are tried.
    """
    breadth = OF_PHOTOS if of_photos else OF_RECONSTRUCTION
    rng = stream(0, "capture.points_to_mesh")
    points = points[np.isfinite(points).all(1)]
    if len(points) < MIN_POINTS or not len(mesh.faces):
        return []
    target = _Target(mesh, rng)
    cloud = _Cloud(points, rng)
    if len(cloud.few) < MIN_POINTS:  # all in one place
        return []
    cameras = np.array([view.camera.position for view in views])
    hypotheses = _hypotheses(cloud, target, _rotations(cloud, target, views), breadth, check)
    hypotheses = _counted(hypotheses, cloud, target, cameras, breadth, check)
    hypotheses = _distinct(hypotheses, cloud, KEPT[1])
    for which, widest, steps in ((cloud.few, WIDEST, 8), (cloud.all[:1000], WIDEST, 12), (cloud.all, POLISH, 6)):
        refined = []
        for hypothesis in hypotheses:
            check()
            refined.append(_refined(hypothesis, which, cloud.extent, target, widest, steps))
        hypotheses = _distinct(refined, cloud, KEPT[2])
    return [replace(one, middle=target.middle, extent=target.extent) for one in hypotheses]


# ---- What is brought together ---------------------------------------------------------------------------------------


class _Target:
    """Samples of the mesh with normals, their dominant axes, and a grid of distances to them."""

    def __init__(self, mesh: Mesh, rng: np.random.Generator) -> None:
        corners = mesh.vertices[mesh.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        double = np.linalg.norm(cross, axis=1)
        low, high = np.quantile(mesh.vertices, (0.02, 0.98), axis=0)
        size = float(np.linalg.norm(high - low))
        # A backdrop of a few huge faces would take all samples.
        weight = np.minimum(double / 2, (size / 2) ** 2)
        face = rng.choice(len(weight), MESH_SAMPLES, p=weight / weight.sum())
        a, b = rng.random((2, MESH_SAMPLES, 1))
        a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
        at = corners[face, 0] + a * (corners[face, 1] - corners[face, 0]) + b * (corners[face, 2] - corners[face, 0])
        near = np.abs(at - (low + high) / 2).max(1) < 1.5 * size
        self.samples = at[near]
        self.middle, self.extent = _middle_and_extent(self.samples)
        self.normals = (cross[face] / np.maximum(double[face], 1e-30)[:, None])[near]
        self.tree = cKDTree(self.samples)
        self.axes = dominant_axes(self.normals[:4000], np.ones(min(4000, len(self.normals))), rng)[0]
        self.low, self.high = self.samples.min(0), self.samples.max(0)
        self._fill_grid()

    def _fill_grid(self) -> None:
        margin = 0.2 * self.extent
        size = self.high - self.low + 2 * margin
        self.cell = float(size.max()) / GRID_CELLS
        self.origin = self.low - margin
        empty = np.ones((np.ceil(size / self.cell).astype(int) + 1).tolist(), bool)
        empty[tuple(((self.samples - self.origin) / self.cell).astype(int).T)] = False
        self.distance = (np.asarray(distance_transform_edt(empty)) * self.cell).astype(np.float32)

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """(...) distance of ``points`` (..., 3) from the mesh, to a cell of the grid; inf beyond it."""
        index = np.floor((points - self.origin) / self.cell).astype(np.int32)
        inside = ((index >= 0) & (index < self.distance.shape)).all(-1)
        index = np.where(inside[..., None], index, 0)
        return np.where(inside, self.distance[index[..., 0], index[..., 1], index[..., 2]], np.float32(np.inf))


class _Cloud:
    """Sparse points, thinned so that no texture outweighs a wall, and their dominant axes."""

    def __init__(self, points: FloatArray, rng: np.random.Generator) -> None:
        self.middle, self.extent = _middle_and_extent(points)
        points = points[rng.permutation(len(points))]
        points = points[np.linalg.norm(points - self.middle, axis=1) < MAX_ROOMS * self.extent]
        self.all = self._thinned(points, THIN)[:MAX_POINTS]
        self.few = self._thinned(points, FEW_THIN)[:FEW_POINTS]
        enough = len(self.few) >= MIN_POINTS
        self.axes = dominant_axes(*plane_normals(self.all, 0.3 * self.extent), rng) if enough else []

    def _thinned(self, points: FloatArray, cells: int) -> NDArray[np.float64]:
        cell = np.floor((points - self.middle) * (cells / self.extent))
        _, first = np.unique(cell, axis=0, return_index=True)
        return points[np.sort(first)]


def _middle_and_extent(points: FloatArray) -> tuple[NDArray[np.float64], float]:
    middle = np.median(points, axis=0)
    return middle, max(float(np.median(np.linalg.norm(points - middle, axis=1))), 1e-12)


# ---- Hypotheses -----------------------------------------------------------------------------------------------------


def _rotations(cloud: _Cloud, target: _Target, views: Sequence[View]) -> NDArray[np.float64]:
    """(n, 3, 3) from the points' axes to the mesh's dominant axes."""
    axes_turned = turns().as_matrix()
    rotations = [axes_turned @ axes for axes in cloud.axes]
    up = mean_up(views)
    if up is not None:
        to_z = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0]
        yaw = Rotation.from_rotvec(np.arange(YAW_STEPS)[:, None] * [0, 0, 2 * np.pi / YAW_STEPS])
        upright = (yaw * to_z).as_matrix()
        _, first = np.unique(axes_turned[:, :, 2].round(), axis=0, return_index=True)
        rotations += [axes_turned[k] @ upright for k in first]
    return np.concatenate(rotations)


def _hypotheses(
    cloud: _Cloud, target: _Target, rotations: NDArray[np.float64], breadth: _Breadth, check: Callable[[], None]
) -> list[tuple[NDArray[np.float64], float, NDArray[np.float64]]]:
    """Rotations to the mesh's axes, scales, and per axis the best shifts (3, levels) of the middles."""
    walls = (target.samples - target.middle) @ target.axes.T
    half = 1.3 * float(np.abs(walls).max())
    width = 2 * half / LEVEL_BINS
    of_mesh = _levels(walls.T[None], half)
    scales = SCALES * target.extent / cloud.extent
    scores, shifts = [], []
    for rotation in rotations:
        check()
        along = scales[:, None, None] * (rotation @ (cloud.few - cloud.middle).T)
        match = np.fft.irfft(np.conj(_levels(along, half)) * of_mesh)
        match = np.roll(match, LEVEL_BINS, axis=2)[..., LEVEL_BINS // 2 : -LEVEL_BINS // 2]
        peaks = (match >= np.roll(match, 1, 2)) & (match > np.roll(match, -1, 2))
        best = np.argsort(np.where(peaks, match, -1), axis=2)[..., ::-1][..., : breadth.levels]
        scores.append(np.take_along_axis(match, best, 2)[..., 0].sum(1))
        shifts.append((best - LEVEL_BINS // 2) * width)
    order = np.argsort(np.concatenate(scores))[::-1][: breadth.kept]
    turn, scale = np.divmod(order, len(scales))
    return [(rotations[k], float(scales[j]), shifts[k][j]) for k, j in zip(turn, scale, strict=True)]


def _levels(along: NDArray[np.float64], half: float) -> NDArray[np.complex128]:
    """Spectra (s, 3, LEVEL_BINS + 1) of histograms over -half to half of ``along`` (s, 3, n), padded to twice their
    length, without their broad part and their finest, and of unit energy."""
    bins = np.floor((along + half) * (LEVEL_BINS / (2 * half))).astype(np.int64)
    inside = (bins >= 0) & (bins < LEVEL_BINS)
    row = np.arange(along.shape[0] * 3).reshape(-1, 3, 1) * LEVEL_BINS
    counts = np.bincount((row + bins)[inside], minlength=along.shape[0] * 3 * LEVEL_BINS)
    spectrum = np.fft.rfft(counts.reshape(-1, 3, LEVEL_BINS), 2 * LEVEL_BINS)
    frequency = np.fft.rfftfreq(2 * LEVEL_BINS) * 2 * np.pi
    fine, broad = (np.exp(-0.5 * (sigma * frequency) ** 2) for sigma in LEVEL_BAND)
    spectrum *= fine - broad
    return spectrum / np.maximum(np.linalg.norm(spectrum, axis=2, keepdims=True), 1e-12)


def _counted(
    hypotheses: Sequence[tuple[NDArray[np.float64], float, NDArray[np.float64]]],
    cloud: _Cloud,
    target: _Target,
    cameras: NDArray[np.float64],
    breadth: _Breadth,
    check: Callable[[], None],
) -> list[Similarity]:
    """The hypotheses under which most points lie near the mesh, and the cameras within its bounds."""
    choice = np.stack(np.meshgrid(*[range(breadth.levels)] * 3, indexing="ij"), -1).reshape(-1, 3)
    found = []
    for turn, scale, levels in hypotheses:
        check()
        rotation = target.axes.T @ turn
        shifts = target.middle + levels[[0, 1, 2], choice] @ target.axes
        moved = scale * (cloud.few[: breadth.counted] - cloud.middle) @ rotation.T
        near = NEAR * scale * cloud.extent
        shares = (target.distances(moved + shifts[:, None]) < near + target.cell).mean(1)
        shares *= near / (near + target.cell)  # small clouds lie near anything within a cell of the grid
        inside = scale * (cameras - cloud.middle) @ rotation.T + shifts[:, None]
        inside = ((inside > target.low) & (inside < target.high)).all(-1).mean(1) >= MIN_INSIDE
        shares = np.where(inside, shares, 0.0)
        for k in np.argsort(shares)[::-1][:3]:
            if inside[k]:
                shift = shifts[k] - scale * rotation @ cloud.middle
                found.append(Similarity(rotation, scale, shift, float(shares[k])))
    return sorted(found, key=lambda one: -one.share)[: KEPT[0]]


def _distinct(found: Sequence[Similarity], cloud: _Cloud, count: int) -> list[Similarity]:
    """The best ``count`` of which no two are alike."""
    kept: list[Similarity] = []
    for one in sorted(found, key=lambda one: -one.share):
        if not any(_alike(one, other, cloud) for other in kept):
            kept.append(one)
        if len(kept) == count:
            break
    return kept


def _alike(a: Similarity, b: Similarity, cloud: _Cloud) -> bool:
    if abs(np.log(a.scale / b.scale)) > ALIKE_SCALE:
        return False
    cosine = (np.trace(a.rotation @ b.rotation.T) - 1) / 2
    if np.arccos(np.clip(cosine, -1, 1)) > ALIKE_ANGLE:
        return False
    apart = np.linalg.norm(a.points(cloud.middle[None]) - b.points(cloud.middle[None]))
    return bool(apart < ALIKE_SHIFT * a.scale * cloud.extent)


# ---- Refinement -----------------------------------------------------------------------------------------------------


def _refined(
    start: Similarity, points: NDArray[np.float64], extent: float, target: _Target, widest: float, steps: int
) -> Similarity:
    """Point-to-plane ICP with scale: each step solves for a small turn, growth and shift about the middle of the
    points, with Tukey's weight, whose width shrinks to the noise of the points."""
    found, width = start, widest
    for step in range(steps):
        unit = found.scale * extent
        moved = found.points(points)
        distance, nearest = target.tree.query(moved)
        normal = target.normals[nearest]
        residual = ((target.samples[nearest] - moved) * normal).sum(1)
        noise = 1.4826 * _median(np.abs(residual[distance < width * unit]))
        width = max(widest * NARROWER**step, min(TUKEY * noise / unit, width), 1e-6)
        close = distance < width * unit
        if close.sum() < MIN_POINTS // 4:
            break
        weight = np.where(close, np.clip(1 - (residual / (width * unit)) ** 2, 0, None) ** 2, 0.0)
        middle = moved[close].mean(0)
        arm = (moved - middle) / unit
        rows = np.concatenate([np.cross(arm, normal), (arm * normal).sum(1)[:, None], normal], axis=1)
        normal_matrix = (rows * weight[:, None]).T @ rows
        normal_matrix += 1e-9 * np.trace(normal_matrix) * np.eye(7)
        by = np.clip(np.linalg.solve(normal_matrix, rows.T @ (weight * residual / unit)), -MAX_STEP, MAX_STEP)
        found = replace(found, middle=middle, extent=unit).nudged(by)
        if abs(np.log(found.scale / start.scale)) > MAX_GROWTH:  # it shrinks onto one wall
            return replace(start, share=0.0)
        if np.abs(by).max() < SETTLED and width > widest * NARROWER**step:  # the noise of the points sets it
            break
    distance, _ = target.tree.query(found.points(points))
    return replace(found, share=float((distance < MATCHED * found.scale * extent).mean()))


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if len(values) else 0.0
