"""The first solve for light, with every surface rough.

:func:`pose_problem` makes the problem from the photos. :func:`find_first_lights` solves it and fixes, for the rest of
the solve, the regions of one material, the kind of light from outside, and the exponent of the response. Rounds of
lamps and gloss (:mod:`.rounds`) start from there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.progress import Progress
from ..brdf.diffuse import grazing_gain, schlick
from ..config import SolveConfig
from ..decide import Decisions
from ..lighting.backdrop import SeenBackdrop, fit_backdrop
from ..lighting.brightness import Cells
from ..lighting.candidates import read_given_emitters
from ..lighting.hidden import HiddenSources, OutsideKind, through_holes
from ..lighting.lamp_radiance import PatchFit
from ..lighting.problem import LightProblem, Lights
from ..lighting.profiled_lamps import with_profiles
from ..lighting.screens import Shown
from ..lighting.search import choose_exponent, choose_outside
from ..lighting.sun import Sun
from ..lighting.sun_choice import choose_sun
from ..response.observations import Observations
from ..response.photometry import Photometry, shown_pixels
from ..response.radiance import group_radiance
from ..surface.traced_room import TracedRoom
from ..transport.transport import Transport
from .gloss import GLOSS_LEVELS, rough_everywhere
from .rounds import MaterialProblem
from .view_dependence import choose_diffuse, mirrored_radiance

Pose = Callable[[Photometry], MaterialProblem]
"""The problem under a photometry: :func:`pose_problem` with its other arguments bound."""


def pose_problem(
    room: TracedRoom,
    transport: Transport,
    hidden: HiddenSources,
    observations: Observations,
    config: SolveConfig,
    decisions: Decisions,
    photometry: Photometry,
) -> MaterialProblem:
    """The problem of light and materials under ``photometry``, with all surfaces rough.

    Args:
        hidden: sources that no photo shows, without light through holes.

    Raises:
        BadInput: no pixel of any photo is unclipped in all channels, or the file of lamps cannot be used.
    """
    linear = photometry.linearise_observations(observations)
    if not linear.unclipped.all(1).any():
        raise BadInput("every pixel of the photos is clipped in one channel or another", "add darker photos")
    photos, regions, n_patches = room.photos, room.regions.of_face, len(room.patches.region)
    angle = schlick(room.samples.cosine[observations.sample].astype(np.float64))
    diffuse = choose_diffuse(observations, linear, angle, decisions)
    backdrop = SeenBackdrop(None)
    if not decisions.forbids("hidden_light"):
        capture = room.capture
        backdrop = fit_backdrop(photos.backdrop, photometry, capture.mesh, capture.views)
    rough = rough_everywhere(room.n_regions)
    emitters_file = config.emitters
    cells = Cells.on_scans(photos, photometry, room.patches.sample_patch, observations, room.regions.scanned)
    light = LightProblem(
        tracer=room.tracer,
        samples=room.samples,
        surface=room.patches,
        transport=transport.with_lobes(grazing_gain(diffuse.lobe, rough.roughness)[transport.region]),
        regions=regions,
        material=np.arange(room.n_regions, dtype=np.int32),
        adjacency=room.adjacency,
        cells=cells,
        brightness=cells.brightness(observations, linear),
        scanned=room.regions.scanned,
        mixed=room.mixed,
        hidden=replace(hidden, holes=through_holes(transport, backdrop)),
        field=room.field,
        shadow_rays=config.shadow_rays,
        seed=config.seed,
        decisions=decisions,
        given_emitters=read_given_emitters(emitters_file, room.tracer.areas)
        if isinstance(emitters_file, Path)
        else None,
    )
    view_factor = 1 + grazing_gain(diffuse.lobe, np.array(GLOSS_LEVELS[-1])) * angle
    observed = group_radiance(linear, observations.patch, observations.count, n_patches, view_factor=view_factor)
    return MaterialProblem(
        light=light,
        observations=observations,
        linear=linear,
        mirrored=mirrored_radiance(observations, linear, observed, photos, photometry),
        observed=observed,
        region=regions[room.samples.face[observations.sample]],
        schlick=angle,
        diffuse=diffuse,
        specular_rays=config.specular_rays,
        seed=config.seed,
        backdrop=backdrop,
        in_file=room.regions.in_file,
        scanned=room.regions.scans,
    )


@dataclass(frozen=True)
class FirstLights:
    """The result of the first solve for light.

    Attributes:
        lights: the lamps and the light from outside.
        material: (n_regions,) label that regions of a scan share if they are one material under that light.
        outside: how light from outside the mesh is modelled.
        exponent: exponent of equation (16) where exposures leave it undetermined, else 1.
        sun: the sun where it shines into the room.
    """

    lights: Lights
    material: NDArray[np.int32]
    outside: OutsideKind
    exponent: float
    sun: Sun | None = None

    def settle(self, problem: MaterialProblem) -> MaterialProblem:
        """``problem`` with regions of one material joined and the chosen kind of light from outside."""
        settled = problem.with_materials(self.material).with_outside(self.outside, self.sun)
        return replace(settled, light=replace(settled.light, clipped_counts=not self.lights.emitters))

    def arrays(self) -> dict[str, NDArray]:
        """Plain arrays for a checkpoint."""
        return {
            **self.lights.arrays(),
            "outside": np.array(self.outside),
            "exponent": np.array(self.exponent),
            "material": self.material,
            **({} if self.sun is None else self.sun.arrays()),
        }

    @staticmethod
    def from_arrays(arrays: dict[str, NDArray]) -> FirstLights:
        """Inverse of :meth:`arrays`."""
        return FirstLights(
            lights=Lights.from_arrays(arrays),
            material=arrays["material"],
            outside=OutsideKind(int(arrays["outside"][0]), *(bool(flag) for flag in arrays["outside"][1:])),
            exponent=float(arrays["exponent"]),
            sun=Sun.from_arrays(arrays),
        )


def find_first_lights(
    pose: Pose,
    problem: MaterialProblem,
    photometry: Photometry,
    room: TracedRoom,
    progress: Progress,
) -> FirstLights:
    """The lamps, the regions of a scan that are one material under their light, and the exponent.

    Args:
        pose: makes the problem under another photometry.
        problem: the problem under ``photometry``.
    """
    exponent = 1.0
    pixels = shown_pixels(photometry, room)
    with_or_without_sun, light, lights = choose_sun(problem.light, problem.observed, pixels, progress)
    problem = replace(problem, light=with_or_without_sun)
    material = problem.materials_under(lights, room.regions.scanned, room.surface.pieces)
    if (material != problem.light.material).any():
        problem = problem.with_materials(material)
        light, lights = choose_outside(problem.light, problem.observed, progress, lights)
    if photometry.exponent_unconstrained and not problem.light.decisions.forbids("exponent"):
        exponent = choose_exponent(light, problem.observed, lights, photometry.exponent_error, progress)
    if exponent != 1.0:
        sun, aimed = problem.light.hidden.sun, problem.light.aimed
        problem = pose(photometry.raised(exponent)).with_materials(material)
        hidden = replace(problem.light.hidden, sun=sun)
        problem = replace(problem, light=replace(problem.light, hidden=hidden, aimed=aimed))
        light, lights = choose_outside(problem.light, problem.observed, progress)
    specular = np.zeros(problem.linear.radiance.shape, np.float32)
    shown = Shown(problem.observations, problem.linear, specular)
    lights = with_profiles(light, problem.observed, lights, shown, PatchFit(), progress)
    return FirstLights(
        lights=lights,
        material=material,
        outside=light.hidden.kind,
        exponent=exponent,
        sun=light.hidden.sun,
    )
