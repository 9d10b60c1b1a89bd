"""What a solve gives."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from ..model.capture import Mesh, View
from ..model.corrections import CameraCorrection, PoseCorrections
from ..model.local_exposure import UNIFORM, LocalSettings
from ..model.recovered import Backdrop, DiffuseLobe, Emitter, OutsideLight, Textures
from ..model.response import Response


@dataclass(frozen=True)
class Result:
    """A solved room.

    Attributes:
        mesh: as read; ``mesh.uv`` is set and addresses ``textures``.
        regions: (F,) int32 region label per face.
        exposures: per training photo, keyed by view name, (3,) factor with white balance.
        report: the content of report.json.
        local: what the camera did to exposure from place to place; exposures are those of the middle.
        up: unit up vector of the capture.
        backdrop: what cameras see through holes of the mesh; None where it has hardly any.
    """

    mesh: Mesh
    regions: NDArray[np.int32]
    textures: Textures
    emitters: tuple[Emitter, ...]
    outside: OutsideLight | None
    response: Response
    exposures: dict[str, NDArray[np.float64]]
    report: dict[str, Any] = field(default_factory=dict)
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    local: LocalSettings = UNIFORM
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
