"""Whether the sun shines into a room: proposed before lamps are searched for, then judged against lamps without it.

What the sun lights is as bright as a lamp. It has to be known before faces are taken for lamps because they are bright;
and it has to explain more than the lamps that are found without it, because one direction out of a thousand fits the
light of many a lamp a little.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..base.progress import Progress
from ..base.random_streams import stream
from ..response.radiance import GroupRadiance
from ..surface.photo_samples import ShownPixels
from .lamp_radiance import PatchFit, half_shown, lights_without_lamps, patch_weight, patches_on, solve_lights
from .problem import LightProblem, Lights
from .search import choose_outside
from .sun import Sun, sun_from
from .sun_search import SunGuess, find_suns, lit_pixels, refined


def choose_sun(
    dark: LightProblem, observed: GroupRadiance, shown: ShownPixels, progress: Progress
) -> tuple[LightProblem, LightProblem, Lights]:
    """The problem with a sun if the room needs one, the same with the light from outside that earns its place, and the
    lights found for it.

    Args:
        dark: the problem without a sun.
    """
    sunlit = with_sun(dark, observed, shown, progress)
    light, lights = choose_outside(sunlit, observed, progress)
    if sunlit.hidden.sun is None:
        return dark, light, lights
    sky, lamps = choose_outside(dark, observed, progress)
    if _is_needed((light, lights), (sky, lamps), observed, progress, "in place of lamps"):
        return sunlit, light, lights
    return dark, sky, lamps


def with_sun(problem: LightProblem, observed: GroupRadiance, shown: ShownPixels, progress: Progress) -> LightProblem:
    """``problem`` with the sun, if what it lights tells that there is one: the light of a room without lamps then
    balances better than under a sky alone."""
    if not len(problem.hidden.directions) or problem.decisions.forbids("sun") or problem.given_emitters:
        return problem
    base = solve_lights(problem, observed, [], lights_without_lamps(problem, observed), progress)
    guesses = find_suns(problem, problem.tracer, observed, base, shown)
    if not guesses or not np.isfinite(base.held_out):
        return problem
    alone = replace(problem, sunlight_passed_on=False)
    guess = guesses[0]
    sunlit, lights = _lit_by(alone, observed, guess, progress)
    # Under the light that the sun brings in, the borders of its patches tell more.
    sky = replace(lights, irradiance=lights.irradiance - _direct(sunlit, lights))
    guess = replace(guess, irradiance=lights.hidden_radiance[-1])
    closer = refined(problem, problem.tracer, lit_pixels(problem, sky, shown), guess)
    if closer is not None:
        guess = closer
        sunlit, lights = _lit_by(alone, observed, guess, progress)
    if not _is_needed((sunlit, lights), (problem, base), observed, progress, "without lamps"):
        return problem
    sunlit, lights = _lit_by(problem, observed, guess, progress)
    # Rays aimed at what the sun lights, which may send most of the light of the room: the noise of gather rays, of
    # which few meet it, would make walls too white and the sun too weak.
    return replace(sunlit, aimed=sunlit.rays_to_bright(lights, stream(sunlit.seed, "lighting.aimed_at_sunlight")))


def _is_needed(
    sunlit: tuple[LightProblem, Lights],
    dark: tuple[LightProblem, Lights],
    observed: GroupRadiance,
    progress: Progress,
    subject: str,
) -> bool:
    """Whether the light of a problem with a sun balances better than that of the one without, both solved for again
    from the patches that are measured and no lamp in both."""
    problem, sun = dark[0], sunlit[0].hidden.sun
    assert sun is not None
    weight = patch_weight(problem, observed) * ~half_shown(problem, observed, sun)
    for _, lights in (dark, sunlit):
        weight[patches_on(problem, lights.mask)[: len(weight)]] = 0.0
    without, with_it = (
        solve_lights(
            replace(problem, clipped_counts=False),
            observed,
            lights.emitters,
            lights,
            progress,
            lights.form_factors,
            PatchFit(weight),
        )
        for problem, lights in (dark, sunlit)
    )
    error = without.paired_error(with_it)
    return problem.decisions.accept("sun", without.held_out, with_it.held_out, error, subject=subject)


def _lit_by(
    problem: LightProblem, observed: GroupRadiance, guess: SunGuess, progress: Progress
) -> tuple[LightProblem, Lights]:
    """The problem with the sun of ``guess``, and its light without lamps."""
    sun = _sun(problem, guess)
    sunlit = replace(problem, hidden=replace(problem.hidden, sun=sun))
    lights = solve_lights(sunlit, observed, [], lights_without_lamps(sunlit, observed), progress)
    sun = replace(sun, irradiance=lights.hidden_radiance[-1])
    return replace(sunlit, hidden=replace(sunlit.hidden, sun=sun)), lights


def _sun(problem: LightProblem, guess: SunGuess) -> Sun:
    patch, seed = problem.surface.sample_patch, problem.seed
    room = problem.samples, patch, problem.transport, problem.field, seed
    return sun_from(guess.direction, guess.irradiance, problem.tracer, *room)


def _direct(problem: LightProblem, lights: Lights) -> np.ndarray:
    """(N, 3) irradiance / pi by the sun."""
    return problem.hidden.sunlight(lights.hidden_radiance, problem.transport.kappa)
