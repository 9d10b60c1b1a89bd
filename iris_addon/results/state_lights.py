"""The light of a solved room, light state by light state: at the pixels of the photos, and as the result keeps it.

A room that was photographed under one light has one state. Each photo is explained by the light of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import filled
from ..base.progress import Progress
from ..base.random_streams import stream
from ..brdf.diffuse import schlick
from ..config import SolveConfig
from ..lighting.common_lamps import common_lamps
from ..lighting.lamp_evidence import columns_of
from ..lighting.problem import LightProblem, Lights
from ..materials.gloss import Gloss
from ..materials.rounds import MaterialProblem
from ..materials.shading import Shading
from ..materials.solution import Solution
from ..materials.specular import pixel_lobes
from ..model.light_states import LightStates
from ..model.recovered import Emitter, LightState, OutsideLight, Sunlight
from ..surface.primary_rays import PixelSamples
from ..surface.traced_room import TracedRoom
from ..textures.painting import PixelLight

UNSEEN_LAMP_CONFIDENCE = 0.2
"""Confidence in a lamp that no photo shows."""


@dataclass(frozen=True)
class StateLight:
    """The light of one state.

    Attributes:
        name: of the state, "" where the capture names none.
        room: with the pixels of its photos.
        rows: which of the n pixels of all photos these are.
        problem: with the lobes of the solution.
        lights: in this state.
        shading: of the seen patches.
    """

    name: str
    room: TracedRoom
    rows: slice | NDArray[np.int64]
    problem: MaterialProblem
    lights: Lights
    shading: Shading

    @property
    def expected(self) -> NDArray[np.float64]:
        """(P, 3) radiance of the seen patches: as photos of this state show it, or inferred where none does."""
        observed, shown = self.problem.observed.radiance, self.problem.light.shown
        return observed if shown.all() else np.where(shown[:, None], observed, self.lights.patch_radiance[: len(shown)])


def state_lights(room: TracedRoom, problems: Sequence[MaterialProblem], solution: Solution) -> list[StateLight]:
    """The light of each state of ``solution``."""
    states, found = LightStates.of(room.capture.views), []
    for k, (problem, lights) in enumerate(zip(problems, solution.lights, strict=True)):
        photos = states.photos(k)
        alone = len(states) == 1
        found.append(
            StateLight(
                name=states.names[k],
                room=room if alone else room.of_photos(photos),
                rows=slice(None) if alone else np.flatnonzero(photos[room.samples.view]),
                problem=problem,
                lights=lights,
                shading=problem.shading(lights),
            )
        )
    return found


def at_all_pixels(states: Sequence[StateLight], values: Sequence[NDArray], n_pixels: int) -> NDArray:
    """(n, ...) values of all pixels from those of each state's, which stand at its ``rows``."""
    if len(states) == 1:
        return values[0]
    whole = np.empty((n_pixels, *values[0].shape[1:]), values[0].dtype)
    for state, own in zip(states, values, strict=True):
        whole[state.rows] = own
    return whole


def light_at_pixels(
    states: Sequence[StateLight], gloss: Gloss, config: SolveConfig, n_pixels: int, progress: Progress
) -> PixelLight:
    """Light at the n pixels of all photos, each under the light of its state."""
    each = [_light_at_own_pixels(state, gloss, config, progress) for state in states]
    return PixelLight(
        irradiance=at_all_pixels(states, [own.irradiance for own in each], n_pixels),
        diffuse=at_all_pixels(states, [own.diffuse for own in each], n_pixels),
        ls0=at_all_pixels(states, [own.ls0 for own in each], n_pixels),
        ls1=at_all_pixels(states, [own.ls1 for own in each], n_pixels),
    )


def _light_at_own_pixels(state: StateLight, gloss: Gloss, config: SolveConfig, progress: Progress) -> PixelLight:
    problem, lights, samples = state.problem.light, state.lights, state.room.samples
    roughness = gloss.roughness[problem.regions[samples.face]]
    irradiance = state.shading.at_pixels(problem, lights)
    ls0, ls1 = pixel_lobes(
        state.problem.scene(lights),
        state.room.photos,
        state.room.cameras,
        roughness,
        irradiance,
        config.specular_rays,
        stream(config.seed, "results.pixel_lobes"),
        progress,
    )
    view_factor = _view_factor(state.shading, problem.surface.sample_patch, roughness, samples)
    return PixelLight(irradiance, irradiance * view_factor[:, None], ls0, ls1)


