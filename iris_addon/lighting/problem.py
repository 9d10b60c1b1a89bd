"""The lighting problem and its solution."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..decide import Decisions, HeldOutLosses
from ..model.lamp_profile import EVEN_PROFILE, LampProfile
from ..rays.tracer import Tracer
from ..surface.irradiance import IrradianceField
from ..surface.mixed_pixels import MixedPixels
from ..surface.patches import Surface
from ..surface.primary_rays import PixelSamples
from ..transport.aimed_rays import SparseRays, aim_at_bright
from ..transport.transport import Transport
from .balance import ROBUST_LOG
from .brightness import Brightness, Cells
from .hidden import HiddenSources
from .lamp_pattern import LampPattern


@dataclass(frozen=True)
class Lights:
    """Emitters and the light they cast.

    Attributes:
        emitters: faces of each.
        radiance: (E, 3) of the emitters, scene-linear Rec.709.
        hidden_radiance: (H, 3) of the lobes of outside light, and in the last row the irradiance of the sun if the
            problem has one.
        log_std: (E,) standard deviation of log radiance.
        form_factors: (N, E, 2) ``B`` of equation (8) for all patches, seen and unseen, plain and times Schlick's S.
        mask: (F,) bool, faces that emit.
        irradiance: (N, 3) irradiance / pi of every patch, all light.
        patch_radiance: (N, 3) reflected radiance of every patch, observed or inferred.
        region_albedo: (3,) albedo per region id, from the balance.
        held_out: robust loss of the balance on patches it was not fitted to.
        losses: of each of these patches; not part of a checkpoint, because no later stage compares with it.
        patterned: (k,) numbers of the emitters that have a pattern, of which ``radiance`` is the mean.
        lamp_share: (N,) luminance of each patch on one of these over the mean, 1 elsewhere; None without any.
        profiles: (E, 6) radiance of each emitter at PROFILE_DEGREES over ``radiance``; None where all are even.
        apart: (E,) bool, emitters that are copies of one model and have a radiance of their own; None without any.
    """

    emitters: list[NDArray[np.int64]]
    radiance: NDArray[np.float64]
    hidden_radiance: NDArray[np.float64]
    log_std: NDArray[np.float64]
    form_factors: NDArray[np.float32]
    mask: NDArray[np.bool_]
    irradiance: NDArray[np.floating]
    patch_radiance: NDArray[np.float64]
    region_albedo: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    held_out: float = np.inf
    losses: HeldOutLosses = field(default_factory=HeldOutLosses.none)
    patterned: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    lamp_share: NDArray[np.float32] | None = None
    profiles: NDArray[np.float64] | None = None
    apart: NDArray[np.bool_] | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user."""
        if self.emitters or self.hidden_radiance.any():
            return ()
        return ("no light was found, so the room renders black: add photos that show a lamp or a window",)

    def arrays(self) -> dict[str, NDArray]:
        """Plain arrays for a checkpoint."""
        of_lamps = ("radiance", "hidden_radiance", "log_std", "form_factors", "mask", "patterned")
        names = *of_lamps, "irradiance", "patch_radiance"
        ids = np.array(list(self.region_albedo), np.int64)
        return {
            "lights.held_out": np.array(self.held_out),
            **{f"lights.{name}": getattr(self, name) for name in names},
            **({} if self.lamp_share is None else {"lights.lamp_share": self.lamp_share}),
            **({} if self.profiles is None else {"lights.profiles": self.profiles}),
            **({} if self.apart is None else {"lights.apart": self.apart}),
            "lights.sizes": np.array([len(faces) for faces in self.emitters], np.int64),
            "lights.faces": np.concatenate([*self.emitters, np.zeros(0, np.int64)]),
            "lights.region_ids": ids,
            "lights.region_albedo": np.array(list(self.region_albedo.values())).reshape(len(ids), 3),
        }

    @staticmethod
    def from_arrays(arrays: dict[str, NDArray]) -> Lights:
        """Inverse of :meth:`arrays`."""
        a = {name.removeprefix("lights."): value for name, value in arrays.items() if name.startswith("lights.")}
        emitters = np.split(a.pop("faces"), np.cumsum(a.pop("sizes")))[:-1]
        albedo = dict(zip(a.pop("region_ids").tolist(), a.pop("region_albedo"), strict=True))
        held_out = float(a.pop("held_out"))
        return Lights(emitters=emitters, region_albedo=albedo, held_out=held_out, **a)  # type: ignore[arg-type]

    def profile_of(self, faces: NDArray[np.int64]) -> LampProfile | None:
        """The profile of the lamp of ``faces``, None where it is even or no lamp of these."""
        if self.profiles is None:
            return None
        for own, values in zip(self.emitters, self.profiles, strict=True):
            if np.array_equal(own, faces):
                return None if (values == 1).all() else LampProfile(values)
        return None

    def profiles_of(self, emitters: list[NDArray[np.int64]]) -> NDArray[np.float64] | None:
        """(E, 6) the profiles of ``emitters``, as far as they are known; None where all are even."""
        found = [self.profile_of(faces) for faces in emitters]
        if not any(found):
            return None
        return np.stack([EVEN_PROFILE if each is None else each.values for each in found])

    @property
    def emitters_apart(self) -> list[NDArray[np.int64]]:
        """Faces of each emitter that is told apart from its copies."""
        return [] if self.apart is None else [self.emitters[k] for k in np.flatnonzero(self.apart)]

    def apart_of(self, emitters: list[NDArray[np.int64]]) -> NDArray[np.bool_] | None:
        """(E,) bool, which of ``emitters`` are told apart from their copies here; None where none is."""
        found = _overlapping(emitters, self.emitters_apart)
        return found if found.any() else None

    def told_apart(self, emitters: Iterable[NDArray[np.int64]]) -> Lights:
        """The same lights, with those of ``emitters`` that are among them told apart from their copies as well."""
        more = _overlapping(self.emitters, emitters)
        return replace(self, apart=more if self.apart is None else self.apart | more) if more.any() else self

    @property
    def profiled(self) -> list[tuple[NDArray[np.int64], LampProfile]]:
        """Faces and profile of each lamp that has one."""
        return [(faces, profile) for faces in self.emitters if (profile := self.profile_of(faces)) is not None]

    def paired_error(self, larger: Lights) -> float:
        """Standard error of the difference in held-out loss to the light under a larger model."""
        return self.losses.paired_error(larger.losses)

    def with_radiance(self, numbers: NDArray[np.integer], radiance: Sequence[NDArray[np.float64]]) -> Lights:
        """The same lamps, those of ``numbers`` with another ``radiance`` (3,) each."""
        changed = self.radiance.copy()
        changed[numbers] = radiance
        return replace(self, radiance=changed)

    def face_emission(self, n_faces: int) -> NDArray[np.float64]:
        """(F, 3) radiance each face emits."""
        emission = np.zeros((n_faces, 3))
        for faces, radiance in zip(self.emitters, self.radiance, strict=True):
            emission[faces] = radiance
        return emission


