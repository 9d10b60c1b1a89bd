"""Find the lamps: candidates, their radiance, and the test again under the light just found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..progress import Progress
from ..response.radiance import GroupRadiance
from ..transport.diffuse import under_lobe
from ..transport.patch_hits import ESCAPED
from .candidates import (
    CERTAIN,
    Brightness,
    coplanar_with,
    emitting_faces,
    group_emitters,
    reflectance_needed,
    whole_parts,
    with_gaps_closed,
)
from .selection import certainty, needed_lamps, same_emitters, solved, with_all_rays, with_silent
from .solve import (
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
SHOWN_LOSS = 0.1
"""Rise of that loss at which light through holes that photos show is preferred to light that is fitted: the latter
also makes up for shadows that are lost with what the mesh lacks."""
ALONE_GAIN = 0.0025
"""Fall that directions must bring where there are no lamps, about twice the standard error: that all light of a room
is the same from everywhere was never likely. Beside lamps, directions would make up for what those get wrong."""
OPEN_SHARE = 0.15
"""Share of escaping rays from which a mesh is no closed room."""
SELECTIONS = 2
"""How often silent parts are tried and idle lamps left out: while specks glow, no lamp seems to be missing."""
HYSTERESIS = 0.8
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
            lights = solved(problem, observed, emitters, lights, progress)
    for _ in range(SELECTIONS):
        lights = with_silent(problem, observed, lights, progress)
        emitters = needed_lamps(problem, observed, lights, progress)
        if len(emitters) == len(lights.emitters):
            break
        lights = solved(problem, observed, emitters, lights, progress)
    return with_all_rays(problem, observed, emitters, lights, progress)


def choose_outside(
    problem: LightProblem,
    observed: GroupRadiance,
    progress: Progress,
    forced: bool = False,
    known: Lights | None = None,
) -> tuple[LightProblem, Lights]:
    """Lamps, with as much light from outside the mesh as earns its place: none, constant, by direction, or what photos
    show through its holes.

    Each hypothesis is scored by the light balance of patches that it was not fitted to. A larger one is taken only if
    it lowers that score by OUTSIDE_GAIN, or ALONE_GAIN; what photos show, of which nothing is unknown, in place of
    another unless that is better by SHOWN_LOSS. ``forced`` takes all directions at once. The lamps are those of
    ``known``; without it they are searched for.
    """
    directions = len(problem.hidden.directions)
    best: tuple[LightProblem, Lights] | None = None
    # A mesh with large holes is not a closed room: without outside light everything in it would seem to glow.
    is_open = float((problem.transport.target == ESCAPED).mean()) > OPEN_SHARE
    hypotheses = sorted({min(1, directions), directions} | (set() if is_open else {0}))
    for count in hypotheses[-1:] if forced else hypotheses:
        tried = replace(problem, hidden=problem.hidden.with_directions(count))
        before = known if best is None else best[1]
        if before is None:
            lights = find_lights(tried, observed, progress)
        else:
            lights = _with_outside(tried, observed, before, progress)
        alone = best is not None and bool(best[1].hidden_radiance.any()) and not best[1].emitters
        gain = ALONE_GAIN if alone else OUTSIDE_GAIN
        if best is None or lights.held_out < (1 - gain) * best[1].held_out:
            best = tried, lights
    assert best is not None
    if problem.hidden.holes is not None and not forced:
        shown = replace(problem, hidden=problem.hidden.as_shown())
        lights = _with_outside(shown, observed, best[1], progress)
        gain = OUTSIDE_GAIN if len(best[0].hidden.directions) == 0 else -SHOWN_LOSS
        if lights.held_out < (1 - gain) * best[1].held_out:
            best = shown, lights
    return best


def _with_outside(problem: LightProblem, observed: GroupRadiance, before: Lights, progress: Progress) -> Lights:
    """The lamps of ``before`` under the light from outside of ``problem``."""
    count = len(problem.hidden.directions)
    # Directions begin at the constant that they refine, and so can only explain more.
    refined = len(before.hidden_radiance) == 1 and count > 1
    outside = before.hidden_radiance[0] if refined else mean_radiance(before.patch_radiance, problem)
    # Where there is nothing to solve for, it comes back as it is, and explains nothing.
    start = replace(before, hidden_radiance=np.tile(outside, (count, 1)), held_out=np.inf)
    return solve_lights(problem, observed, start.emitters, start, progress, start.form_factors, near=refined)


def reconsider_lamps(
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
    # What seems to glow once its specular part is taken off, and did not before, was never a lamp.
    emitters = problem.given
    if emitters is None:
        seen = problem.samples.seen_faces(len(problem.parts))
        unseen = [lamp for lamp in lights.emitters if not seen[lamp].any()]
        emitters = [*_candidates(problem, lights, CERTAIN, THRESHOLDS[-1], lights.mask), *unseen]
    factors = form_factors_of(problem, emitters, progress, known=lights)
    return solve_lights(problem, observed, emitters, lights, progress, factors, weight, diffuse)


def _candidates(
    problem: LightProblem, lights: Lights, new: float, old: float, among: NDArray[np.bool_] | None = None
) -> list[NDArray[np.int64]]:
    """Lamps under the light known so far.

    Args:
        new, old: thresholds for faces that count as no lamp yet, and for those that do.
        among: (F,) faces that may be lamps, by default all.
    """
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
    emitting = with_gaps_closed(emitting, count > 0, problem.tracer.normals, problem.adjacency)
    return group_emitters(emitting, count, problem.tracer.areas, problem.parts, problem.adjacency, among)


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
    needed = certainty(problem, lights, lamp)
    for k, own in enumerate(needed):
        at, weaker = np.flatnonzero(lamp == k), needed < own
        direct = under_lobe(lights.form_factors[at][:, weaker], problem.transport.kappa[at])
        irradiance[at] -= direct @ lights.radiance[weaker]
    return irradiance
