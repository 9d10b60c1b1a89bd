"""What a solve gives: textures on the mesh's atlas, emitters, light from outside, the camera response."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from ..capture.correction import CameraCorrection, PoseCorrections
from ..capture.types import Mesh, View
from ..response.curve import Response
from ..response.local_exposure import ALIKE, LocalSettings
from ..transport.diffuse import DiffuseLobe


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


@dataclass(frozen=True)
class Result:
    """A solved room.

    Attributes:
        mesh: as read; ``mesh.uv`` is set and addresses ``textures``.
        parts: (F,) int32 part label per face.
        exposures: per training photo, keyed by view name, (3,) factor with white balance.
        report: the content of report.json.
        local: what the camera did to exposure from place to place; exposures are those of the middle.
        up: unit up vector of the capture.
        backdrop: what cameras see through holes of the mesh; None where it has hardly any.
    """

    mesh: Mesh
    parts: NDArray[np.int32]
    textures: Textures
    emitters: tuple[Emitter, ...]
    outside: OutsideLight | None
    response: Response
    exposures: dict[str, NDArray[np.float64]]
    report: dict[str, Any] = field(default_factory=dict)
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    local: LocalSettings = ALIKE
    backdrop: Backdrop | None = None

    @property
    def diffuse_lobe(self) -> DiffuseLobe:
        """Lobe of the diffuse surfaces, as report.json names it."""
        named = self._model("diffuse").get("lobe")
        return next((lobe for lobe in get_args(DiffuseLobe) if lobe == named), "lambert")

    @property
    def camera_correction(self) -> CameraCorrection | None:
        """What the solve found wrong with all cameras of the capture, as report.json has it; None if nothing."""
        correction = self._model("camera").get("correction")
        return CameraCorrection.from_content(correction) if isinstance(correction, dict) else None

    @property
    def pose_corrections(self) -> PoseCorrections | None:
        """What the solve found wrong with the poses of single photos, as report.json has it; None if nothing."""
        corrections = self._model("camera").get("poses")
        return PoseCorrections.from_content(corrections) if isinstance(corrections, dict) else None

    def with_exposures_times(self, factor: float) -> Result:
        """The same photos explained by exposures times ``factor`` and radiance that is less by it."""
        outside, backdrop = self.outside, self.backdrop
        return replace(
            self,
            emitters=tuple(replace(emitter, radiance=emitter.radiance / factor) for emitter in self.emitters),
            outside=None if outside is None else OutsideLight(outside.sh / factor),
            backdrop=None if backdrop is None else replace(backdrop, picture=backdrop.picture / np.float32(factor)),
            exposures={name: exposure * factor for name, exposure in self.exposures.items()},
        )

    def _model(self, name: str) -> dict[str, Any]:
        """What report.json says of one refinement of the model; empty where it says nothing."""
        model = self.report.get("model")
        chosen = model.get(name) if isinstance(model, dict) else None
        return chosen if isinstance(chosen, dict) else {}

    def as_taken(self, views: Iterable[View]) -> list[View]:
        """Views of the capture, which it gives by the same cameras as its photos, as these cameras were found to be."""
        together, single = self.camera_correction, self.pose_corrections
        taken = [view if together is None else together.view(view) for view in views]
        return taken if single is None else [replace(view, camera=single.camera(view.camera)) for view in taken]

    def face_emission(self) -> NDArray[np.float64]:
        """(F, 3) radiance each face emits."""
        emission = np.zeros((len(self.mesh.faces), 3))
        for emitter in self.emitters:
            emission[emitter.faces] = emitter.radiance
        return emission
