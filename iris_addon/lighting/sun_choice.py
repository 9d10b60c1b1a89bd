"""Whether the sun shines into a room: tried before lamps are searched for, and again beside those that were found.

What the sun lights is as bright as a lamp. It has to be known before faces are taken for lamps because they are bright;
and it has to explain what the lamps do not, because one direction out of a thousand fits the light of many a lamp a
little.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..base.progress import Progress
from ..base.random_streams import stream
from ..response.radiance import GroupRadiance
from ..surface.photo_samples import ShownPixels
from ..transport.aimed_rays import aim_at_bright
from .lamp_radiance import lights_without_lamps, solve_lights
from .problem import LightProblem, Lights
from .sun import Sun, sun_from
from .sun_search import SunGuess, find_suns, lit_pixels, refined


def with_sun(problem: LightProblem, observed: GroupRadiance, shown: ShownPixels, progress: Progress) -> LightProblem:
    """``problem`` with the sun, if one explains the light of a room without lamps better than a sky alone."""
    if not len(problem.hidden.directions) or problem.decisions.forbids("sun") or problem.given_emitters:
        return problem
    base = solve_lights(problem, observed, [], lights_without_lamps(problem, observed), progress)
    guesses = find_suns(problem, problem.tracer, observed, base, shown)
    if not guesses or not np.isfinite(base.held_out):
        return problem
    sunlit, lights = _lit_by(problem, observed, guesses[0], progress)
    # Under the light that the sun brings in, the borders of its patches tell more.
    sky = replace(lights, irradiance=lights.irradiance - _direct(sunlit, lights))
    guess = replace(guesses[0], irradiance=lights.hidden_radiance[-1])
    again = refined(problem, problem.tracer, lit_pixels(problem, sky, shown), guess)
    if again is not None:
        sunlit, lights = _lit_by(problem, observed, again, progress)
    accepted = problem.decisions.accept(
        "sun", base.held_out, lights.held_out, base.paired_error(lights), subject="without lamps"
    )
    return _aimed_at_sunlight(sunlit, lights) if accepted else problem


def sun_is_needed(problem: LightProblem, observed: GroupRadiance, lights: Lights, progress: Progress) -> bool:
    """Whether the light balance of ``lights`` misses the sun of ``problem``; True without one."""
    if problem.hidden.sun is None:
        return True
    dark = replace(problem, hidden=replace(problem.hidden, sun=None))
    start = replace(lights, hidden_radiance=lights.hidden_radiance[:-1])
    without = solve_lights(dark, observed, lights.emitters, start, progress, lights.form_factors)
    if without is start:  # nothing is left to solve for
        return True
    error = without.paired_error(lights)
    return problem.decisions.accept("sun", without.held_out, lights.held_out, error, subject="beside the lamps")


def _lit_by(
    problem: LightProblem, observed: GroupRadiance, guess: SunGuess, progress: Progress
) -> tuple[LightProblem, Lights]:
    """The problem with the sun of ``guess``, and its light without lamps."""
    sun = _sun(problem, guess)
    sunlit = replace(problem, hidden=replace(problem.hidden, sun=sun))
    lights = solve_lights(sunlit, observed, [], lights_without_lamps(sunlit, observed), progress)
    return replace(
        sunlit, hidden=replace(sunlit.hidden, sun=replace(sun, irradiance=lights.hidden_radiance[-1]))
    ), lights


def _sun(problem: LightProblem, guess: SunGuess) -> Sun:
    patch, seed = problem.surface.sample_patch, problem.seed
    room = problem.samples, patch, problem.transport, problem.field, seed
    return sun_from(guess.direction, guess.irradiance, problem.tracer, *room)


def _direct(problem: LightProblem, lights: Lights) -> np.ndarray:
    """(N, 3) irradiance / pi by the sun."""
    return problem.hidden.sunlight(lights.hidden_radiance, problem.transport.kappa)


def _aimed_at_sunlight(sunlit: LightProblem, lights: Lights) -> LightProblem:
    """``sunlit`` with rays aimed at what the sun lights, which may send most of the light of the room.

    The noise of gather rays, of which few meet it, would make walls too white and the sun too weak.
    """
    rng = stream(sunlit.seed, "lighting.aimed_at_sunlight")
    light = lights.patch_radiance, lights.irradiance, lights.mask
    return replace(sunlit, aimed=aim_at_bright(sunlit.tracer, sunlit.transport, sunlit.regions, *light, rng))
