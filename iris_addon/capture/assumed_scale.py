"""A scale where no file has a unit: from the height at which people hold cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..model.capture import FloatArray, Mesh, View
from ..rays.tracer import Tracer

DOWN_RAYS = 64
"""Per camera, in a cone about the way down."""
CONE = 1.0
"""Tangent of its half angle."""
FLOOR_COSINES = (0.9, 0.98, 0.99)
"""Between the normal of what a ray meets and the up direction, for it to be level, from step to step."""
FLOOR_QUANTILE = 0.1
"""Of the levels that are met: tables and beds lie above, what is below is noise of a scan."""
MIN_LEVEL = 20
"""Rays that must meet something level."""


def height_over_floor(views: Sequence[View], mesh: Mesh, up: FloatArray) -> float | None:
    """Median height of the cameras over the floor, in units of the mesh; None where no floor is under them."""
    tracer, up = Tracer(mesh), np.asarray(up, float)
    positions = np.array([view.camera.position for view in views])
    side = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
    side /= np.linalg.norm(side)
    turn, far = np.arange(DOWN_RAYS) * 2.399963, CONE * np.sqrt((np.arange(DOWN_RAYS) + 0.5) / DOWN_RAYS)
    directions = -up + far[:, None] * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(up, side))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins, directions = np.repeat(positions, DOWN_RAYS, 0), np.tile(directions, (len(positions), 1))
    hits = tracer.closest(origins, directions)
    met = hits.face >= 0
    points, normals = origins[met] + hits.distance[met, None] * directions[met], tracer.normals[hits.face[met]]
    for cosine in FLOOR_COSINES:  # up is often the mean of cameras that look down, and leans
        along = normals @ up
        level = np.abs(along) > cosine
        if level.sum() < MIN_LEVEL:
            return None
        up = (np.sign(along[level])[:, None] * normals[level]).sum(0)
        up /= np.linalg.norm(up)
    levels = points[level] @ up
    return float(np.median(positions @ up) - np.quantile(levels, FLOOR_QUANTILE))
