"""The selection of lamps: unconstrained regions are tried as lamps, and lamps that the room does not need are dropped.

The search (:mod:`.search`) takes for a lamp what is too bright to reflect. That finds too few lamps where photos clip
and where none shows them, and too many before the lamps that light the room are known. Here the light balance of
held-out patches decides, equation (18).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import counts, group_medians
from ..base.progress import Progress
from ..base.random_streams import stream
from ..brdf.diffuse import under_lobe
from ..decide import TOO_BRIGHT_REFLECTANCE, share_of_rise
from ..rays.sampling import Origins
from ..response.radiance import GroupRadiance
from ..surface.topology import smooth_components
from ..transport.form_factors import emitter_form_factors, emitter_of_face
from ..transport.gather import GatherRays
from .balance import Evidence, ShadedPatches, noticeable_radiance, solve_balance
from .brightness import reflectance_needed
from .candidates import (
    CERTAIN_REFLECTANCE,
    emitting_faces,
    group_emitters,
    joined_pieces,
    tie_fixtures,
    voted,
    whole_regions,
)
from .hidden import SURFACE_MAX_COUNT, SURFACE_MIN_SHARE
from .lamp_evidence import columns_of, lamp_of_cell
from .lamp_radiance import (
    SEARCH_SHADOW_RAYS,
    PatchFit,
    form_factors_of,
    patch_weight,
    patches_on,
    solve_lights,
)
from .problem import LightProblem, Lights

LAMP_MIN_POWER = 2e-4
"""Share of all light that enters the room, from lamps and from outside, below which a lamp is dropped."""
UNCONSTRAINED_EVERY = 4
"""One patch in so many is fitted while unconstrained regions are tried."""
UNCONSTRAINED_MIN_PATCHES = 4
"""Patches to fit below which no unconstrained region is tried."""
UNCONSTRAINED_MAX_CLIPPED = 8
"""Regions that clip in all photos and are tried, at most."""
UNCONSTRAINED_MIN_REFLECTANCE = 1.25
"""Reflectance needed above which an unconstrained region emits; below, its colour is light."""
SHOWN_MAX_REFLECTANCE = 1.0
"""Reflectance needed up to which the pixels of a lamp may show reflected light."""
LAMP_MAX_SIDES = 12
"""Sides above which a lamp counts as round and is not divided."""
HIDDEN_PATCHES = 4000
"""Patches on which hidden emitters are tried first."""
HIDDEN_SHADOW_RAYS = 12
"""Shadow rays from each of these patches to a surface."""
HIDDEN_MAX_TRIED = 8
"""Hidden emitters at most that are then tried with all rays of the search."""
HIDDEN_MIN_RADIANCE = 1e-9
"""Radiance below which a logarithm is not taken."""


def with_unconstrained(problem: LightProblem, observed: GroupRadiance, lights: Lights, progress: Progress) -> Lights:
    """``lights`` and the unconstrained regions that the light balance accepts as lamps.

    Photos do not determine whether a region emits that clips all over, or that none of them shows. A region that
    replaces lamps which are parts of it must not raise the held-out loss; one in addition to all lamps must lower it.
    """
    hidden = promising_surfaces(problem, observed, lights, patch_weight(problem, observed))
    parts = np.concatenate([faces for lamps in hidden for faces in lamps]) if hidden else np.zeros(0, np.int64)
    regions = [faces for faces in _clipped_regions(problem, lights) if not np.isin(parts, faces).any()]
    proposed = [*hidden, *([faces] for faces in regions)]
    if not proposed:
        return lights
    mask = lights.mask.copy()
    mask[np.concatenate([faces for lamps in proposed for faces in lamps])] = True
    n = problem.transport.n_seen
    weight = np.where(patches_on(problem, mask)[:n], 0.0, patch_weight(problem, observed))
    fit_mask = np.arange(n) % UNCONSTRAINED_EVERY == 0
    if np.count_nonzero(weight * fit_mask * observed.known.all(1)) < UNCONSTRAINED_MIN_PATCHES:
        return lights

    def with_lamps(emitters: list[NDArray[np.int64]], before: Lights, warm_start: bool = False) -> Lights:
        return solved(problem, observed, emitters, before, progress, weight, warm_start, fit_mask)

    def apart_from(lamps: list[NDArray[np.int64]], emitters: list[NDArray[np.int64]]) -> list[NDArray[np.int64]]:
        own = np.concatenate(lamps)
        return [lamp for lamp in emitters if not np.isin(lamp, own).any()]

    each = list({faces.tobytes(): faces for lamps in proposed for faces in lamps}.values())
    together = with_lamps([*apart_from(each, lights.emitters), *each], lights, warm_start=True)
    bright = [lamps for lamps in proposed if any(_glows(problem, together, faces) for faces in lamps)]
    if not bright:
        return lights
    base = with_lamps(lights.emitters, lights)
    for proposal in bright:
        lamps = [faces for faces in proposal if not (columns_of([faces], base.emitters) >= 0).any()]
        if not lamps:
            continue
        apart = apart_from(lamps, base.emitters)
        name = "unconstrained_lamp" if len(apart) == len(base.emitters) else "unconstrained_lamp_in_place"
        tried = with_lamps([*apart, *lamps], base, warm_start=True)
        if any(_glows(problem, tried, faces) for faces in lamps) and problem.decisions.accept(
            name, base.held_out, tried.held_out, base.paired_error(tried), subject=_subject(lamps)
        ):
            base = with_lamps(tried.emitters, tried)  # what unseen surfaces pass on is not another lamp's
    return base


def _glows(problem: LightProblem, lights: Lights, faces: NDArray[np.int64]) -> bool:
    """Whether a lamp is brighter than its region could be by reflecting the light that reaches it."""
    radiance = next(r for lamp, r in zip(lights.emitters, lights.radiance, strict=True) if np.array_equal(lamp, faces))
    own = problem.transport.region == problem.material[problem.regions[faces[0]]]
    return bool(radiance.mean() > UNCONSTRAINED_MIN_REFLECTANCE * lights.irradiance[own].mean())


def _clipped_regions(problem: LightProblem, lights: Lights) -> list[NDArray[np.int64]]:
    """Faces of what clips in all views and is no lamp yet, in descending order of the reflectance needed: whole
    regions, and on scans connected faces."""
    cells, face, seen, tracer = problem.cells, problem.samples.face, problem.brightness, problem.tracer
    adjacency, scanned, regions = problem.adjacency, problem.scanned, problem.regions
    emitting, count = emitting_faces(seen.clips.all(1), cells.of_pixel, face, len(regions))
    emitting = voted(emitting, count, adjacency, scanned)
    emitting = np.where(scanned, emitting, whole_regions(emitting, count, regions)[regions])
    groups = group_emitters(emitting, count, tracer.areas, regions, adjacency, scanned=scanned)
    groups = joined_pieces(groups, np.ones(len(regions)), tracer, scanned)
    # Of a scan, whose regions tell nothing of lamps, what clips around a lamp is no larger lamp.
    groups = [group for group in groups if lights.mask[group].mean() < (0.5 if scanned[group[0]] else 1.0)]
    needed = certainty(problem, lights, lamp_of_cell(problem, groups), len(groups))
    return [groups[k] for k in np.argsort(-needed, kind="stable")[:UNCONSTRAINED_MAX_CLIPPED]]


def _clipped_parts(problem: LightProblem) -> list[NDArray[np.int64]]:
    """Faces of each part of a region between sharp edges that clips all over in all views, in descending order of the
    gather rays that meet it; none on scans.

    A lamp in a well of the ceiling, welded to it, is such a part, and so are the walls of the well. Which of them
    lights the room no photo tells.
    """
    tracer, adjacency, regions = problem.tracer, problem.adjacency, problem.regions
    in_all, rays = problem.brightness.clips.all(1), problem.transport.rays
    least = SURFACE_MIN_SHARE * rays.face.size
    clips, count = emitting_faces(in_all, problem.cells.of_pixel, problem.samples.face, len(regions))
    label = smooth_components(tracer.normals, adjacency, regions)
    alone = np.bincount(regions)[regions] == np.bincount(label)[label]
    clips = whole_regions(clips, count, label)[label] & ~alone & ~problem.scanned & (tracer.areas > 0)
    met = np.bincount(label, clips * counts(rays.face, len(regions)))
    chosen = np.argsort(-met, kind="stable")[:SURFACE_MAX_COUNT]
    return [np.flatnonzero(clips & (label == k)) for k in chosen if met[k] > least]


def needed_lamps(
    problem: LightProblem, observed: GroupRadiance, lights: Lights, progress: Progress
) -> list[NDArray[np.int64]]:
    """The lamps of ``lights`` without those lamps, or sides of lamps, that are not certain and that the room can miss.

    The losses with and without a lamp are taken over the same patches, those on no lamp. Otherwise a textured surface
    that is mistaken for a lamp would seem needed, because its texture then leaves the loss.

    Returns:
        Faces of each lamp that is kept.
    """
    weight = np.where(
        patches_on(problem, lights.mask)[: problem.transport.n_seen], 0.0, patch_weight(problem, observed)
    )
    needed = certainty(problem, lights, lamp_of_cell(problem, lights.emitters), len(lights.emitters))
    power = np.array([problem.tracer.areas[f].sum() for f in lights.emitters]) * lights.radiance.mean(1)
    # Mixed pixels at the edge of a real lamp create specks.
    strong = power > LAMP_MIN_POWER * (power.sum() + _outside_power(problem, lights))
    # Pixels beside something as bright are no evidence: a bar of a window frame is no certain lamp.
    shown = needed * (1 - _share_beside_brighter(problem, lights.emitters))
    certain = (needed >= CERTAIN_REFLECTANCE) & (shown > SHOWN_MAX_REFLECTANCE)
    sure = [lights.emitters[k] for k in np.flatnonzero(strong & certain)]
    lamps = [lights.emitters[k] for k in np.flatnonzero(strong & ~certain)]
    if lamps:
        lights = _without_idle(problem, observed, sure, lamps, lights, weight, lamps, progress)
        lamps = lights.emitters[len(sure) :]
        sides_of = [_sides(problem, lamp) for lamp in lamps]
        sides = [side for own in sides_of for side in own]
        if len(sides) > len(lamps):
            whole = [own[0] for own in sides_of if len(own) == 1]
            lights = _without_idle(problem, observed, sure, sides, lights, weight, whole, progress)
            lamps = [lamp[lights.mask[lamp]] for lamp in lamps]
    return [*sure, *(lamp for lamp in lamps if len(lamp))]


def _outside_power(problem: LightProblem, lights: Lights) -> float:
    """Light from outside the mesh, in the unit of a lamp's area times its radiance.

    The estimate assumes that patches share the area of the mesh evenly.
    """
    irradiance = problem.hidden.irradiance(lights.hidden_radiance, problem.transport.kappa)
    return float(problem.tracer.areas.sum() * irradiance.mean())


def _share_beside_brighter(problem: LightProblem, emitters: list[NDArray[np.int64]]) -> NDArray[np.float64]:
    """(E,) share of each lamp's pixels beside something else as bright, which may be the source of their light."""
    lamp, by = emitter_of_face(emitters, len(problem.regions))[problem.samples.face], problem.mixed.brighter_neighbour
    on = np.flatnonzero(lamp >= 0)
    borrowed = (by[on] >= 0) & (lamp[by[on]] != lamp[on])
    pixels = np.bincount(lamp[on], minlength=len(emitters))
    return np.bincount(lamp[on], borrowed, len(emitters)) / np.maximum(pixels, 1)


