"""Which lamps a room needs: some are tried because photos say nothing against them, others left out again.

The search (:mod:`iris_addon.lighting.search`) takes for a lamp what is too bright to reflect. That is too little where
photos clip, and too much before the lamps that light the room are known. What decides here is the light balance of
patches it was not fitted to.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import group_medians
from ..base.progress import Progress
from ..base.random_streams import stream
from ..brdf.diffuse import under_lobe
from ..rays.sampling import Origins
from ..response.radiance import GroupRadiance
from ..surface.topology import pieces_between_edges
from ..transport.form_factors import emitter_form_factors, emitter_of_face
from ..transport.gather import GatherRays
from .balance import Evidence, noticeable, solve_balance
from .candidates import CERTAIN, emitting_faces, group_emitters, reflectance_needed, whole_regions
from .lamp_radiance import SEARCH_SHADOW_RAYS, form_factors_of, lamp_of_patch, patches_on, say_of, solve_lights
from .problem import LightProblem, Lights

NEGLIGIBLE_POWER = 2e-4
"""Of all the light that enters the room, lamps and outside together."""
IDLE_LOSS = 0.005
"""Highest rise of the held-out loss without a lamp that does nothing, per stop it is brighter than photos show."""
SILENT_EVERY = 4
"""One patch in so many is asked whether a silent part lights it; all are, before a lamp stays."""
LEAST_ASKED = 4
"""Patches without which nobody is asked: what is left of the room says nothing."""
SILENT_GAIN, MAX_CLIPPED = 0.01, 8
"""Fall of the held-out loss by which a region on which photos are silent becomes a lamp, and how many that clip are
tried."""
GLOWING = 1.25
"""Reflectance it would need from which on such a region emits; below, it is of a light colour."""
REFLECTED = 1.0
"""Reflectance up to which what a lamp's own pixels show may be reflected light."""
MAX_SIDES = 12
"""A lamp with more sides is round."""


def with_silent(problem: LightProblem, observed: GroupRadiance, lights: Lights, progress: Progress) -> Lights:
    """Try regions on which photos are silent, and keep what the light of the room asks for.

    Of a region that clips all over they say too little to need emission, of one that none shows nothing. A region that
    takes the place of a lamp which is a piece of it may cost nothing; one beside it must gain.
    """
    proposed = [*promising(problem, observed, lights, say_of(problem, observed)), *_clipped_regions(problem, lights)]
    if not proposed:
        return lights
    mask = lights.mask.copy()
    mask[np.concatenate(proposed)] = True
    n = problem.transport.n_seen
    say = np.where(patches_on(problem, mask)[:n], 0.0, say_of(problem, observed))
    asked = np.arange(n) % SILENT_EVERY == 0
    if np.count_nonzero(say * asked * observed.known.all(1)) < LEAST_ASKED:
        return lights

    def with_lamps(emitters: list[NDArray[np.int64]], before: Lights, near: bool = False) -> Lights:
        return solved(problem, observed, emitters, before, progress, say, near, asked)

    apart = [lamp for lamp in lights.emitters if not any(np.isin(lamp, faces).any() for faces in proposed)]
    together = with_lamps([*apart, *proposed], lights, near=True)
    bright = [faces for faces in proposed if _glows(problem, together, faces)]
    if not bright:
        return lights
    base = with_lamps(lights.emitters, lights)
    for faces in bright:
        apart = [lamp for lamp in base.emitters if not np.isin(lamp, faces).any()]
        limit = 1 - SILENT_GAIN if len(apart) == len(base.emitters) else 1 + SILENT_GAIN
        tried = with_lamps([*apart, faces], base)
        if _glows(problem, tried, faces) and tried.held_out < limit * base.held_out:
            base = tried
    return base


def _glows(problem: LightProblem, lights: Lights, faces: NDArray[np.int64]) -> bool:
    """Whether a lamp is brighter than it could be by reflection of the light that reaches its region."""
    radiance = next(r for lamp, r in zip(lights.emitters, lights.radiance, strict=True) if np.array_equal(lamp, faces))
    own = problem.transport.region == problem.material[problem.regions[faces[0]]]
    return bool(radiance.mean() > GLOWING * lights.irradiance[own].mean())


