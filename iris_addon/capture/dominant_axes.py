"""The axes along which the walls of a room stand, from normals of its surface or from points on it."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..model.capture import FloatArray

AXES_STARTS, AXES_WIDTHS, AXES_APART = 40, (0.5, 0.5, 0.35, 0.35, 0.2, 0.2, 0.2), 0.14
"""Random frames from which dominant axes are sought, the sines within which normals count from step to step, and
radians by which two such frames must differ."""
NEIGHBOURS, MIN_NEIGHBOURS = 24, 8
"""Of a point, by which its normal is found, and with which it is known."""


@cache
def turns() -> Rotation:
    """The 24 rotations that take axes to axes."""
    return Rotation.create_group("O")


def plane_normals(points: NDArray[np.float64], radius: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n, 3) unit normals of ``points`` by their neighbours within ``radius``, and (n,) how flat these lie."""
    tree = cKDTree(points)
    _, near = tree.query(points, min(NEIGHBOURS, len(points)), distance_upper_bound=radius)
    known = near < len(points)
    count = known.sum(1)
    around = np.where(known[..., None], points[np.minimum(near, len(points) - 1)] - points[:, None], 0.0)
    mean = around.sum(1) / count[:, None]
    spread = np.einsum("nki,nkj->nij", around, around) / count[:, None, None] - mean[:, :, None] * mean[:, None]
    values, vectors = np.linalg.eigh(spread)
    flat = np.clip((values[:, 1] - 3 * values[:, 0]) / np.maximum(values[:, 2], 1e-30), 0, 1)
    return vectors[:, :, 0], np.where(count >= MIN_NEIGHBOURS, flat, 0.0)


def dominant_axes(
    normals: NDArray[np.float64], weight: NDArray[np.float64], rng: np.random.Generator, count: int = 3
) -> list[NDArray[np.float64]]:
    """Up to ``count`` (3, 3) frames, in rows, near whose axes most ``normals`` (n, 3) point, the best first."""
    found: list[tuple[float, NDArray[np.float64]]] = []
    for start in Rotation.random(AXES_STARTS, rng).as_matrix():
        score, axes = _settled_axes(start, normals, weight)
        if all(_angle_modulo_axes(axes, other) > AXES_APART for _, other in found):
            found.append((score, axes))
    return [axes for _, axes in sorted(found, key=lambda pair: -pair[0])[:count]]


def _settled_axes(
    axes: NDArray[np.float64], normals: NDArray[np.float64], weight: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64]]:
    """The weight of ``normals`` near the axes of the frame next to ``axes``, and it, by alternating assignment."""
    for width in AXES_WIDTHS:
        along = normals @ axes.T
        axis = np.abs(along).argmax(1)
        cosine = along[np.arange(len(axis)), axis]
        use = weight * np.exp(-(1 - cosine**2) / width**2)
        total = np.zeros((3, 3))
        np.add.at(total, axis, (use * np.sign(cosine))[:, None] * normals)
        axes = Rotation.align_vectors(total / max(float(np.linalg.norm(total)), 1e-30), np.eye(3))[0].as_matrix().T
    return float(use.sum()), axes


def _angle_modulo_axes(a: FloatArray, b: FloatArray) -> float:
    """Angle between two frames, whichever axes are taken for one another."""
    return float((Rotation.from_matrix(a @ b.T) * turns()).magnitude().min())
