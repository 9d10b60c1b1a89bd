"""What cameras see of lamps in glossy surfaces, as shares that are linear in the lamps' radiance.

A lamp that clips in every photo is often open in its mirror image, which a dielectric dims to a few per cent. From view
to view only the mirror image moves over a patch, so it says how bright the lamp is without a word about albedo, on
which the light balance rests. Paths, roughness and what else the lobes see are held as they were found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..emission.types import Lights
from ..reflectance.ggx import DIELECTRIC_F0
from ..reflectance.gloss import Gloss
from ..reflectance.lobe_rays import LobeRays
from ..reflectance.lobes import trace_lobes
from ..reflectance.materials import MaterialProblem, scene_of
from ..reflectance.specular import ROUGH
from ..response.radiance import CLIPPED_SHARE
from ..transport.form_factors import emitter_of_face

MAX_PATCHES = 2500
MIN_VIEWS = 4
RAYS = 64
LAMP_OBSERVATIONS = 100
"""Observations of each lamp itself."""
FLAT = 0.04
"""Largest spread of display values of an observation of a lamp; beyond, it is the lamp's edge."""


@dataclass(frozen=True)
class Highlights:
    """m observations, of n glossy patches, then of the lamps: radiance = lobe diffuse[patch] + rest + share e.

    Attributes:
        patch: (m,) int64, 0 … n-1; 0 as well for observations of a lamp, whose ``lobe`` is 0.
        lobe: (m,) factor by which the diffuse lobe differs from Lambert towards the camera.
        view: (m,) int64.
        pixel: (m,) int32 where in its photo, row-major.
        z: (m, 3) mean display value, the half step of the byte added.
        clipped: (m, 3) bool, nearly all its pixels are clipped: z is a lower bound.
        weight: (m,).
        share: (m, E) share of each lamp's radiance that arrives.
        rest: (m, 3) specular radiance of everything else.
        diffuse: (n, 3) first guess of the diffuse radiance.
    """

    patch: NDArray[np.int64]
    lobe: NDArray[np.floating]
    view: NDArray[np.int64]
    pixel: NDArray[np.int32]
    z: NDArray[np.float64]
    clipped: NDArray[np.bool_]
    weight: NDArray[np.float64]
    share: NDArray[np.float64]
    rest: NDArray[np.float64]
    diffuse: NDArray[np.float64]


def trace_highlights(problem: MaterialProblem, lights: Lights, gloss: Gloss, rng: np.random.Generator) -> Highlights:
    """Observations of a sample of glossy dielectric patches, their reflected rays traced, and of the lamps."""
    o = problem.observations
    glossy = _glossy_observations(problem, lights, gloss, rng)
    scene, roughness = scene_of(problem.light, lights), gloss.roughness[problem.part[glossy]]
    rays = trace_lobes(scene, problem.light.samples, o.sample[glossy], roughness, RAYS, rng)
    s0, s1 = scene.lobes(rays)
    share = _lamp_shares(rays, lights)
    patches, patch = np.unique(o.patch[glossy], return_inverse=True)
    lamp, label = _lamp_observations(problem, lights, rng)
    rows = np.concatenate([glossy, lamp])
    none = np.zeros((len(lamp), 3))
    lobe = problem.view_factor(problem.shading(lights), roughness, glossy)
    # Mixed observations, some of whose pixels are clipped, have a mean that no curve maps back: they have no say.
    mixed = (o.saturated[rows] > 0).any(1) & ~(o.saturated[rows] > CLIPPED_SHARE).any(1)
    return Highlights(
        np.concatenate([patch, np.zeros(len(lamp), np.int64)]),
        np.concatenate([lobe, none[:, 0]]),
        o.view[rows].astype(np.int64),
        o.pixel[rows],
        np.minimum(o.z[rows].astype(np.float64) + 0.5 / 255, 1.0),
        o.saturated[rows] > CLIPPED_SHARE,
        np.sqrt(np.minimum(o.count[rows], 25.0)).astype(np.float64) * ~mixed,
        np.concatenate([share, np.eye(len(lights.emitters))[label]]),
        np.concatenate([DIELECTRIC_F0 * s0 + s1 - share @ lights.radiance, none]),
        np.maximum(problem.observed.radiance[patches], 1e-4),
    )


def _glossy_observations(
    problem: MaterialProblem, lights: Lights, gloss: Gloss, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Observations of up to MAX_PATCHES patches of glossy dielectrics that enough photos show."""
    o = problem.observations
    dielectric = (gloss.roughness < ROUGH) & (gloss.metallic < 0.5)
    usable = dielectric[problem.part] & ~lights.mask[problem.light.samples.face[o.sample]]
    n = len(problem.observed.weight)
    patches = np.flatnonzero(np.bincount(o.patch[usable], minlength=n) >= MIN_VIEWS)
    chosen = np.zeros(n, bool)
    chosen[rng.permutation(patches)[:MAX_PATCHES]] = True
    return np.flatnonzero(usable & chosen[o.patch])


def _lamp_shares(rays: LobeRays, lights: Lights) -> NDArray[np.float64]:
    """(m, E) specular share of each lamp: its part of the lobe, 0.04 Ls0 + Ls1."""
    hit = emitter_of_face(lights.emitters, len(lights.mask))[rays.face]
    m, n_lamps = len(hit), len(lights.emitters)
    row, column = np.nonzero(hit >= 0)
    weight = DIELECTRIC_F0 * rays.weight0[row, column].astype(np.float64) + rays.weight1[row, column]
    total = np.bincount(row * n_lamps + hit[row, column], weight, m * n_lamps)
    return total.reshape(m, n_lamps).astype(np.float64, copy=False)


def _lamp_observations(
    problem: MaterialProblem, lights: Lights, rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Observations well inside each lamp, and the lamp of each."""
    o, face = problem.observations, problem.light.samples.face[problem.observations.sample]
    inside = (o.spread.max(1) < FLAT) & (o.count >= 2)
    rows = [rng.permutation(np.flatnonzero(inside & np.isin(face, f)))[:LAMP_OBSERVATIONS] for f in lights.emitters]
    label = np.repeat(np.arange(len(rows)), [len(piece) for piece in rows])
    return np.concatenate([*rows, np.zeros(0, np.int64)]), label
