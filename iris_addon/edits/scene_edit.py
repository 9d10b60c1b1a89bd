"""Changes to a solved room before it is rendered: lights off, scaled or added, objects put in.

Plain data without bpy: made by :mod:`iris_addon.edits.jobs`, applied by :mod:`iris_addon.blender`.
Positions are metres in the capture's axes, directions are unit vectors, light is scene-linear Rec.709.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]
Shape = Literal["sphere", "box", "cylinder", "cone", "card"]
Snap = Literal["none", "down", "surface"]

OUTSIDE = "IRIS Outside"
"""Name of the light from outside the mesh, wherever lights are named."""
SUN = "IRIS Sun"
"""Name of the recovered sun, wherever lights are named."""


def lamp_name(emitter_id: int) -> str:
    """Name of a recovered lamp: of its object, its material, its light group."""
    return f"IRIS Lamp {emitter_id:02d}"


# ---- Lights ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Quad:
    """A one-sided rectangular light. Corners (4, 3) metres, ``normal`` (3,) the emitting side, radiance (3,) linear."""

    corners: NDArray[np.float64]
    normal: NDArray[np.float64]
    radiance: NDArray[np.float64]


@dataclass(frozen=True)
class PointLight:
    """A ball of ``radius`` that sends ``intensity`` (3,), power per steradian, to every side."""

    position: NDArray[np.float64]
    intensity: NDArray[np.float64]
    radius: float = 0.05


@dataclass(frozen=True)
class SpotLight:
    """A point light shut in a cone.

    Attributes:
        direction: (3,) unit, where it shines.
        angle: full opening angle in degrees.
        blend: share of the cone over which its edge fades.
    """

    position: NDArray[np.float64]
    direction: NDArray[np.float64]
    intensity: NDArray[np.float64]
    angle: float = 45.0
    blend: float = 0.15
    radius: float = 0.02


@dataclass(frozen=True)
class SunLight:
    """Parallel light along ``direction`` (3,) that gives ``irradiance`` (3,) on a surface that faces it.

    Attributes:
        angle: degrees that its disc subtends; 0.53 for the sun.
    """

    direction: NDArray[np.float64]
    irradiance: NDArray[np.float64]
    angle: float = 0.53


@dataclass(frozen=True)
class Panorama:
    """An equirectangular picture of radiance at infinity, its top along the room's up vector.

    Attributes:
        scale: factor on its radiance.
        rotation: degrees about the up vector.
    """

    file: Path
    scale: float = 1.0
    rotation: float = 0.0


Light = Quad | PointLight | SpotLight | SunLight

# ---- Objects --------------------------------------------------------------------------------------------------------


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
class Material:
    """A Principled material of one value each; its values mean what they mean for the room.

    Attributes:
        emission: (3,) radiance beside what it reflects.
    """

    base_color: Vector = (0.8, 0.8, 0.8)
    roughness: float = 0.5
    metallic: float = 0.0
    specular: float = 0.5
    emission: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Placement:
    """Where something stands, +Z of its own axes being up.

    Attributes:
        location: metres, of the thing's origin; of its lowest point where it is snapped.
        scale: factor per axis.
        rotation: XYZ Euler angles in degrees about the thing's axes.
        height: metres from its lowest to its highest point after rotating; None keeps ``scale`` alone.
        snap: "none" stands upright at ``location``; "down" lets it fall from there onto the room; "surface" puts it on
            the nearest surface of the room, its +Z along that surface's normal.
        ray: (origin, direction) of a line of sight; the first surface along it takes the place of ``location``.
    """

    location: Vector = (0.0, 0.0, 0.0)
    scale: Vector = (1.0, 1.0, 1.0)
    rotation: Vector = (0.0, 0.0, 0.0)
    height: float | None = None
    snap: Snap = "none"
    ray: tuple[Vector, Vector] | None = None


@dataclass(frozen=True)
class Primitive:
    """A simple shape around its origin.

    Attributes:
        size: metres along x, y, z; a card has no thickness and faces +Z.
    """

    shape: Shape
    size: Vector
    placement: Placement
    material: Material = field(default_factory=Material)


@dataclass(frozen=True)
class ObjectFile:
    """Objects of a .blend, .glb, .obj or .usd file.

    Attributes:
        material: in place of the materials in the file, or None to keep those.
    """

    file: Path
    placement: Placement = field(default_factory=Placement)
    material: Material | None = None


# ---- The whole edit -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SceneEdit:
    """What differs from the room as solved.

    Attributes:
        face_emission: (F, 3) radiance per face in place of the recovered one, or None to keep it.
        black_faces: (F,) bool, faces rendered with base colour 0 and roughness 1, or None.
        lights: lights added.
        spheres: balls added.
        objects: shapes and objects from files added; those that emit are lights as well.
        panoramas: light from infinity, added to that from outside the mesh.
        outside_scale: factor on the light from outside the mesh, without the sun's.
        sun: in place of the recovered sun; None for that as it is.
    """

    face_emission: NDArray[np.float64] | None = None
    black_faces: NDArray[np.bool_] | None = None
    lights: tuple[Light, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    objects: tuple[Primitive | ObjectFile, ...] = ()
    panoramas: tuple[Panorama, ...] = ()
    outside_scale: float = 1.0
    sun: SunLight | None = None

    @property
    def changes_nothing(self) -> bool:
        """Whether the room stays as it was solved."""
        added = self.lights or self.spheres or self.objects or self.panoramas
        lit = self.face_emission is None and self.outside_scale == 1.0 and self.sun is None
        return not added and lit and self.black_faces is None
