"""What a solve gives, and what can be asked of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.errors import BadInput
from ..base.untrusted import finite
from ..model.capture import Camera, Mesh, View, in_metres
from ..model.corrections import CameraCorrection, PoseCorrections
from ..model.device import Device, device_of_view
from ..model.local_exposure import UNIFORM, LocalSettings
from ..model.recovered import Backdrop, DiffuseLobe, Emitter, LightState, OutsideLight, Sunlight, Textures
from ..model.response import Response

if TYPE_CHECKING:
    from .maps import MapRenderer, ViewMaps


@dataclass(frozen=True)
class Result:
    """A solved room.

    Lengths are metres, colours and radiance scene-linear Rec.709. A result is not changed in place: methods named
    ``with_…`` return another one that shares the arrays.

    Attributes:
        mesh: as read; ``mesh.uv`` is set and addresses ``textures``.
        regions: (F,) int32 region label per face.
        textures: base colour, roughness, metallic and confidence on one square atlas.
        emitters: the lamps; ``emitter.faces`` refers to ``mesh.faces``.
        outside: light from beyond the mesh, None where there is none.
        response: the camera's curve from exposure (radiance · exposure) to display values in [0, 1].
        exposures: per training photo, keyed by view name, (3,) factor with white balance.
        report: the content of report.json.
        local: what the camera did to exposure from place to place; exposures are those of the middle.
        devices: cameras with another response than that, where several took the photos (:meth:`device_of`).
        up: unit up vector of the capture.
        backdrop: what cameras see through holes of the mesh; None where it has hardly any.
        sun: light of the sun beside that of ``outside``; None where none shines in.
        panes: (k,) faces of panes of glass, which light and cameras pass.
        light_states: the light in each state that the room was photographed in, where there were several; ``emitters``,
            ``outside`` and ``sun`` are those of the first (:meth:`in_state`).
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
    sun: Sunlight | None = None
    devices: tuple[Device, ...] = ()
    panes: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    light_states: tuple[LightState, ...] = ()

    def __repr__(self) -> str:
        size = len(self.textures.base_color)
        lamps = f"{len(self.emitters)} emitter{'' if len(self.emitters) == 1 else 's'}"
        return f"Result({len(self.mesh.faces)} faces, {size}×{size} textures, {lamps}, {len(self.exposures)} photos)"

    def render_maps(self, camera: Camera) -> ViewMaps:
        """Material and emission as ``camera`` sees them: what the first hit of the ray through each pixel centre has.

        No light is simulated. The first call builds a ray tracer, later ones on the same result use it again.

        Returns:
            :class:`~iris_addon.results.maps.ViewMaps` of (H, W, …) float32 arrays, H and W those of the camera; zero
            where a ray leaves the room.

        Example:
            >>> import iris_addon as iris
            >>> result = iris.load_result("out/demo")
            >>> camera = iris.read_capture("assets/demo_room").views[0].camera
            >>> maps = result.render_maps(camera)
            >>> maps.base_color.shape, maps.roughness.shape, maps.emission.shape
            ((240, 320, 3), (240, 320), (240, 320, 3))
        """
        return self._map_renderer.maps(camera)

    @cached_property
    def _map_renderer(self) -> MapRenderer:
        from .maps import MapRenderer

        return MapRenderer(self)

    def device_of(self, view: View) -> Device:
        """The camera that took the photo of ``view``; the first one where that is not known."""
        return device_of_view(Device("", self.response, self.local), self.devices, view)

    def save(self, folder: Path | str) -> None:
        """Write this result as the result folder ``folder``, where ``apply``, ``render`` and Blender's panel find it.

        The folder is made where it is missing. A result that is there is replaced, whole or not at all.

        Raises:
            BadInput: where a folder of the result belongs, there is a link or a file.
            IrisError: the disk is full or the folder not writable. What was in the folder before is untouched.
        """
        from .saving import save_result

        save_result(self, Path(folder))

    def with_emitter(self, number: int, radiance: ArrayLike) -> Result:
        """The same room with another radiance of one lamp.

        Materials, exposures and the light from outside stay; of several light states the first alone remains. Light
        that the lamp sends to other surfaces is simulated by what renders the result; :meth:`render_maps` shows the
        lamp itself.

        Args:
            number: ``id`` of the emitter.
            radiance: scene-linear Rec.709, (3,), or one number for all channels; 0 switches the lamp off.

        Raises:
            ValueError: there is no such emitter, or the radiance is negative or not finite.

        Example:
            >>> import iris_addon as iris
            >>> result = iris.load_result("out/demo")
            >>> evening = result.with_emitter(0, radiance=0.0).with_emitter(1, radiance=(9.0, 6.0, 3.0))
            >>> evening.emitters[1].radiance
            array([9., 6., 3.])
        """
        if number not in [emitter.id for emitter in self.emitters]:
            known = ", ".join(str(emitter.id) for emitter in self.emitters) or "none"
            raise ValueError(f"there is no emitter {number}; known ids: {known}")
        rgb = np.broadcast_to(np.asarray(radiance, dtype=np.float64), 3).copy()
        if not (np.isfinite(rgb).all() and (rgb >= 0).all()):
            raise ValueError(f"a radiance is finite and not negative, got {rgb}")
        changed = (replace(emitter, radiance=rgb) if emitter.id == number else emitter for emitter in self.emitters)
        return replace(self, emitters=tuple(changed), light_states=())

    def in_state(self, name: str | None) -> Result:
        """The same room in the light state ``name``, or None for the first: its lamps and the light from outside.

        A lamp that is off has no radiance, and is a surface like others. Cameras see the backdrop of the first state.

        Raises:
            BadInput: the room was not photographed in that state.

        Example:
            >>> import iris_addon as iris
            >>> result = iris.load_result("out/hotel_room")
            >>> [state.name for state in result.light_states]
            ['evening', 'bedside']
            >>> bedside = result.in_state("bedside")
        """
        if name is None and not self.light_states:
            return self
        state = next((state for state in self.light_states if name in (None, state.name)), None)
        if state is None:
            known = ", ".join(state.name for state in self.light_states)
            fix = f"name one of its states: {known}" if known else "it was photographed in one light state only"
            raise BadInput(f"the room has no light state {name!r}", fix)
        lamps = zip(self.emitters, state.radiance, strict=True)
        emitters = tuple(replace(emitter, radiance=radiance) for emitter, radiance in lamps)
        return replace(self, emitters=emitters, outside=state.outside, sun=state.sun, light_states=())

    def in_state_of(self, view: View) -> Result | None:
        """The room as the photo of ``view`` was taken; None where its light state is none of those solved."""
        if not self.light_states:
            return self
        named = {state.name: state for state in self.light_states}
        return self.in_state(view.light_state) if view.light_state in named else None

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
        outside, backdrop, sun = self.outside, self.backdrop, self.sun
        return replace(
            self,
            emitters=tuple(replace(emitter, radiance=emitter.radiance / factor) for emitter in self.emitters),
            outside=None if outside is None else OutsideLight(outside.sh / factor),
            sun=None if sun is None else replace(sun, irradiance=sun.irradiance / factor),
            backdrop=None if backdrop is None else replace(backdrop, picture=backdrop.picture / np.float32(factor)),
            light_states=tuple(state.with_radiance_over(factor) for state in self.light_states),
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
        scale = finite(self.report.get("metres_per_unit", 1.0))
        if scale is not None and scale > 0 and scale != 1:
            views = [in_metres(view, float(scale)) for view in views]
        taken = [view if together is None else together.view(view) for view in views]
        return taken if single is None else [replace(view, camera=single.camera(view.camera)) for view in taken]

    @property
    def switched_faces(self) -> NDArray[np.bool_]:
        """(F,) faces of lamps that are off in the first light state and on in another."""
        faces = np.zeros(len(self.mesh.faces), bool)
        if self.light_states:
            on = np.any([state.radiance.max(1) > 0 for state in self.light_states], axis=0)
            for emitter, switched in zip(self.emitters, on, strict=True):
                faces[emitter.faces] = switched and not emitter.radiance.any()
        return faces

    def face_emission(self) -> NDArray[np.float64]:
        """(F, 3) radiance each face emits."""
        emission = np.zeros((len(self.mesh.faces), 3))
        for emitter in self.emitters:
            emission[emitter.faces] = emitter.radiance
        return emission
