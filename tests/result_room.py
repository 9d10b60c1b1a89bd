"""A small made-up result for tests: a box with a lamp in its ceiling."""

from __future__ import annotations

import numpy as np

from iris_addon.model.capture import Mesh
from iris_addon.model.recovered import Emitter, OutsideLight, Textures
from iris_addon.model.response import Response, gamma
from iris_addon.results.folder import SCHEMA_VERSION
from iris_addon.results.result import Result

SIDE = 16


def box() -> Mesh:
    """A unit cube of 12 triangles with UVs, one grid cell of the atlas per face."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int64)
    corner = np.array([[0.05, 0.05], [0.9, 0.1], [0.1, 0.9]]) / 4
    uv = np.stack([corner + [f % 4 / 4, f // 4 / 4] for f in range(len(faces))]).astype(np.float32)
    return Mesh(vertices, faces, uv)


def room(seed: int = 0, outside: bool = True, response: Response | None = None) -> Result:
    rng = np.random.default_rng(seed)
    mesh = box()
    textures = Textures(
        rng.random((SIDE, SIDE, 3), np.float32),
        rng.random((SIDE, SIDE), np.float32),
        rng.random((SIDE, SIDE), np.float32),
        rng.random((SIDE, SIDE), np.float32),
    )
    emitters = (
        Emitter(id=3, faces=np.array([10, 11]), radiance=np.array([1 / 3, 20.0, 1e-3]), area=1.0, confidence=0.75),
        Emitter(id=5, faces=np.array([0, 2, 3]), radiance=np.array([4.0, 5.0, 6.0]), area=1.5, confidence=0.5),
    )
    return Result(
        mesh=mesh,
        regions=np.arange(12, dtype=np.int32) // 2,
        textures=textures,
        emitters=emitters,
        outside=OutsideLight(rng.normal(size=(4, 3))) if outside else None,
        response=response or gamma(),
        exposures={"000_0001": np.array([0.5, 0.25, 0.125]), "001_0001": np.array([1 / 3, 1 / 7, 1 / 9])},
        report={
            "schema_version": SCHEMA_VERSION,
            "preset": "draft",
            "seconds": {"trace": 1.5},
            "warnings": ["a lamp is guessed"],
        },
        up=(0.0, 1.0, 0.0),
    )
