"""What a solve recovers of the room: emitters, outside light, sun, backdrop, and textures on the mesh's atlas."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .lamp_profile import LampProfile

DiffuseLobe = Literal["lambert", "layered", "burley"]
"""Layered is Lambert's lobe under a dielectric."""


@dataclass(frozen=True)
class Emitter:
    """One light: a set of faces that share a radiance.

    Attributes:
        faces: (n,) int64 indices into the mesh's faces.
        radiance: (3,) float64, scene-linear Rec.709, both sides emit.
        area: square metres.
        confidence: 0 (guess) ... 1 (its light explains the shading of much of what photos show).
        patterned: whether :attr:`Textures.lamp_pattern` says how its places differ; ``radiance`` is then their mean.
        profile: by angle; ``radiance`` is then that of an even lamp of the same flux. None where alike.
    """

    id: int
    faces: NDArray[np.int64]
    radiance: NDArray[np.float64]
    area: float
    confidence: float
    patterned: bool = False
    profile: LampProfile | None = None


@dataclass(frozen=True)
class OutsideLight:
    """Radiance that arrives from outside the mesh, real spherical harmonics up to order 2.

    Attributes:
        sh: (n, 3) float64 coefficients, n in {1, 4, 9}, basis order (l, m) = (0,0), (1,-1), (1,0), (1,1), (2,-2) ...
            in the capture's world axes; evaluated radiance is clamped at zero.
    """

    sh: NDArray[np.float64]

    @property
    def mean(self) -> NDArray[np.float64]:
        """(3,) radiance in the mean over all directions."""
        return self.sh[0] / (2 * np.sqrt(np.pi))


@dataclass(frozen=True)
class Sunlight:
    """Parallel light from the sun, which comes in through the openings of the mesh.

    Attributes:
        direction: (3,) unit vector towards the sun, in the capture's world axes.
        irradiance: (3,) float64 on a surface that faces it, scene-linear Rec.709, in the unit of radiance times sr.
    """

    direction: NDArray[np.float64]
    irradiance: NDArray[np.float64]


@dataclass(frozen=True)
class LightState:
    """The light of a room in one of the states that it was photographed in.

    Attributes:
        name: as the capture names it.
        photos: names of the training photos that were taken in it.
        radiance: (E, 3) float64 of the emitters, in their order; 0 for those that are off.
        outside: as of the result.
        sun: as of the result.
    """

    name: str
    photos: tuple[str, ...]
    radiance: NDArray[np.float64]
    outside: OutsideLight | None = None
    sun: Sunlight | None = None

    def with_radiance_over(self, factor: float) -> LightState:
        """The same state with all light divided by ``factor``."""
        outside, sun = self.outside, self.sun
        return replace(
            self,
            radiance=self.radiance / factor,
            outside=None if outside is None else OutsideLight(outside.sh / factor),
            sun=None if sun is None else replace(sun, irradiance=sun.irradiance / factor),
        )


@dataclass(frozen=True)
class Backdrop:
    """What cameras see through holes of the mesh: a convex shell around the room with a picture on its inner side.

    It stands for surfaces that a scan missed. Where such surfaces explain the light that comes through the holes, the
    backdrop has an albedo and is lit by the room. Elsewhere only cameras and reflections see it; it sends no light to
    diffuse surfaces.

    Attributes:
        vertices: (V, 3) float64 of the shell, metres, in the capture's world space.
        faces: (F, 3) int64, counter-clockwise from within.
        picture: (H, 2 H, 3) float32 linear radiance that does not depend on the lamps, equirectangular around
            :attr:`centre` with +z on top.
        albedo: (H, 2 H, 3) float32 linear, zero where there is no surface and one looks outside; None for a shell that
            sends no light.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    picture: NDArray[np.float32]
    albedo: NDArray[np.float32] | None = None

    @property
    def centre(self) -> NDArray[np.float64]:
        """(3,) metres, the point from which the picture is seen."""
        return self.vertices.mean(0)


@dataclass(frozen=True)
class Textures:
    """Principled BSDF maps on one square atlas; row 0 of an array is the top of the image (v = 1).

    Attributes:
        base_color: (N, N, 3) float32 scene-linear Rec.709.
        roughness: (N, N) float32, the Principled parameter (alpha = roughness squared).
        metallic: (N, N) float32.
        confidence: (N, N) float32, 0 where filled in, 1 where many photos agree.
        coverage: (N, N) float32, confidence averaged over the surface; None in results that do not have it.
        lamp_pattern: (N, N, 3) float32 radiance of lamps over the mean of each, 1 elsewhere; None without a pattern.
    """

    base_color: NDArray[np.float32]
    roughness: NDArray[np.float32]
    metallic: NDArray[np.float32]
    confidence: NDArray[np.float32]
    coverage: NDArray[np.float32] | None = None
    lamp_pattern: NDArray[np.float32] | None = None
