"""Sparse points of a capture as structure from motion finds them, and a frame and a unit of its own for its poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from iris_addon.capture.alignment import shown_edges
from iris_addon.capture.photos import load_photo
from iris_addon.model.capture import Capture
from iris_addon.rays.tracer import Tracer

PER_VIEW = 600
NOISE, OUTLIERS = 0.01, 0.2
"""Standard deviation per axis in distances from the camera, and share of points anywhere in the room."""


def sparse_points(capture: Capture, rng: np.random.Generator, noise: float = NOISE) -> np.ndarray:
    """(n, 3) noisy points of the mesh, more of them where the photos have edges, and outliers."""
    tracer, found = Tracer(capture.mesh), []
    for view in capture.views:
        camera = view.camera.shrunk(160)
        weight = shown_edges(load_photo(view), camera).ravel() + 0.05
        origin, direction = camera.rays(rng.choice(weight.size, PER_VIEW, p=weight / weight.sum()))
        hits = tracer.closest(origin, direction)
        met = hits.face >= 0
        distance = hits.distance[met, None]
        away = rng.normal(size=(met.sum(), 3)) * noise * distance
        found.append(origin[met] + direction[met] * distance + away)
    points = np.concatenate(found)
    wrong = rng.choice(len(points), int(OUTLIERS * len(points)), replace=False)
    points[wrong] = rng.uniform(points.min(0), points.max(0), (len(wrong), 3))
    return points


def random_similarity(rng: np.random.Generator) -> np.ndarray:
    """(4, 4) with any rotation, a scale from 0.05 to 20 and a shift of some units."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.exp(rng.uniform(np.log(0.05), np.log(20))) * Rotation.random(random_state=rng).as_matrix()
    matrix[:3, 3] = rng.uniform(-10, 10, 3)
    return matrix


def write_points(path: Path, points: np.ndarray) -> None:
    """As COLMAP's text."""
    lines = [f"{k} {x} {y} {z} 128 128 128 0.5 1 {k} 2 {k}" for k, (x, y, z) in enumerate(points.tolist(), 1)]
    path.write_text("# 3D point list\n" + "\n".join(lines) + "\n")