def _overlapping(emitters: Iterable[NDArray[np.int64]], others: Iterable[NDArray[np.int64]]) -> NDArray[np.bool_]:
    """(E,) bool, which of ``emitters`` share a face with ``others``: found anew, a lamp has some faces more or less."""
    faces = np.concatenate([*others, np.zeros(0, np.int64)])
    return np.array([np.isin(own, faces).any() for own in emitters], bool)


@dataclass(frozen=True)
class LightProblem:
    """What stays fixed while lamps are searched for.

    Attributes:
        tracer: the mesh.
        samples: the pixels.
        surface: the seen patches.
        transport: gather rays between patches.
        regions: (F,) region of each face.
        material: (n_regions,) label that regions of one material share; patches carry it as their region.
        adjacency: pairs of faces that share an edge.
        cells: where brightness is collected: seen patches, and bright faces of scans.
        brightness: brightness of each cell.
        scanned: (F,) bool, faces of scans.
        mixed: which of the n pixels show more than one surface.
        hidden: sources that no photo shows.
        field: neighbourhoods of the seen patches.
        shadow_rays: from a patch to all lamps together.
        decisions: where refinements of the light are decided.
        bounce: once materials are known, the light that glossy surfaces pass on; patches then cast their diffuse light
            alone.
        aimed: rays to bright patches, once the light is about known; None where there are none.
        given_emitters: faces of each lamp where the configuration names the lamps, None to search for them.
        robust_log: deviation of log albedo at which a patch starts to count as an outlier.
        clipped_counts: whether patches that clip in all photos bound the light from below. Only in a room without
            lamps: beside a lamp they are its glare, and light that differs most within a patch.
        sunlight_passed_on: whether the sun's column holds what patches pass on that no photo measures, beside what the
            sun lights. Not while a sun is but proposed: with all that for its own, many a direction explains a lamp.
        patterns: of the lamps that have one, once it is known.
        asked: faces of the lamps that are just asked for a profile. With and without one, only the light that they cast
            tells their radiance, so that what a profile earns is not the freedom of it.
    """

    tracer: Tracer
    samples: PixelSamples
    surface: Surface
    transport: Transport
    regions: NDArray[np.int32]
    material: NDArray[np.int32]
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]]
    cells: Cells
    brightness: Brightness
    scanned: NDArray[np.bool_]
    mixed: MixedPixels
    hidden: HiddenSources
    field: IrradianceField
    shadow_rays: int
    seed: int
    decisions: Decisions
    bounce: Bounce | None = None
    aimed: SparseRays | None = None
    given_emitters: list[NDArray[np.int64]] | None = None
    robust_log: float = ROBUST_LOG
    clipped_counts: bool = False
    sunlight_passed_on: bool = True
    patterns: tuple[LampPattern, ...] = ()
    asked: tuple[NDArray[np.int64], ...] = ()

    @cached_property
    def shown(self) -> NDArray[np.bool_]:
        """(P,) seen patches that photos of this light state show; what others cast here is inferred."""
        return self.surface.count > 0

    @cached_property
    def inner_cells(self) -> NDArray[np.bool_]:
        """(C,) cells of which most pixels are off all edges."""
        of_pixel = self.cells.of_pixel
        return 2 * np.bincount(of_pixel, self.mixed.inner, self.cells.n_cells) > self.cells.count

    def asked_for_profile(self, faces: NDArray[np.int64]) -> bool:
        """Whether the lamp of ``faces`` is asked for a profile."""
        return any(np.array_equal(each, faces) for each in self.asked)

    def pattern_of(self, faces: NDArray[np.int64]) -> LampPattern | None:
        """The pattern of the lamp of ``faces``, None where it has none."""
        return next((pattern for pattern in self.patterns if np.array_equal(pattern.faces, faces)), None)

    def rays_to_bright(self, lights: Lights, rng: np.random.Generator) -> SparseRays | None:
        """Rays aimed at patches that are bright under ``lights``; None where there are none."""
        light = lights.patch_radiance, lights.irradiance, lights.mask
        return aim_at_bright(self.tracer, self.transport, self.regions, *light, rng)


class Bounce(Protocol):
    """Light by way of glossy surfaces, see :mod:`iris_addon.transport.glossy_bounce`."""

    def gather_radiance(
        self, radiance: NDArray[np.floating], unknown: NDArray[np.floating], emitter_faces: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """(N, 3) irradiance / pi from other patches."""
        ...

    def form_factors(self, emitters: Sequence[NDArray[np.integer]], n_faces: int) -> NDArray[np.float32]:
        """(N, E) share of each emitter's radiance."""
        ...
