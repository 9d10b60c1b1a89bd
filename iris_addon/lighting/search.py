"""Find the lamps: candidates, their radiance, and the test again under the light just found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ..base.progress import Progress
from ..brdf.diffuse import under_lobe
from ..response.radiance import GroupRadiance
from ..transport.gather import ESCAPED
from .balance import EFFECTIVE_PATCHES, ROBUST_LOG
from .candidates import (
    CERTAIN,
    Brightness,
    coplanar_with,
    emitting_faces,
    group_emitters,
    reflectance_needed,
    whole_regions,
    with_gaps_closed,
)
from .lamp_radiance import (
    PatchFit,
    form_factors_of,
    lamp_of_patch,
    lights_without_lamps,
    mean_radiance,
    patches_on,
    solve_lights,
)
from .problem import LightProblem, Lights
from .selection import certainty, needed_lamps, same_emitters, solved, with_all_rays, with_silent

OPEN_SHARE = 0.15
"""Share of escaping rays from which a mesh is no closed room."""
SELECTIONS = 2
"""How often silent regions are tried and idle lamps left out: while specks glow, no lamp seems to be missing."""
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
    known: Lights | None = None,
) -> tuple[LightProblem, Lights]:
    """Lamps, with as much light from outside the mesh as earns its place: none, constant, by direction, or what photos
    show through its holes.

    Each hypothesis is scored by the light balance of patches that it was not fitted to, and :mod:`iris_addon.decide`
    says what a larger one must earn. Where light from outside is forced, all directions are taken at once. The lamps
    are those of ``known``; without it they are searched for.
    """
    directions, decisions = len(problem.hidden.directions), problem.decisions
    forced = decisions.forces("hidden_light")
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
        if best is None:
            best = tried, lights
            continue
        alone = bool(best[1].hidden_radiance.any()) and not best[1].emitters
        name = "directions_without_lamps" if alone else "outside_light"
        if decisions.accept(name, best[1].held_out, lights.held_out, subject=f"{count} directions"):
            best = tried, lights
    assert best is not None
    if problem.hidden.holes is not None and not forced:
        shown = replace(problem, hidden=problem.hidden.as_shown())
        lights = _with_outside(shown, observed, best[1], progress)
        name = "outside_light" if len(best[0].hidden.directions) == 0 else "light_through_holes"
        if decisions.accept(name, best[1].held_out, lights.held_out, subject="as photos show it"):
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
    return solve_lights(problem, observed, start.emitters, start, progress, start.form_factors, warm_start=refined)


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
        seen = problem.samples.seen_faces(len(problem.regions))
        unseen = [lamp for lamp in lights.emitters if not seen[lamp].any()]
        emitters = [*_candidates(problem, lights, CERTAIN, THRESHOLDS[-1], lights.mask), *unseen]
    factors = form_factors_of(problem, emitters, progress, known=lights)
    return solve_lights(problem, observed, emitters, lights, progress, factors, PatchFit(weight, diffuse))


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
    patch, face, n_faces = problem.surface.sample_patch, problem.samples.face, len(problem.regions)
    emitting, count = emitting_faces(needed > np.where(counts, HYSTERESIS * old, new), patch, face, n_faces)
    certain, _ = emitting_faces(needed > np.where(counts, HYSTERESIS, 1.0) * CERTAIN, patch, face, n_faces)
    # Dimmer than what the room reflects anyway: unexplained light, but not a lamp.
    level = np.median(lights.irradiance[:n].mean(1))
    emitting &= emitting_faces(seen.floor.max(1) > level, patch, face, n_faces)[0]
    # A bright region of a region that otherwise reflects is a highlight or a caustic until it is far too bright for
    # one.
    certain = coplanar_with(certain, emitting, problem.tracer.normals, problem.adjacency)
    emitting &= certain | whole_regions(emitting, count, problem.regions)[problem.regions]
    emitting = with_gaps_closed(emitting, count > 0, problem.tracer.normals, problem.adjacency)
    return group_emitters(emitting, count, problem.tracer.areas, problem.regions, problem.adjacency, among)


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


# ---- The exponent that overlap leaves open, found by light transport ------------------------------------------------
#
# With the exposures unknown, or recorded wrong, photos fix response, exposures and radiance only up to
# (f(x^1/g), t^g, L^g). But light adds up, and its powers do not: within a region of one albedo
# log L = log a + log(G L + B e), with slope 1, holds for the right g alone. Every g is held to its own best lamps;
# patches that these were not fitted to decide.


LOG_EXPONENTS = np.linspace(-1.2, 1.2, 13)
"""Tried; between them the loss is smooth."""
PRIOR_STD = 0.4
"""Of the log exponent about that of the median measured response, for rooms whose shading says little."""


def choose_exponent(
    problem: LightProblem, observed: GroupRadiance, lights: Lights, error: float, progress: Progress
) -> float:
    """The g under which the light balances best; 1 where that says nothing.

    So it is where most light comes from what no photo shows, as the balance then is about guesses, and where the best g
    lies at an end of the range.

    Args:
        observed: radiance of the seen patches, up to a power.
        lights: the lamps found under that radiance; g changes their radiance, not which faces they are.
        error: standard deviation of log g by the exposures that were recorded, infinite without any.
    """
    n_seen, kappa = problem.transport.n_seen, problem.transport.kappa
    from_lamps = under_lobe(lights.form_factors[:n_seen], kappa[:n_seen]) @ lights.radiance
    from_outside = problem.hidden.irradiance(lights.hidden_radiance, kappa)[:n_seen]
    if from_lamps.sum() <= from_outside.sum():
        return 1.0
    losses = np.array([_loss(problem, observed, lights, float(g), progress) for g in np.exp(LOG_EXPONENTS)])
    losses += 0.5 * (LOG_EXPONENTS / min(error, PRIOR_STD)) ** 2 / EFFECTIVE_PATCHES
    if losses.argmin() in (0, len(losses) - 1):
        return 1.0
    fine = np.linspace(LOG_EXPONENTS[0], LOG_EXPONENTS[-1], 1000)
    return float(np.exp(fine[CubicSpline(LOG_EXPONENTS, losses)(fine).argmin()]))


def _loss(problem: LightProblem, observed: GroupRadiance, lights: Lights, g: float, progress: Progress) -> float:
    """Held-out loss of the light balance between radiances to the power g.

    Its logs are g times as far apart, errors included, so that its outliers start g times as far off.
    """
    seen = problem.brightness
    hidden = problem.hidden
    raised = replace(
        problem,
        brightness=Brightness(seen.floor**g, seen.measured**g, seen.bound**g),
        hidden=hidden if hidden.holes is None else replace(hidden, holes=hidden.holes.raised(g)),
        robust_log=ROBUST_LOG * g,
    )
    before = replace(lights, patch_radiance=lights.patch_radiance**g, hidden_radiance=lights.hidden_radiance**g)
    solved = solve_lights(raised, _raised(observed, g), lights.emitters, before, progress, lights.form_factors)
    return solved.held_out


def _raised(observed: GroupRadiance, g: float) -> GroupRadiance:
    return replace(observed, radiance=observed.radiance**g, bound=observed.bound**g)
