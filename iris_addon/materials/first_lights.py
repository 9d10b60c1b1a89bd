"""The first solve for light, with every surface rough.

:func:`pose_states` makes the problem of each light state from its photos; where photos name no states there is one.
:func:`find_first_lights` solves them and fixes, for the rest of the solve, the regions of one material, the kind of
light from outside, and the exponent of the response. Rounds of lamps and gloss (:mod:`.rounds`) start from there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from ..lighting.common_lamps import solve_states
from ..lighting.hidden import HiddenSources, OutsideKind, through_holes
from ..lighting.lamp_radiance import LitState, PatchFit
from ..lighting.problem import LightProblem, Lights
from ..lighting.profiled_lamps import with_profiles
from ..lighting.screens import Shown
from ..lighting.search import choose_exponent, choose_outside
from ..lighting.sun import Sun
from ..lighting.sun_choice import choose_sun
from ..model.light_states import LightStates
from ..response.observations import Observations
from ..response.photometry import Photometry, shown_pixels
from ..response.radiance import group_radiance
from ..surface.traced_room import TracedRoom
from ..transport.transport import Transport
from .gloss import GLOSS_LEVELS, rough_everywhere
from .rounds import MaterialProblem
from .view_dependence import DiffuseChoice, choose_diffuse, mirrored_radiance

Pose = Callable[[Photometry], list[MaterialProblem]]
"""The problem of each light state under a photometry: :func:`pose_states` with its other arguments bound."""


@dataclass(frozen=True)
class RoomInState:
    """A room as the photos of one light state show it.

    Attributes:
        name: of the state, "" where photos name none.
        room: with the pixels of these photos.
        observations: of these photos.
        hidden: sources that none of them shows, without light through holes.
    """

    name: str
    room: TracedRoom
    observations: Observations
    hidden: HiddenSources

    @staticmethod
    def of(
        room: TracedRoom,
        observations: Observations,
        states: LightStates,
        state: int,
        find_hidden: Callable[[TracedRoom], HiddenSources],
    ) -> RoomInState:
        """The room in one of the ``states`` of its photos, of which ``room`` and ``observations`` have all."""
        if len(states) > 1:
            photos = states.photos(state)
            room, observations = room.of_photos(photos), observations.of_photos(photos)
        return RoomInState(states.names[state], room, observations, find_hidden(room))


def pose_states(
    states: Sequence[RoomInState],
    room: TracedRoom,
    observations: Observations,
    transport: Transport,
    config: SolveConfig,
    decisions: Decisions,
    photometry: Photometry,
) -> list[MaterialProblem]:
    """The problem of light and materials in each light state under ``photometry``, with all surfaces rough.

    Args:
        room, observations: with all photos.

    Raises:
        BadInput: no pixel of any photo of a state is unclipped in all channels, or the file of lamps cannot be used.
    """
    comparable = observations.apart(LightStates.of(room.capture.views))
    linear = photometry.linearise_observations(comparable)
    angle = schlick(room.samples.cosine[observations.sample].astype(np.float64))
    diffuse = choose_diffuse(comparable, linear, angle, decisions)
    return [_posed(state, transport, config, decisions, photometry, diffuse) for state in states]


def _posed(
    state: RoomInState,
    transport: Transport,
    config: SolveConfig,
    decisions: Decisions,
    photometry: Photometry,
    diffuse: DiffuseChoice,
) -> MaterialProblem:
    room, observations = state.room, state.observations
    linear = photometry.linearise_observations(observations)
    if not linear.unclipped.all(1).any():
        of_state = f" of light state {state.name!r}" if state.name else ""
        raise BadInput(f"every pixel of the photos{of_state} is clipped in one channel or another", "add darker photos")
    photos, regions, n_patches = room.photos, room.regions.of_face, len(room.patches.region)
    angle = schlick(room.samples.cosine[observations.sample].astype(np.float64))
    backdrop = SeenBackdrop(None)
    if not decisions.forbids("hidden_light"):
        capture = room.capture
        backdrop = fit_backdrop(photos.backdrop, photometry, capture.mesh, capture.views)
    rough = rough_everywhere(room.n_regions)
    emitters_file = config.emitters
    sample_patch, scanned = room.patches.sample_patch, room.regions.scanned
    cells = Cells.on_scans(photos, photometry, sample_patch, n_patches, observations, scanned)
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
        scanned=scanned,
        mixed=room.mixed,
        hidden=replace(state.hidden, holes=through_holes(transport, backdrop)),
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
    problems: Sequence[MaterialProblem],
    photometry: Photometry,
    rooms: Sequence[TracedRoom],
    progress: Progress,
) -> list[FirstLights]:
    """The lamps of each light state, the regions of a scan that are one material under the light of the first, and the
    exponent.

    Args:
        pose: makes the problems under another photometry.
        problems: the problem of each state under ``photometry``.
        rooms: as the photos of each state show it.
    """
    exponent, decisions = 1.0, problems[0].light.decisions
    found = [
        choose_sun(problem.light, problem.observed, shown_pixels(photometry, room), progress)
        for problem, room in zip(problems, rooms, strict=True)
    ]
    problems = [replace(problem, light=own[0]) for problem, own in zip(problems, found, strict=True)]
    chosen = [(light, lights) for _, light, lights in found]
    material = problems[0].materials_under(chosen[0][1], rooms[0].regions.scanned, rooms[0].surface.pieces)
    if (material != problems[0].light.material).any():
        problems = [problem.with_materials(material) for problem in problems]
        chosen = [
            choose_outside(problem.light, problem.observed, progress, lights)
            for problem, (_, lights) in zip(problems, chosen, strict=True)
        ]
    if photometry.exponent_unconstrained and not decisions.forbids("exponent"):
        exponent = choose_exponent(_lit(problems, chosen), photometry.exponent_error, progress)
    if exponent != 1.0:
        before = problems
        problems = [problem.with_materials(material) for problem in pose(photometry.raised(exponent))]
        problems = [_with_sun_of(problem, own.light) for problem, own in zip(problems, before, strict=True)]
        chosen = [choose_outside(problem.light, problem.observed, progress) for problem in problems]
    if len(problems) > 1:
        together = solve_states(_lit(problems, chosen), progress)
        chosen = [(light, lights) for (light, _), lights in zip(chosen, together, strict=True)]
    chosen = [
        (light, _with_profiles(problem, light, lights, progress))
        for problem, (light, lights) in zip(problems, chosen, strict=True)
    ]
    if len(problems) > 1 and any(lights.profiles is not None for _, lights in chosen):
        together = solve_states(_lit(problems, chosen), progress)
        chosen = [(light, lights) for (light, _), lights in zip(chosen, together, strict=True)]
    return [
        FirstLights(
            lights=lights,
            material=material,
            outside=light.hidden.kind,
            exponent=exponent,
            sun=light.hidden.sun,
        )
        for light, lights in chosen
    ]


def _lit(problems: Sequence[MaterialProblem], chosen: Sequence[tuple[LightProblem, Lights]]) -> list[LitState]:
    """Each state with the light that was found in it."""
    return [
        LitState(problem=light, observed=problem.observed, emitters=lights.emitters, before=lights)
        for problem, (light, lights) in zip(problems, chosen, strict=True)
    ]


def _with_sun_of(problem: MaterialProblem, light: LightProblem) -> MaterialProblem:
    """``problem`` with the sun of ``light`` and the rays aimed at what it lights."""
    hidden = replace(problem.light.hidden, sun=light.hidden.sun)
    return replace(problem, light=replace(problem.light, hidden=hidden, aimed=light.aimed))


def _with_profiles(problem: MaterialProblem, light: LightProblem, lights: Lights, progress: Progress) -> Lights:
    specular = np.zeros(problem.linear.radiance.shape, np.float32)
    shown = Shown(problem.observations, problem.linear, specular)
    return with_profiles(light, problem.observed, lights, shown, PatchFit(), progress)
