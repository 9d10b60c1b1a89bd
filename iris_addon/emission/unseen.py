"""Which of the surfaces that no photo shows may be lamps: a first look, on few patches and with few rays.

A bulb under its shade fills a ten-thousandth of what the room sees, and there are dozens of surfaces like it: hinges,
undersides, the backs of drawers. Rays enough to solve for each would cost more than the rest of the search. But a lamp
that is missing is missed where it shines, by many times what noise does; so all are solved for at once, roughly, and
the few without whose light the balance would be worse are then tried with care
(:mod:`iris_addon.emission.selection`). How much light they bring says less: a hinge may take any radiance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..progress import Progress
from ..response.radiance import GroupRadiance
from ..transport.diffuse import under_lobe
from ..transport.form_factors import emitter_form_factors
from ..transport.gather import GatherRays, Origins
from .balance import noticeable, solve_balance
from .evidence import Evidence
from .types import LightProblem, Lights

ASKED = 4000
"""Patches asked."""
SHADOW_RAYS = 12
"""From each to a surface."""
PROMISING = 8
"""Surfaces at most that are tried with care."""
GAIN = 0.01
"""Rise of the loss without it from which on a surface is missed, as later with care."""
DARK = 1e-9


def promising(
    problem: LightProblem, observed: GroupRadiance, lights: Lights, say: NDArray[np.float64]
) -> list[NDArray[np.int64]]:
    """Surfaces that no photo shows and whose light would be missed beside that of ``lights``, the most missed first.

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

    reach = np.concatenate([own, theirs], 1)
    start = np.concatenate([lights.radiance, noticeable(lights.irradiance[rows], theirs)])
    silent = np.full(start.shape, np.nan)
    evidence = Evidence(np.zeros(start.shape), silent, np.arange(len(start)), silent)
    shown, part = observed.radiance[rows], t.part[rows]
    balance = solve_balance(shown, rest, reach, part, say[rows], evidence, start, problem.robust_log)

    known = np.flatnonzero(np.isin(part, balance.part_ids))
    albedo = balance.part_albedo[np.searchsorted(balance.part_ids, part[known])]
    light = (rest + reach @ balance.radiance)[known]

    def loss(light: NDArray[np.floating]) -> float:
        """Of the same balance under other light, its albedo kept."""
        r = np.log(np.maximum(shown[known], DARK) / (np.maximum(light, DARK) * albedo)) / problem.robust_log
        return float(np.log1p(r**2).sum(1) @ say[rows[known]])

    lamps, all_light = len(lights.emitters), loss(light)
    without = [loss(light - np.outer(theirs[known, k], e)) for k, e in enumerate(balance.radiance[lamps:])]
    missed = np.array(without) / max(all_light, 1e-12) - 1
    return [pieces[k] for k in np.argsort(-missed, kind="stable")[:PROMISING] if missed[k] > GAIN]


def _origins(origins: Origins, rows: NDArray[np.integer]) -> Origins:
    return Origins(origins.position[rows], origins.normal[rows])


def _rays(rays: GatherRays, rows: NDArray[np.integer]) -> GatherRays:
    return GatherRays(
        rays.face[rows], rays.direction[rows], rays.distance[rows], rays.schlick_start[rows], rays.schlick_end[rows]
    )