def _clipped_regions(problem: LightProblem, lights: Lights) -> list[NDArray[np.int64]]:
    """Regions that clip in all views and are no lamp yet, those that need the largest reflectance first."""
    n, patch, face = problem.transport.n_seen, problem.surface.sample_patch, problem.samples.face
    seen = problem.brightness
    clipped = ((seen.bound >= seen.floor) & (seen.floor > 0)).all(1)
    emitting, count = emitting_faces(clipped, patch, face, len(problem.regions))
    emitting = whole_regions(emitting, count, problem.regions)[problem.regions]
    groups = group_emitters(emitting, count, problem.tracer.areas, problem.regions, problem.adjacency)
    groups = [group for group in groups if not lights.mask[group].all()]
    needed = _median_by_lamp(
        reflectance_needed(seen, lights.irradiance[:n]), lamp_of_patch(problem, groups), len(groups)
    )
    return [groups[k] for k in np.argsort(-needed, kind="stable")[:MAX_CLIPPED]]


def needed_lamps(
    problem: LightProblem, observed: GroupRadiance, lights: Lights, progress: Progress
) -> list[NDArray[np.int64]]:
    """The lamps of ``lights`` without those, or those sides, that are not certain and that the room does not need.

    Whether it does is asked of the same patches with and without the lamp, and so not of those on any: what is textured
    and taken for a lamp would seem needed because its texture then does not count.
    """
    say = np.where(patches_on(problem, lights.mask)[: problem.transport.n_seen], 0.0, say_of(problem, observed))
    needed = certainty(problem, lights, lamp_of_patch(problem, lights.emitters))
    power = np.array([problem.tracer.areas[f].sum() for f in lights.emitters]) * lights.radiance.mean(1)
    # Mixed pixels at the edge of a real lamp make specks.
    strong = power > NEGLIGIBLE_POWER * (power.sum() + _power_from_outside(problem, lights))
    # Pixels beside which something else is as bright show nothing: a bar of a frame is no proof of a lamp.
    certain = (needed >= CERTAIN) & (needed * (1 - _outshone(problem, lights.emitters)) > REFLECTED)
    sure = [lights.emitters[k] for k in np.flatnonzero(strong & certain)]
    lamps = [lights.emitters[k] for k in np.flatnonzero(strong & ~certain)]
    if lamps:
        lights = _without_idle(problem, observed, sure, lamps, lights, say, progress)
        lamps = lights.emitters[len(sure) :]
        sides = [side for lamp in lamps for side in _sides(problem, lamp)]
        if len(sides) > len(lamps):
            lights = _without_idle(problem, observed, sure, sides, lights, say, progress)
            lamps = [lamp[lights.mask[lamp]] for lamp in lamps]
    return [*sure, *(lamp for lamp in lamps if len(lamp))]


def _power_from_outside(problem: LightProblem, lights: Lights) -> float:
    """Light that comes in from beyond the mesh, in the unit of a lamp's area times its radiance.

    The patches share the area of the mesh about evenly.
    """
    irradiance = problem.hidden.irradiance(lights.hidden_radiance, problem.transport.kappa)
    return float(problem.tracer.areas.sum() * irradiance.mean())


def _outshone(problem: LightProblem, emitters: list[NDArray[np.int64]]) -> NDArray[np.float64]:
    """(E,) share of each lamp's pixels beside which something else is as bright: the light they show may be its."""
    lamp, by = emitter_of_face(emitters, len(problem.regions))[problem.samples.face], problem.outshone_by
    on = np.flatnonzero(lamp >= 0)
    lent = (by[on] >= 0) & (lamp[by[on]] != lamp[on])
    pixels = np.bincount(lamp[on], minlength=len(emitters))
    return np.bincount(lamp[on], lent, len(emitters)) / np.maximum(pixels, 1)


def _without_idle(
    problem: LightProblem,
    observed: GroupRadiance,
    sure: list[NDArray[np.int64]],
    open_: list[NDArray[np.int64]],
    lights: Lights,
    say: NDArray[np.float64],
    progress: Progress,
) -> Lights:
    """The lamps ``sure`` and those of ``open_`` without which the held-out loss rises; the smallest are tried first.

    A lamp that no photo shows is tried after all others: it is there because the room missed its light, and must not
    have to hold its own against a bright surface that feigns some of it.
    """
    lights, left = solved(problem, observed, [*sure, *open_], lights, progress, say), list(open_)

    def without(lamps: list[NDArray[np.int64]]) -> Lights:
        kept = [lamp for lamp in left if all(lamp is not other for other in lamps)]
        return solved(problem, observed, [*sure, *kept], lights, progress, say, near=True)

    def idle(tried: Lights, stops: float = 1.0) -> bool:
        return tried.held_out < (1 + stops * IDLE_LOSS) * lights.held_out

    if sure and left and idle(tried := without(left)):
        return tried
    seen = problem.samples.seen_faces(len(problem.regions))
    for lamp in sorted(left, key=lambda lamp: (not seen[lamp].any(), problem.tracer.areas[lamp].sum())):
        if len(sure) + len(left) == 1 and not len(problem.hidden.directions):
            break  # the last light of a closed room
        tried = without([lamp])
        radiance = lights.radiance[len(sure) + next(k for k, other in enumerate(left) if other is lamp)]
        dim = not seen[lamp].any() and not _glows(problem, lights, lamp)
        if dim or idle(tried, _stops_beyond_photos(problem, lamp, radiance)):
            lights, left = tried, [other for other in left if other is not lamp]
    return lights