def _view_factor(
    shading: Shading, patch: NDArray[np.integer], roughness: NDArray[np.floating], samples: PixelSamples
) -> NDArray[np.float32]:
    """(n,) factor of the diffuse lobe towards the camera of each pixel, on ``patch`` (n,) of ``roughness`` (n,)."""

    def factor(rows: slice) -> NDArray[np.floating]:
        angle, toward = schlick(samples.cosine[rows]), samples.direction[rows]
        return shading.view_factor(patch[rows], roughness[rows], angle, toward)

    return filled(np.empty(len(patch), np.float32), factor)


# ---- As the result keeps it -----------------------------------------------------------------------------------------


def recovered_emitters(states: Sequence[StateLight]) -> list[Emitter]:
    """The lamps of all states with their radiance in the first, 0 for those that are off there."""
    problem = states[0].problem.light
    areas, seen = problem.tracer.areas, _seen_faces(states)
    lamps = _lamps(states)
    emitters = []
    for k, faces in enumerate(lamps):
        on = [(state.lights, column) for state in states if (column := _column(state, faces)) >= 0]
        confidence = max(1.0 / (1.0 + float(lights.log_std[column])) for lights, column in on)
        emitters.append(
            Emitter(
                id=k,
                faces=faces,
                radiance=_radiance(states[0], faces),
                area=float(areas[faces].sum()),
                confidence=confidence if seen[faces].any() else UNSEEN_LAMP_CONFIDENCE,
                patterned=any(column in lights.patterned for lights, column in on),
                profile=next((own for lights, _ in on if (own := lights.profile_of(faces)) is not None), None),
            )
        )
    return emitters


def recovered_states(states: Sequence[StateLight]) -> tuple[LightState, ...]:
    """The light of each state; nothing where there is one."""
    if len(states) == 1:
        return ()
    lamps = _lamps(states)
    found = []
    for state in states:
        views = np.unique(state.room.samples.view)
        found.append(
            LightState(
                name=state.name,
                photos=tuple(state.room.capture.views[view].name for view in views),
                radiance=np.array([_radiance(state, faces) for faces in lamps]).reshape(-1, 3),
                outside=recovered_outside(state.problem.light, state.lights),
                sun=recovered_sun(state.problem.light, state.lights),
            )
        )
    return tuple(found)


def recovered_outside(problem: LightProblem, lights: Lights) -> OutsideLight | None:
    """Light from outside in lobes; None without any."""
    sh = problem.hidden.outside_sh(lights.hidden_radiance)
    return None if sh is None else OutsideLight(sh)


def recovered_sun(problem: LightProblem, lights: Lights) -> Sunlight | None:
    """The sun; None where none shines in."""
    sun = problem.hidden.sun
    return None if sun is None else Sunlight(sun.direction, lights.hidden_radiance[-1])


def _lamps(states: Sequence[StateLight]) -> list[NDArray[np.int64]]:
    """The lamps that are on in one state or another."""
    each = [state.lights.emitters for state in states]
    return each[0] if len(each) == 1 else common_lamps(each, states[0].problem.light.tracer.areas)[0]


def _column(state: StateLight, faces: NDArray[np.int64]) -> int:
    """Number of a lamp among those of a state, -1 where it is off."""
    return int(columns_of([faces], state.lights.emitters)[0])


def _radiance(state: StateLight, faces: NDArray[np.int64]) -> NDArray[np.float64]:
    column = _column(state, faces)
    return state.lights.radiance[column] if column >= 0 else np.zeros(3)


def _seen_faces(states: Sequence[StateLight]) -> NDArray[np.bool_]:
    n_faces = len(states[0].problem.light.regions)
    return np.any([state.room.samples.seen_faces(n_faces) for state in states], axis=0)
