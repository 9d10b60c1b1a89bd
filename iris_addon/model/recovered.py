"""What a solve gives: textures on the mesh's atlas, emitters, light from outside, the camera response."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

DiffuseLobe = Literal["lambert", "layered", "burley"]
"""Layered is Lambert's under a dielectric."""


@dataclass(frozen=True)
class Emitter:
    """One light: a set of faces that share a radiance.

    Attributes:
        faces: (n,) int64 indices into the mesh's faces.
        radiance: (3,) float64, scene-linear Rec.709, both sides emit.
        area: square metres.
        confidence: 0 (guess) ... 1 (its light explains the shading of much that was seen).
    """

    id: int
    faces: NDArray[np.int64]
    radiance: NDArray[np.float64]
    area: float
    confidence: float


@dataclass(frozen=True)
class OutsideLight:
    """Radiance that arrives from beyond the mesh, real spherical harmonics up to order 2.

    Attributes:
        sh: (n, 3) float64 coefficients, n in {1, 4, 9}, basis order (l, m) = (0,0), (1,-1), (1,0), (1,1), (2,-2) ...
            in the capture's world axes; evaluated radiance is clamped at zero.
    """

    sh: NDArray[np.float64]


@dataclass(frozen=True)
class Backdrop:
    """What cameras see through holes of the mesh: a convex shell around the room with a picture on its inner side.

    It stands for surfaces that a scan missed. Where these explain the light that comes through the holes, it is such a
    surface: it has an albedo and is lit by the room. Else cameras and reflections show it; to diffuse surfaces it is
    not there.

    Attributes:
        vertices: (V, 3) float64 of the shell, metres, in the capture's world space.
        faces: (F, 3) int64, counter-clockwise from within.
        picture: (H, 2 H, 3) float32 radiance that it has whatever the lamps do, equirectangular around :attr:`centre`
            with +z on top.
        albedo: (H, 2 H, 3) float32 of the surface, zero where there is none and one looks outside; None for a shell
            that is only looked at.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    picture: NDArray[np.float32]
    albedo: NDArray[np.float32] | None = None

    @property
    def centre(self) -> NDArray[np.float64]:
        """(3,) from where the picture was painted."""
        return self.vertices.mean(0)


@dataclass(frozen=True)
class Textures:
    """Principled BSDF maps on one square atlas; row 0 of an array is the top of the image (v = 1).

    Attributes:
        base_color: (N, N, 3) float32 scene-linear Rec.709.
        roughness: (N, N) float32, the Principled parameter (alpha = roughness squared).
        metallic: (N, N) float32.
        confidence: (N, N) float32, 0 where filled in, 1 where many photos agree.
    """

    base_color: NDArray[np.float32]
    roughness: NDArray[np.float32]
    metallic: NDArray[np.float32]
    confidence: NDArray[np.float32]