def _without_idle(
    problem: LightProblem,
    observed: GroupRadiance,
    sure: list[NDArray[np.int64]],
    undecided: list[NDArray[np.int64]],
    lights: Lights,
    weight: NDArray[np.float64],
    whole: list[NDArray[np.int64]],
    progress: Progress,
) -> Lights:
    """Lights of the lamps ``sure`` and of those of ``undecided`` without which the held-out loss rises.

    Lamps are left out one by one, the smallest first and hidden emitters last. A hidden emitter was added because the
    room lacked its light; it must not be compared while a bright surface still stands in for some of that light.

    Args:
        whole: those of ``undecided`` that are whole lamps, not sides of one: where photos say nothing of them, copies
            stand or fall together.
    """
    lights, left = solved(problem, observed, [*sure, *undecided], lights, progress, weight), list(undecided)
    seen = problem.samples.seen_faces(len(problem.regions))

    def without(lamps: list[NDArray[np.int64]]) -> Lights:
        kept = [lamp for lamp in left if all(lamp is not other for other in lamps)]
        return solved(problem, observed, [*sure, *kept], lights, progress, weight, warm_start=True)

    def idle(
        tried: Lights, lamps: list[NDArray[np.int64]], subject: str, stops: float = 1.0, copies: bool = False
    ) -> bool:
        # What is left out would have to reflect the light of the others.
        needed = certainty(problem, tried, lamp_of_cell(problem, lamps), len(lamps))
        bright = (needed * (1 - _share_beside_brighter(problem, lamps)) > TOO_BRIGHT_REFLECTANCE).any()
        name, share = ("bright_lamp", 1.0) if bright else ("lamp", share_of_rise("lamp", stops))
        # Photos cannot show it darker than it is. Of a scan, and beside one, what they do not show are crumbs.
        if copies or (not problem.scanned.any() and not any(seen[lamp].any() for lamp in lamps)):
            name, share = "unconstrained_lamp", share_of_rise("unconstrained_lamp")
        return not problem.decisions.accept(
            name, tried.held_out, lights.held_out, tried.paired_error(lights), share, subject
        )

    if sure and left and idle(tried := without(left), left, f"{len(left)} together"):
        return tried
    # What photos say nothing of stands or falls with its copies. Of sets that may stand in for each other, as lamps and
    # the walls of their wells, the least missed goes first.
    silent = [lamp for lamp in whole if _unconstrained(problem, lamp)]
    sets = [[silent[k] for k in numbers] for numbers in _copies(problem, silent) if len(numbers) > 1]
    while sets:
        tried, lamps = min(((without(lamps), lamps) for lamps in sets), key=lambda pair: pair[0].held_out)
        if len(sure) + len(left) == len(lamps) or not idle(tried, lamps, _subject(lamps), copies=True):
            break
        lights, left = tried, [lamp for lamp in left if all(lamp is not other for other in lamps)]
        sets = [kept for kept in sets if kept is not lamps]
    together = [lamp for lamps in sets for lamp in lamps]
    alone = [lamp for lamp in left if all(lamp is not other for other in together)]
    for lamp in sorted(alone, key=lambda lamp: (not seen[lamp].any(), problem.tracer.areas[lamp].sum())):
        if len(sure) + len(left) == 1 and not len(problem.hidden.directions):
            break  # the last light of a closed room
        tried = without([lamp])
        radiance = lights.radiance[len(sure) + next(k for k, other in enumerate(left) if other is lamp)]
        dim = not seen[lamp].any() and not _glows(problem, lights, lamp)
        if dim or idle(tried, [lamp], _named(lamp), _stops_beyond_photos(problem, lamp, radiance)):
            lights, left = tried, [other for other in left if other is not lamp]
    return lights


