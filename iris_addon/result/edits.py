"""Changes to a solved room before it is rendered: lights off, scaled or added, objects put in.

Plain data, no bpy: written by the readers of lights.json and objects.json, carried out by ``iris_addon.blender``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Quad:
    """A one-sided rectangular light. Corners (4, 3) metres, ``normal`` (3,) the emitting side, radiance (3,) linear."""

    corners: NDArray[np.float64]
    normal: NDArray[np.float64]
    radiance: NDArray[np.float64]


@dataclass(frozen=True)
class Sphere:
    """An inserted ball with a Principled material; metres, linear colour."""

    center: NDArray[np.float64]
    radius: float
    base_color: NDArray[np.float64]
    roughness: float
    metallic: float
    specular: float = 0.5


@dataclass(frozen=True)
class SceneEdit:
    """What differs from the room as solved.

    Attributes:
        face_emission: (F, 3) radiance per face in place of the recovered one, or None to keep it.
        black_faces: (F,) bool, faces rendered with base colour 0 and roughness 1, or None.
        lights: lights added.
        spheres: objects added.
        outside_scale: factor on the light from outside the mesh.
    """

    face_emission: NDArray[np.float64] | None = None
    black_faces: NDArray[np.bool_] | None = None
    lights: tuple[Quad, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    outside_scale: float = 1.0
