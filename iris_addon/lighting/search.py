"""The search for light: which faces are lamps, how much light comes from outside, and the exponent of the response.

Candidates for lamps are solved for, then tested again under the light just found, with falling thresholds
(:func:`find_lights`, :func:`reconsider_lamps`). Every hypothesis on outside light (:func:`choose_outside`) and every
exponent (:func:`choose_exponent`) is judged by the light balance of patches that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ..base.progress import Progress
from ..brdf.diffuse import under_lobe
from ..response.radiance import GroupRadiance
from ..transport.gather import ESCAPED
from .balance import EFFECTIVE_PATCHES, ROBUST_LOG
from .brightness import Brightness, reflectance_needed
from .candidates import (
    CERTAIN_REFLECTANCE,
    LAMP_MIN_PIXELS,
    continued,
    emitting_faces,
    fewer_lamps,
    group_emitters,
    joined_pieces,
    voted,
    whole_regions,
    with_gaps_closed,
    with_specks_filled,
)
from .highlights import without_highlights
from .lamp_evidence import lamp_of_cell
from .lamp_radiance import (
    LitState,
    PatchFit,
    form_factors_of,
    lights_without_lamps,
    mean_radiance,
    solve_lights,
)
from .problem import LightProblem, Lights
from .selection import certainty, needed_lamps, same_emitters, solved, with_all_rays, with_unconstrained
from .unlike_copies import with_unlike_copies

OPEN_MESH_SHARE = 0.15
"""Share of escaping rays above which a mesh is no closed room."""
SELECTION_ROUNDS = 2
"""Rounds in which unconstrained regions are tried and idle lamps dropped. One is not enough: as long as specks count as
lamps, no lamp seems to be missing."""
LAMP_HYSTERESIS = 0.8
"""Factor on the thresholds for faces that already count as a lamp."""
FIRST_MIN_LEVEL = 0.7
"""Least radiance over that at which the shortest exposure clips, from which on a clipped face is solved for first."""
LAMP_THRESHOLDS = (CERTAIN_REFLECTANCE, 1.6, 1.25)
"""Reflectance needed above which a face counts as a lamp, round by round, from the certain ones down."""
EXPONENT_LOGS = np.linspace(-1.2, 1.2, 13)
"""Log exponents that are tried; the loss between them is smooth."""
EXPONENT_PRIOR_STD = 0.4
"""Standard deviation of the log exponent about that of the median measured response."""


def find_lights(problem: LightProblem, observed: GroupRadiance, progress: Progress) -> Lights:
    """The lamps, found without any to start from: certain ones first, then those that stand out only under their light.

    Args:
        observed: radiance of the seen patches.
    """
    lights = lights_without_lamps(problem, observed)
    if problem.given_emitters is not None:
        lights = solve_lights(problem, observed, problem.given_emitters, lights, progress)
        return with_unlike_copies(problem, observed, lights, PatchFit(), progress)
    # The first light takes what clips at its bound. What such a lamp lights seems to emit until it is solved for: on a
    # modelled mesh only in part of a region, which is no candidate, on a scan all the same.
    if problem.scanned.any():
        emitters = _candidates(problem, lights, CERTAIN_REFLECTANCE, CERTAIN_REFLECTANCE, clipped=True)
        lights = solved(problem, observed, emitters, lights, progress) if emitters else lights
    for threshold in LAMP_THRESHOLDS:
        emitters = _candidates(problem, lights, threshold, threshold)
        if not np.isfinite(lights.held_out) or not same_emitters(emitters, lights.emitters):
            lights = solved(problem, observed, emitters, lights, progress)
    for _ in range(SELECTION_ROUNDS):
        lights = with_unconstrained(problem, observed, lights, progress)
        emitters = needed_lamps(problem, observed, lights, progress)
        if len(emitters) == len(lights.emitters):
            break
        lights = solved(problem, observed, emitters, lights, progress)
    lights = with_all_rays(problem, observed, emitters, lights, progress)
    return with_unlike_copies(problem, observed, lights, PatchFit(), progress)


def choose_outside(
    problem: LightProblem,
    observed: GroupRadiance,
    progress: Progress,
    known: Lights | None = None,
) -> tuple[LightProblem, Lights]:
    """Lamps, with as much light from outside the mesh as earns its place.

    The hypotheses are none, constant light, light by direction, and the radiance that photos show through the holes,
    without and with unknown light where no photo looks. Each is scored by the held-out loss of the light balance, and
    :mod:`iris_addon.decide` states the acceptance gain of a larger one. Where light from outside is forced or a sun was
    found, all directions are taken at once.

    Args:
        known: lights whose lamps are kept; without it lamps are searched for.

    Returns:
        The problem with the chosen light from outside, and its lights.
    """
    directions, decisions = len(problem.hidden.directions), problem.decisions
    forced = decisions.forces("hidden_light")
    best: tuple[LightProblem, Lights] | None = None
    if known is not None:
        problem = replace(problem, clipped_counts=not known.emitters)
    # A mesh with large holes is no closed room: without outside light everything in it would seem to emit.
    is_open = float((problem.transport.target == ESCAPED).mean()) > OPEN_MESH_SHARE
    hypotheses = sorted({min(1, directions), directions} | (set() if is_open else {0}))
    # Where the sun comes in, so does a sky that differs from the ground.
    for count in hypotheses[-1:] if forced or problem.hidden.sun is not None else hypotheses:
        tried = replace(problem, hidden=problem.hidden.with_directions(count))
        before = known if best is None else best[1]
        if before is None:
            lights = find_lights(tried, observed, progress)
            if not lights.emitters:
                problem, tried = (replace(posed, clipped_counts=True) for posed in (problem, tried))
                lights = _with_outside(tried, observed, lights, progress)
        else:
            lights = _with_outside(tried, observed, before, progress)
        if best is None:
            best = tried, lights
            continue
        alone = len(best[0].hidden.directions) > 0 and not best[1].emitters
        name = "directions_without_lamps" if alone else "outside_light"
        error, subject = best[1].paired_error(lights), f"{count} directions"
        if decisions.accept(name, best[1].held_out, lights.held_out, error, subject=subject):
            best = tried, lights
    assert best is not None
    # Photos clip a sky, so that they show too little of its light.
    if problem.hidden.holes is not None and not forced and problem.hidden.sun is None:
        shown = replace(problem, hidden=problem.hidden.as_shown())
        lights = _with_outside(shown, observed, best[1], progress)
        name = "outside_light" if len(best[0].hidden.directions) == 0 else "light_through_holes"
        error = best[1].paired_error(lights)
        if decisions.accept(name, best[1].held_out, lights.held_out, error, subject="as photos show it"):
            best = shown, lights
        if (problem.hidden.holes.unseen >= 0).any():
            completed = replace(problem, hidden=problem.hidden.as_shown(unseen=True))
            lights = _with_outside(completed, observed, best[1], progress)
            error = best[1].paired_error(lights)
            if decisions.accept("light_of_unseen", best[1].held_out, lights.held_out, error):
                best = completed, lights
    return best


def _with_outside(problem: LightProblem, observed: GroupRadiance, before: Lights, progress: Progress) -> Lights:
    """The lamps of ``before``, solved for again together with the light from outside of ``problem``."""
    lobes, sun = before.hidden_radiance, None
    if problem.hidden.sun is not None:
        lobes, sun = lobes[:-1], lobes[-1]
    # Directions start from the constant that they refine, and so can only explain more.
    refined = len(lobes) == 1 and len(problem.hidden.directions) > 1
    outside = lobes[0] if refined else mean_radiance(before.patch_radiance, problem)
    # Where there is nothing to solve for, this is returned unchanged, with an infinite loss.
    start = replace(before, hidden_radiance=problem.hidden.start(outside, sun), held_out=np.inf)
    return solve_lights(problem, observed, start.emitters, start, progress, start.form_factors, warm_start=refined)


def reconsider_lamps(
    problem: LightProblem,
    observed: GroupRadiance,
    lights: Lights,
    weight: NDArray[np.float64],
    diffuse: NDArray[np.float64],
    progress: Progress,
) -> Lights:
    """The lamps, tested and solved for again now that gloss is known.

    Args:
        weight: (P,) statistical weight of each seen patch.
        diffuse: (P, 3) radiance without its specular part.
    """
    # Only earlier lamps are tested: what seems to emit only after its specular part was subtracted is no lamp.
    emitters = problem.given_emitters
    if emitters is None:
        pixels = np.bincount(problem.samples.face, minlength=len(problem.regions))
        unseen = [lamp for lamp in lights.emitters if pixels[lamp].sum() < LAMP_MIN_PIXELS]
        emitters = [*_candidates(problem, lights, CERTAIN_REFLECTANCE, LAMP_THRESHOLDS[-1], lights.mask), *unseen]
    factors = form_factors_of(problem, emitters, progress, known=lights)
    fit = PatchFit(weight, diffuse)
    lights = solve_lights(problem, observed, emitters, lights, progress, factors, fit)
    return with_unlike_copies(problem, observed, lights, fit, progress)


def _candidates(
    problem: LightProblem,
    lights: Lights,
    new: float,
    old: float,
    among: NDArray[np.bool_] | None = None,
    clipped: bool = False,
) -> list[NDArray[np.int64]]:
    """Lamps under the light known so far.

    Args:
        new, old: reflectance needed above which faces are lamps: those that are none so far, and those that are.
        among: (F,) faces that may be lamps, by default all.
        clipped: whether only faces count that clip in nearly all views, short exposures among them.
    """
    lamp = lamp_of_cell(problem, lights.emitters)
    seen = _with_found(problem, lights, lamp)
    needed = reflectance_needed(seen, _irradiance_by_rank(problem, lights, lamp))
    if clipped:
        shown = problem.brightness
        first = shown.clips.any(1) & (shown.floor.max(1) >= FIRST_MIN_LEVEL * shown.bound.max())
        needed = np.where(first, needed, 0.0)
    # A face that counts as a lamp stays one unless the light found since explains its brightness.
    cell, face, n_faces = problem.cells.of_pixel, problem.samples.face, len(problem.regions)
    counts = lamp >= 0
    emitting, count = emitting_faces(needed > np.where(counts, LAMP_HYSTERESIS * old, new), cell, face, n_faces)
    certain, _ = emitting_faces(
        needed > np.where(counts, LAMP_HYSTERESIS, 1.0) * CERTAIN_REFLECTANCE, cell, face, n_faces
    )
    # A face dimmer than the typical reflected light is unexplained, but no lamp.
    usual = np.median(lights.irradiance[: problem.transport.n_seen].mean(1))
    emitting &= emitting_faces(seen.floor.max(1) > usual, cell, face, n_faces)[0]
    scanned, adjacency, tracer = problem.scanned, problem.adjacency, problem.tracer
    emitting, certain = (voted(faces, count, adjacency, scanned) for faces in (emitting, certain))
    level = _face_level(problem, seen)
    clips, _ = emitting_faces(problem.brightness.clips.any(1), cell, face, n_faces)
    emitting = without_highlights(problem, emitting, level, clips)
    # Bright faces of a region that otherwise reflects are a highlight or a caustic until they are far too bright.
    certain = continued(certain, emitting, count, tracer.normals, adjacency, scanned)
    whole = whole_regions(emitting, count, problem.regions)[problem.regions] & ~scanned
    emitting &= certain | whole
    emitting = with_gaps_closed(emitting, count > 0, tracer.normals, adjacency)
    emitting = with_specks_filled(emitting, tracer.areas, adjacency, scanned)
    lamps = group_emitters(emitting, count, tracer.areas, problem.regions, adjacency, among, scanned)
    return fewer_lamps(joined_pieces(lamps, level, tracer, scanned), level, tracer)


def _face_level(problem: LightProblem, seen: Brightness) -> NDArray[np.float64]:
    """(F,) brightness of each face, mean over channels and pixels, 0 for one that no photo shows."""
    face, n_faces = problem.samples.face, len(problem.regions)
    total = np.bincount(face, seen.floor.mean(1)[problem.cells.of_pixel], n_faces)
    return total / np.maximum(np.bincount(face, minlength=n_faces), 1)


def _with_found(problem: LightProblem, lights: Lights, lamp: NDArray[np.int64]) -> Brightness:
    """The brightness of cells; on clipped lamps, whose photos give only a bound, at least their solved radiance."""
    floor = problem.brightness.floor.copy()
    at = np.flatnonzero(lamp >= 0)
    clipped = (problem.brightness.bound[at] >= floor[at]) & (floor[at] > 0)
    floor[at] = np.where(clipped, np.maximum(floor[at], lights.radiance[lamp[at]]), floor[at])
    return replace(problem.brightness, floor=floor)


def _irradiance_by_rank(problem: LightProblem, lights: Lights, lamp: NDArray[np.int64]) -> NDArray[np.float64]:
    """(C, 3) irradiance / pi at the cells; on a lamp, without the direct light of less certain lamps.

    The frame in front of a window is lit by the window. If it is mistaken for a lamp, its light must not make the
    window look like a reflecting surface.
    """
    patch = problem.cells.patch
    irradiance = np.array(lights.irradiance[patch], np.float64)
    needed = certainty(problem, lights, lamp, len(lights.emitters))
    for k, own in enumerate(needed):
        at, weaker = np.flatnonzero(lamp == k), needed < own
        direct = under_lobe(lights.form_factors[patch[at]][:, weaker], problem.transport.kappa[patch[at]])
        irradiance[at] -= direct @ lights.radiance[weaker]
    return irradiance


# ---- The exponent of the response -----------------------------------------------------------------------------------


def choose_exponent(states: Sequence[LitState], error: float, progress: Progress) -> float:
    """The exponent g of equation (16), under which the light balances best.

    With unknown or wrongly recorded exposures, photos determine response, exposures and radiance only up to
    (f(x^(1/g)), t^g, L^g). Light adds up and its powers do not: within a region of one albedo
    ``log L = log a + log(G L + B e)`` holds with slope 1 for the right g alone. Each g is tried with its own best
    lamps, and held-out patches decide.

    Args:
        states: each light state with its radiance of the seen patches, up to a power, and the lamps found under that;
            g changes their radiance, not their faces.
        error: standard deviation of log g that recorded exposures leave, infinite without any.

    Returns:
        The exponent; 1 where more light comes from outside than from lamps, because the balance then rests on guesses,
        and where the best g lies at an end of the range.
    """
    from_lamps, from_outside = np.sum([_lamps_and_outside(state.problem, state.before) for state in states], axis=0)
    if from_lamps <= from_outside:
        return 1.0
    gs = [float(g) for g in np.exp(EXPONENT_LOGS)]
    losses = np.array([np.mean([_loss(state, g, progress) for state in states]) for g in gs])
    losses += 0.5 * (EXPONENT_LOGS / min(error, EXPONENT_PRIOR_STD)) ** 2 / EFFECTIVE_PATCHES
    if losses.argmin() in (0, len(losses) - 1):
        return 1.0
    fine = np.linspace(EXPONENT_LOGS[0], EXPONENT_LOGS[-1], 1000)
    return float(np.exp(fine[CubicSpline(EXPONENT_LOGS, losses)(fine).argmin()]))


def _lamps_and_outside(problem: LightProblem, lights: Lights) -> tuple[float, float]:
    """Light of the lamps, and from outside, at the seen patches."""
    n_seen, kappa = problem.transport.n_seen, problem.transport.kappa
    from_lamps = under_lobe(lights.form_factors[:n_seen], kappa[:n_seen]) @ lights.radiance
    return float(from_lamps.sum()), float(problem.hidden.irradiance(lights.hidden_radiance, kappa)[:n_seen].sum())


def _loss(state: LitState, g: float, progress: Progress) -> float:
    """Held-out loss of the light balance of radiance raised to the power g.

    Differences of log radiance grow by the factor g, errors included, so the robust scale does too.
    """
    problem, lights = state.problem, state.before
    seen = problem.brightness
    hidden = problem.hidden
    raised = replace(
        problem,
        brightness=Brightness(seen.floor**g, seen.measured**g, seen.bound**g),
        hidden=hidden if hidden.holes is None else replace(hidden, holes=hidden.holes.raised(g)),
        robust_log=ROBUST_LOG * g,
    )
    before = replace(lights, patch_radiance=lights.patch_radiance**g, hidden_radiance=lights.hidden_radiance**g)
    solved = solve_lights(raised, _raised(state.observed, g), lights.emitters, before, progress, lights.form_factors)
    return solved.held_out


def _raised(observed: GroupRadiance, g: float) -> GroupRadiance:
    """``observed`` with all radiance raised to the power ``g``."""
    return replace(observed, radiance=observed.radiance**g, bound=observed.bound**g)