def _named(faces: NDArray[np.int64]) -> str:
    """The name of a lamp in the record of decisions."""
    return f"lamp of {len(faces)} faces from {int(faces.min())}"


def _unconstrained(problem: LightProblem, lamp: NDArray[np.int64]) -> bool:
    """Whether no photo shows the lamp of these faces, or all clip it."""
    own = np.isin(problem.samples.face, lamp)
    return bool(problem.brightness.clips.all(1)[problem.cells.of_pixel[own]].all())


def _subject(lamps: list[NDArray[np.int64]]) -> str:
    """The name of a lamp and its copies in the record of decisions."""
    return _named(lamps[0]) + (f" and {len(lamps) - 1} copies" if len(lamps) > 1 else "")


def _stops_beyond_photos(problem: LightProblem, lamp: NDArray[np.int64], radiance: NDArray[np.float64]) -> float:
    """Stops by which a lamp is brighter than photos show it, between a half and ten.

    The acceptance gain is proportional to it: a strip of a window frame can stand in for the window behind it at a
    hundred times the radiance. Pixels beside something as bright count as black.

    Args:
        lamp: (k,) faces.
        radiance: (3,) of the lamp.
    """
    on = lamp_of_cell(problem, [lamp]) == 0
    shown = np.median(problem.brightness.floor[on].mean(1)) if on.any() else 0.0
    shown *= 1 - _share_beside_brighter(problem, [lamp])[0]
    return float(np.clip(np.log2(radiance.mean() / max(shown, 1e-9)), 0.5, 10.0))


