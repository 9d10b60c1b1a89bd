"""Changes to a solved room before it is rendered: lights off, scaled or added, objects put in.

Plain data, no bpy: written by the readers of lights.json and objects.json, carried out by ``iris_addon.blender``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

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
class ObjectFile:
    """Objects of a .blend, .glb or .obj file put into the room, standing upright along the room's up vector.

    Attributes:
        location: metres, capture axes, of the file's origin.
        scale: factor per axis of the file.
        rotation: XYZ Euler angles in degrees about the file's axes, +Z being up.
    """

    file: Path
    location: tuple[float, float, float]
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class SceneEdit:
    """What differs from the room as solved.

    Attributes:
        face_emission: (F, 3) radiance per face in place of the recovered one, or None to keep it.
        black_faces: (F,) bool, faces rendered with base colour 0 and roughness 1, or None.
        lights: lights added.
        spheres: balls added.
        objects: objects from files added.
        outside_scale: factor on the light from outside the mesh.
    """

    face_emission: NDArray[np.float64] | None = None
    black_faces: NDArray[np.bool_] | None = None
    lights: tuple[Quad, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    objects: tuple[ObjectFile, ...] = ()
    outside_scale: float = 1.0

    @property
    def changes_nothing(self) -> bool:
        """Whether the room stays as it was solved."""
        added = self.lights or self.spheres or self.objects
        return not added and self.face_emission is None and self.black_faces is None and self.outside_scale == 1.0
