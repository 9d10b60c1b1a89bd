"""Which of the surfaces that no photo shows may be lamps: a first look, on few patches and with few rays.

A bulb under its shade fills a ten-thousandth of what the room sees, and there are dozens of surfaces like it: hinges,
undersides, the backs of drawers. Rays enough to solve for each would cost more than the rest of the search. But a lamp
that is missing is missed where it shines, by many times what noise does; so all are solved for at once, roughly, and
the few that would bring the most light are then tried with care (:mod:`iris_addon.emission.selection`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..progress import Progress
from ..response.radiance import GroupRadiance
from ..transport.diffuse import under_lobe
from ..transport.gather import GatherRays, Origins, emitter_form_factors
from .balance import Balance, Evidence, noticeable, solve_balance
from .types import LightProblem, Lights

ASKED = 4000
"""Patches asked."""
SHADOW_RAYS = 12
"""From each to a surface."""
PROMISING = 8
"""Surfaces at most that are tried with care."""
GAIN = 0.01
"""Fall of the held-out loss that all together must bring, as each has to later."""
MIN_SHARE = 2e-3
"""Of the light of the patches asked; what brings less is not worth a try."""


def promising(
    problem: LightProblem, observed: GroupRadiance, lights: Lights, say: NDArray[np.float64]
) -> list[NDArray[np.int64]]:
    """Surfaces that no photo shows and that would bring the most light beside ``lights``, the brightest first.

    Args:
        say: (P,) say of each seen patch.
    """
    pieces = [faces for faces in problem.hidden.pieces if not lights.mask[faces].any()]
    usable = np.flatnonzero((say > 0) & observed.known.all(1))
    if not pieces or not len(usable):
        return []
    rng = np.random.default_rng([problem.seed, 41])
    rows = np.sort(rng.permutation(usable)[:ASKED])
    t = problem.transport
    factors = emitter_form_factors(
        problem.tracer, _origins(t.origins, rows), _rays(t.rays, rows), pieces, SHADOW_RAYS, rng, Progress()
    )
    theirs = under_lobe(factors, t.kappa[rows])
    own = under_lobe(lights.form_factors[rows], t.kappa[rows])
    rest = lights.irradiance[rows] - own @ lights.radiance

    def balanced(reach: NDArray[np.floating], start: NDArray[np.floating]) -> Balance:
        silent = np.full(start.shape, np.nan)
        evidence = Evidence(np.zeros(start.shape), silent, np.arange(len(start)), silent)
        radiance, part, weight = observed.radiance[rows], t.part[rows], say[rows]
        return solve_balance(radiance, rest, reach, part, weight, evidence, start, problem.robust_log)

    start = np.concatenate([lights.radiance, noticeable(lights.irradiance[rows], theirs)])
    with_them = balanced(np.concatenate([own, theirs], 1), start)
    if len(lights.emitters) and with_them.held_out > (1 - GAIN) * balanced(own, lights.radiance).held_out:
        return []
    brought = theirs.mean(0) * with_them.radiance[len(lights.emitters) :].mean(1)
    enough = brought > MIN_SHARE * lights.irradiance[rows].mean()
    return [pieces[k] for k in np.argsort(-brought, kind="stable")[:PROMISING] if enough[k]]


def _origins(origins: Origins, rows: NDArray[np.integer]) -> Origins:
    return Origins(origins.position[rows], origins.normal[rows])


def _rays(rays: GatherRays, rows: NDArray[np.integer]) -> GatherRays:
    return GatherRays(
        rays.face[rows], rays.direction[rows], rays.distance[rows], rays.schlick_start[rows], rays.schlick_end[rows]
    )
