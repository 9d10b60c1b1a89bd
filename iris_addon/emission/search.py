"""Find the lamps: candidates, their radiance, and the test again under the light just found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..progress import Progress
from ..response.radiance import GroupRadiance
from ..transport.diffuse import under_lobe
from ..transport.transport import ESCAPED
from .candidates import Brightness, coplanar_with, emitting_faces, group_emitters, reflectance_needed, whole_parts
from .solve import (
    SEARCH_SHADOW_RAYS,
    form_factors_of,
    lamp_of_patch,
    lights_without_lamps,
    mean_radiance,
    patches_on,
    solve_lights,
)
from .types import LightProblem, Lights

OUTSIDE_GAIN = 0.02
"""Fall of the held-out loss that each step from no light outside to constant to directional must bring."""
OPEN_SHARE = 0.15
"""Share of escaping rays from which a mesh is no closed room."""
NEGLIGIBLE_POWER = 2e-4
IDLE_LOSS = 0.002
"""Rise of the held-out loss without a lamp, up to which the lamp does nothing."""
HYSTERESIS = 0.8
CERTAIN = 3.0
THRESHOLDS = (CERTAIN, 1.6, 1.25)
"""Reflectance needed at which a face counts as a lamp, round by round, from the certain ones down."""


def find_lights(problem: LightProblem, observed: GroupRadiance, progress: Progress) -> Lights:
    """Search for lamps from nothing: certain ones first, then those that stand out only under their light."""
    lights = lights_without_lamps(problem, observed)
    if problem.given is not None:
        return solve_lights(problem, observed, problem.given, lights, progress)
    for threshold in THRESHOLDS:
        emitters = _candidates(problem, lights, threshold, threshold)
        if threshold == CERTAIN or not same_emitters(emitters, lights.emitters):
            factors = form_factors_of(problem, emitters, progress, SEARCH_SHADOW_RAYS, lights)
            lights = solve_lights(problem, observed, emitters, lights, progress, factors)
    lights = _without_negligible(problem, observed, lights, progress)
    lights = _without_idle(problem, observed, lights, progress)
    return _with_all_rays(problem, observed, lights, progress)


def choose_outside(
    problem: LightProblem, observed: GroupRadiance, progress: Progress, forced: bool = False
) -> tuple[LightProblem, Lights]:
    """Lamps, with as much light from outside the mesh as earns its place: none, constant, or by direction.

    Each hypothesis is scored by the light balance of patches that it was not fitted to. The next larger one is taken
    only if it lowers that score by OUTSIDE_GAIN; ``forced`` takes the largest at once.
    """
    directions = len(problem.hidden.directions)
    best: tuple[LightProblem, Lights] | None = None
    # A mesh with large holes is not a closed room: without outside light everything in it would seem to glow.
    is_open = float((problem.transport.target == ESCAPED).mean()) > OPEN_SHARE
    hypotheses = sorted({min(1, directions), directions} | (set() if is_open else {0}))
    for count in hypotheses[-1:] if forced else hypotheses:
        tried = replace(problem, hidden=problem.hidden.with_directions(count))
        if best is None:
            lights = find_lights(tried, observed, progress)
        else:
            start = replace(best[1], hidden_radiance=_expected_hidden(tried, best[1]))
            lights = solve_lights(tried, observed, start.emitters, start, progress, start.form_factors)
        if best is None or lights.held_out < (1 - OUTSIDE_GAIN) * best[1].held_out:
            best = tried, lights
    assert best is not None
    return best


def _expected_hidden(problem: LightProblem, lights: Lights) -> NDArray[np.float64]:
    """(H, 3) radiance expected of the hidden sources: what was found for parts, a dim room for directions."""
    parts = lights.hidden_radiance[: len(problem.hidden.parts)]
    dim = mean_radiance(lights.patch_radiance, problem)
    return np.concatenate([parts, np.tile(dim, (len(problem.hidden.directions), 1))])


def refine_lights(
    problem: LightProblem,
    observed: GroupRadiance,
    lights: Lights,
    weight: NDArray[np.float64],
    diffuse: NDArray[np.float64],
    progress: Progress,
) -> Lights:
    """Test and solve the lamps again, now that gloss is known.

    Args:
        weight: (P,) say of each seen patch.
        diffuse: (P, 3) radiance without its specular part.
    """
    # What the search has left out must be certain to come back.
    emitters = _candidates(problem, lights, CERTAIN, THRESHOLDS[-1]) if problem.given is None else problem.given
    factors = form_factors_of(problem, emitters, progress, known=lights)
    return solve_lights(problem, observed, emitters, lights, progress, factors, weight, diffuse)


def _candidates(problem: LightProblem, lights: Lights, new: float, old: float) -> list[NDArray[np.int64]]:
    """Lamps under the light known so far, at one threshold for new ones and one for those that count as lamps."""
    n = problem.transport.n_seen
    lamp = lamp_of_patch(problem, lights.emitters)
    seen = _with_found(problem, lights, lamp)
    needed = reflectance_needed(seen, _irradiance_by_rank(problem, lights, lamp))
    # What already counts as a lamp stays one unless the light found since explains it away.
    counts = patches_on(problem, lights.mask)[:n]
    patch, face, n_faces = problem.surface.sample_patch, problem.samples.face, len(problem.parts)
    emitting, count = emitting_faces(needed > np.where(counts, HYSTERESIS * old, new), patch, face, n_faces)
    certain, _ = emitting_faces(needed > np.where(counts, HYSTERESIS, 1.0) * CERTAIN, patch, face, n_faces)
    # Dimmer than what the room reflects anyway: unexplained light, but not a lamp.
    level = np.median(lights.irradiance[:n].mean(1))
    emitting &= emitting_faces(seen.floor.max(1) > level, patch, face, n_faces)[0]
    # A bright region of a part that otherwise reflects is a highlight or a caustic until it is far too bright for one.
    certain = coplanar_with(certain, emitting, problem.tracer.normals, problem.adjacency)
    emitting &= certain | whole_parts(emitting, count, problem.parts)[problem.parts]
    return group_emitters(emitting, count, problem.tracer.areas, problem.parts, problem.adjacency)


def _with_found(problem: LightProblem, lights: Lights, lamp: NDArray[np.int64]) -> Brightness:
    """The brightness of patches; on clipped lamps, of which photos give a bound, that which their light asks for."""
    floor = problem.brightness.floor.copy()
    at = np.flatnonzero(lamp >= 0)
    clipped = (problem.brightness.bound[at] >= floor[at]) & (floor[at] > 0)
    floor[at] = np.where(clipped, np.maximum(floor[at], lights.radiance[lamp[at]]), floor[at])
    return replace(problem.brightness, floor=floor)


def _irradiance_by_rank(problem: LightProblem, lights: Lights, lamp: NDArray[np.int64]) -> NDArray[np.float64]:
    """(P, 3) irradiance / pi at the seen patches; on a lamp, without the direct light of lamps less certain than it.

    A frame before a window is as bright as the window's light makes it. Taken for a lamp, it must not explain the
    window away.
    """
    irradiance = np.array(lights.irradiance[: problem.transport.n_seen], np.float64)
    certainty = _certainty(problem, lights, lamp)
    for k, own in enumerate(certainty):
        at, weaker = np.flatnonzero(lamp == k), certainty < own
        direct = under_lobe(lights.form_factors[at][:, weaker], problem.transport.kappa[at])
        irradiance[at] -= direct @ lights.radiance[weaker]
    return irradiance


def _certainty(problem: LightProblem, lights: Lights, lamp: NDArray[np.int64]) -> NDArray[np.float64]:
    """(E,) reflectance that each lamp would need if it were none, median over its patches."""
    needed = reflectance_needed(problem.brightness, lights.irradiance[: problem.transport.n_seen])
    on = [lamp == k for k in range(len(lights.emitters))]
    return np.array([np.median(needed[at]) if at.any() else 0.0 for at in on])


def _without_idle(problem: LightProblem, observed: GroupRadiance, lights: Lights, progress: Progress) -> Lights:
    """Leave out lamps that are not certain, the least certain first, where the room is lit as well without them."""
    certainty = _certainty(problem, lights, lamp_of_patch(problem, lights.emitters))
    emitters, factors, kept = lights.emitters, lights.form_factors, np.ones(len(certainty), bool)
    for k in np.argsort(certainty)[: int((certainty < CERTAIN).sum())]:
        kept[k] = False
        fewer = [faces for faces, keep in zip(emitters, kept, strict=True) if keep]
        without = solve_lights(problem, observed, fewer, lights, progress, factors[:, kept])
        if without.held_out < (1 + IDLE_LOSS) * lights.held_out:
            lights = without
        else:
            kept[k] = True
    return lights


def _without_negligible(problem: LightProblem, observed: GroupRadiance, lights: Lights, progress: Progress) -> Lights:
    """Leave out the lamps whose light nobody would miss: specks that mixed pixels at the edge of a real lamp make."""
    if not lights.emitters:
        return lights
    power = np.array([problem.tracer.areas[f].sum() for f in lights.emitters]) * lights.radiance.mean(1)
    kept = power > NEGLIGIBLE_POWER * power.sum()
    if kept.all():
        return lights
    emitters = [faces for faces, keep in zip(lights.emitters, kept, strict=True) if keep]
    return solve_lights(problem, observed, emitters, lights, progress, lights.form_factors[:, kept])


def _with_all_rays(problem: LightProblem, observed: GroupRadiance, lights: Lights, progress: Progress) -> Lights:
    """Solved again with as many shadow rays as lamps that were found deserve."""
    if not lights.emitters:
        return lights
    factors = form_factors_of(problem, lights.emitters, progress)
    return solve_lights(problem, observed, lights.emitters, lights, progress, factors)


def same_emitters(a: list[NDArray[np.int64]], b: list[NDArray[np.int64]]) -> bool:
    """Whether two lists name the same lamps."""
    return len(a) == len(b) and all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