def _sides(problem: LightProblem, lamp: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Faces of each side of a lamp between sharp edges; the lamp as a whole if there are more than LAMP_MAX_SIDES, or
    on a scan, whose edges are noise."""
    if problem.scanned[lamp].any():
        return [lamp]
    member = np.zeros(len(problem.regions), bool)
    member[lamp] = True
    label = smooth_components(problem.tracer.normals, problem.adjacency, member)[lamp]
    sides = [lamp[label == k] for k in np.unique(label)]
    return sides if len(sides) <= LAMP_MAX_SIDES else [lamp]


def with_all_rays(
    problem: LightProblem,
    observed: GroupRadiance,
    emitters: list[NDArray[np.int64]],
    before: Lights,
    progress: Progress,
) -> Lights:
    """Lights of ``emitters``, with all shadow rays traced anew and as many as for lamps that were found."""
    factors = form_factors_of(problem, emitters, progress)
    return solve_lights(problem, observed, emitters, before, progress, factors)


def solved(
    problem: LightProblem,
    observed: GroupRadiance,
    emitters: list[NDArray[np.int64]],
    before: Lights,
    progress: Progress,
    weight: NDArray[np.float64] | None = None,
    warm_start: bool = False,
    fit_mask: NDArray[np.bool_] | None = None,
) -> Lights:
    """Lights of ``emitters``; form factors that ``before`` lacks are traced with the rays of the search."""
    factors = form_factors_of(problem, emitters, progress, SEARCH_SHADOW_RAYS, before)
    fit = PatchFit(weight=weight, fit_mask=fit_mask)
    return solve_lights(problem, observed, emitters, before, progress, factors, fit, warm_start)


def certainty(problem: LightProblem, lights: Lights, lamp: NDArray[np.int64], n_lamps: int) -> NDArray[np.float64]:
    """(n_lamps,) reflectance that would explain each lamp's brightness under ``lights``, median over its cells, 0
    without any; ``lamp`` (C,) as of :func:`.lamp_of_cell`."""
    on = lamp >= 0
    needed = reflectance_needed(problem.brightness, lights.irradiance[problem.cells.patch])
    return group_medians(needed[on, None], lamp[on], n_lamps)[:, 0]


def same_emitters(a: list[NDArray[np.int64]], b: list[NDArray[np.int64]]) -> bool:
    """Whether two lists name the same lamps."""
    return len(a) == len(b) and all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


# ---- Hidden emitters: a rough first solve ---------------------------------------------------------------------------


def promising_surfaces(
    problem: LightProblem, observed: GroupRadiance, lights: Lights, weight: NDArray[np.float64]
) -> list[list[NDArray[np.int64]]]:
    """Sets of surfaces, unseen or clipped in all photos, that may be lamps of one radiance: those without whose light a
    rough balance would be worse, by falling loss.

    A bulb under its shade fills a ten-thousandth of the hemisphere of the room, and dozens of surfaces are like it:
    hinges, undersides, backs of drawers. Enough rays to solve for each would cost more than the rest of the search. But
    a missing lamp leaves an error where it shines that is many times the noise. So all surfaces are solved for together
    on HIDDEN_PATCHES patches, and each is judged by the loss without its light. The light it brings is no criterion: a
    hinge may take any radiance. Copies of one model are one unknown: six spots in a row, each with four walls of its
    well, explain any light together. Surfaces are tried one by one where no set of copies is missed.

    Args:
        weight: (P,) statistical weight of each seen patch.

    Returns:
        Faces of each surface of each set, at most HIDDEN_MAX_TRIED sets.
    """
    unconstrained = [*problem.hidden.surfaces, *_clipped_parts(problem)]
    surfaces = [faces for faces in unconstrained if not lights.mask[faces].any()]
    usable = np.flatnonzero((weight > 0) & observed.known.all(1))
    if not surfaces or not len(usable):
        return []
    rng = stream(problem.seed, "lighting.hidden_emitters")
    rows = np.sort(rng.permutation(usable)[:HIDDEN_PATCHES])
    t = problem.transport
    factors = emitter_form_factors(
        problem.tracer, _origins(t.origins, rows), _rays(t.rays, rows), surfaces, HIDDEN_SHADOW_RAYS, rng, Progress()
    )
    theirs = under_lobe(factors, t.kappa[rows])
    own = under_lobe(lights.form_factors[rows], t.kappa[rows])
    rest = lights.irradiance[rows] - own @ lights.radiance
    shown, region, lamps = observed.radiance[rows], t.region[rows], len(lights.emitters)

    def promising(proposals: list[NDArray[np.int64]]) -> list[NDArray[np.int64]]:
        """Those of the ``proposals``, numbers of surfaces of one radiance, whose light would be missed."""
        columns = np.stack([theirs[:, numbers].sum(1) for numbers in proposals], 1)
        reach = np.concatenate([own, columns], 1)
        start = np.concatenate([lights.radiance, noticeable_radiance(lights.irradiance[rows], columns)])
        none = np.full(start.shape, np.nan)
        evidence = Evidence(bound=np.zeros(start.shape), measured=none, tie=np.arange(len(start)), expected=none)
        patches = ShadedPatches(radiance=shown, indirect=rest, form_factors=reach, region=region, weight=weight[rows])
        balance = solve_balance(patches, evidence, start, problem.robust_log)
        known = np.flatnonzero(np.isin(region, balance.region_ids))
        albedo = balance.region_albedo[np.searchsorted(balance.region_ids, region[known])]
        light = (rest + reach @ balance.radiance)[known]

        def loss(light: NDArray[np.floating]) -> float:
            """Loss of the balance under other light (n, 3), with the albedo kept."""
            predicted = np.maximum(light, HIDDEN_MIN_RADIANCE) * albedo
            r = np.log(np.maximum(shown[known], HIDDEN_MIN_RADIANCE) / predicted) / problem.robust_log
            return float(np.log1p(r**2).sum(1) @ weight[rows[known]])

        all_light = loss(light)
        without = [loss(light - np.outer(columns[known, k], e)) for k, e in enumerate(balance.radiance[lamps:])]

        def missed(k: int) -> bool:
            share, subject = share_of_rise("hidden_emitter"), _subject([surfaces[n] for n in proposals[k]])
            return problem.decisions.accept("hidden_emitter", without[k], all_light, share=share, subject=subject)

        most_missed = np.argsort(-np.array(without), kind="stable")[:HIDDEN_MAX_TRIED]
        return [proposals[k] for k in most_missed if missed(k)]

    found = promising(_copies(problem, surfaces))
    if not any(len(numbers) > 1 for numbers in found):
        found = promising([np.array([k]) for k in range(len(surfaces))])
    return [[surfaces[k] for k in numbers] for numbers in found]


def _copies(problem: LightProblem, surfaces: list[NDArray[np.int64]]) -> list[NDArray[np.int64]]:
    """Numbers of the ``surfaces`` of each model."""
    label = tie_fixtures(surfaces, problem.tracer.areas, corners=problem.tracer.corners)
    return [np.flatnonzero(label == k) for k in np.unique(label)]


def _origins(origins: Origins, rows: NDArray[np.integer]) -> Origins:
    """The ray origins of the patches ``rows``."""
    return Origins(origins.position[rows], origins.normal[rows])


def _rays(rays: GatherRays, rows: NDArray[np.integer]) -> GatherRays:
    """The gather rays of the patches ``rows``."""
    return GatherRays(
        face=rays.face[rows],
        direction=rays.direction[rows],
        distance=rays.distance[rows],
        schlick_start=rays.schlick_start[rows],
        schlick_end=rays.schlick_end[rows],
    )