def _stops_beyond_photos(problem: LightProblem, lamp: NDArray[np.int64], radiance: NDArray[np.float64]) -> float:
    """By how many stops a lamp would have to be brighter than photos show, from half a stop to ten.

    The further beyond, the more the room has to ask for it: a strip of a frame can stand in for the window behind it at
    a hundred times the radiance. Pixels beside which something else is as bright show nothing of it.
    """
    on = lamp_of_patch(problem, [lamp]) == 0
    shown = np.median(problem.brightness.floor[on].mean(1)) if on.any() else 0.0
    shown *= 1 - _outshone(problem, [lamp])[0]
    return float(np.clip(np.log2(radiance.mean() / max(shown, 1e-9)), 0.5, 10.0))


def _sides(problem: LightProblem, lamp: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Pieces of a lamp between its sharp edges; the lamp itself if it has none, or more than MAX_SIDES."""
    member = np.zeros(len(problem.regions), bool)
    member[lamp] = True
    label = pieces_between_edges(problem.tracer.normals, problem.adjacency, member)[lamp]
    sides = [lamp[label == k] for k in np.unique(label)]
    return sides if len(sides) <= MAX_SIDES else [lamp]


def with_all_rays(
    problem: LightProblem,
    observed: GroupRadiance,
    emitters: list[NDArray[np.int64]],
    before: Lights,
    progress: Progress,
) -> Lights:
    """Solved with as many shadow rays as lamps that were found deserve."""
    factors = form_factors_of(problem, emitters, progress)
    return solve_lights(problem, observed, emitters, before, progress, factors)


def solved(
    problem: LightProblem,
    observed: GroupRadiance,
    emitters: list[NDArray[np.int64]],
    before: Lights,
    progress: Progress,
    say: NDArray[np.float64] | None = None,
    near: bool = False,
    asked: NDArray[np.bool_] | None = None,
) -> Lights:
    """Lights with other lamps; what of their form factors ``before`` does not have is traced as the search does."""
    factors = form_factors_of(problem, emitters, progress, SEARCH_SHADOW_RAYS, before)
    return solve_lights(problem, observed, emitters, before, progress, factors, say, near=near, asked=asked)


def certainty(problem: LightProblem, lights: Lights, lamp: NDArray[np.int64]) -> NDArray[np.float64]:
    """(E,) reflectance that each lamp would need if it were none, median over its patches."""
    needed = reflectance_needed(problem.brightness, lights.irradiance[: problem.transport.n_seen])
    return _median_by_lamp(needed, lamp, len(lights.emitters))


def _median_by_lamp(values: NDArray[np.float64], lamp: NDArray[np.int64], n_lamps: int) -> NDArray[np.float64]:
    """(E,) median over the patches of each lamp, 0 without any."""
    of_some = lamp >= 0
    return group_medians(values[of_some, None], lamp[of_some], n_lamps)[:, 0]


def same_emitters(a: list[NDArray[np.int64]], b: list[NDArray[np.int64]]) -> bool:
    """Whether two lists name the same lamps."""
    return len(a) == len(b) and all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


# ---- Which of the surfaces that no photo shows may be lamps: a first look, on few patches and with few rays ---------
#
# A bulb under its shade fills a ten-thousandth of what the room sees, and there are dozens of surfaces like it: hinges,
# undersides, the backs of drawers. Rays enough to solve for each would cost more than the rest of the search. But a
# lamp that is missing is missed where it shines, by many times what noise does; so all are solved for at once, roughly,
# and the few without whose light the balance would be worse are then tried with care
# (:mod:`iris_addon.lighting.selection`). How much light they bring says less: a hinge may take any radiance.


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
    rng = stream(problem.seed, "lighting.hidden_lamps")
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
    shown, region = observed.radiance[rows], t.region[rows]
    balance = solve_balance(shown, rest, reach, region, say[rows], evidence, start, problem.robust_log)

    known = np.flatnonzero(np.isin(region, balance.region_ids))
    albedo = balance.region_albedo[np.searchsorted(balance.region_ids, region[known])]
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
        face=rays.face[rows],
        direction=rays.direction[rows],
        distance=rays.distance[rows],
        schlick_start=rays.schlick_start[rows],
        schlick_end=rays.schlick_end[rows],
    )
