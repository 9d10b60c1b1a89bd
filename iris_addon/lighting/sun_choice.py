"""Whether the sun shines into a room: tried before lamps are searched for, and again beside those that were found.

What the sun lights is as bright as a lamp. It has to be known before faces are taken for lamps because they are bright;
and it has to explain more than the lamps that are found without it, because one direction out of a thousand fits the
light of many a lamp a little.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..base.progress import Progress
from ..base.random_streams import stream
from ..decide import Decisions
from ..response.radiance import GroupRadiance
from ..surface.photo_samples import ShownPixels
from .lamp_radiance import PatchFit, half_shown, lights_without_lamps, patch_weight, solve_lights
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
    rivals = _of_the_same_patches(sky, observed, lamps, sunlit.hidden.sun, progress)
    if _accepted(dark.decisions, rivals, lights, "in place of lamps"):
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
    sunlit, lights = _lit_by(problem, observed, guesses[0], progress)
    # Under the light that the sun brings in, the borders of its patches tell more.
    sky = replace(lights, irradiance=lights.irradiance - _direct(sunlit, lights))
    guess = replace(guesses[0], irradiance=lights.hidden_radiance[-1])
    again = refined(problem, problem.tracer, lit_pixels(problem, sky, shown), guess)
    if again is not None:
        sunlit, lights = _lit_by(problem, observed, again, progress)
    assert sunlit.hidden.sun is not None
    base = _of_the_same_patches(problem, observed, base, sunlit.hidden.sun, progress)
    if not _accepted(problem.decisions, base, lights, "without lamps"):
        return problem
    return _passed_on(sunlit, observed, lights, progress)


def _accepted(decisions: Decisions, dark: Lights, lights: Lights, subject: str) -> bool:
    """Whether the sun stands that ``lights`` have and ``dark`` have not."""
    return decisions.accept("sun", dark.held_out, lights.held_out, dark.paired_error(lights), subject=subject)


def _of_the_same_patches(
    dark: LightProblem, observed: GroupRadiance, lights: Lights, sun: Sun, progress: Progress
) -> Lights:
    """The ``lights`` of ``dark``, which has no sun, solved for again from the patches that count under ``sun``."""
    weight = patch_weight(dark, observed) * ~half_shown(dark, observed, sun)
    return solve_lights(dark, observed, lights.emitters, lights, progress, lights.form_factors, PatchFit(weight))


def _lit_by(
    problem: LightProblem, observed: GroupRadiance, guess: SunGuess, progress: Progress
) -> tuple[LightProblem, Lights]:
    """The problem with the sun of ``guess``, as it lights what it shines on, and its light without lamps."""
    sun = _sun(problem, guess)
    sunlit = replace(problem, hidden=replace(problem.hidden, sun=sun), sunlight_passed_on=False)
    lights = solve_lights(sunlit, observed, [], lights_without_lamps(sunlit, observed), progress)
    return _as_strong(sunlit, lights), lights


def _passed_on(sunlit: LightProblem, observed: GroupRadiance, lights: Lights, progress: Progress) -> LightProblem:
    """``sunlit`` whose sun is as strong as the light says that its patches pass on, with rays aimed at these.

    They may send most of the light of the room. The noise of gather rays, of which few meet them, would make walls too
    white and the sun too weak.
    """
    sunlit = replace(sunlit, sunlight_passed_on=True)
    lights = solve_lights(sunlit, observed, [], lights, progress)
    rays = sunlit.rays_to_bright(lights, stream(sunlit.seed, "lighting.aimed_at_sunlight"))
    return replace(_as_strong(sunlit, lights), aimed=rays)


def _as_strong(sunlit: LightProblem, lights: Lights) -> LightProblem:
    """``sunlit`` with the irradiance of its sun in ``lights``."""
    sun = sunlit.hidden.sun
    assert sun is not None
    return replace(sunlit, hidden=replace(sunlit.hidden, sun=replace(sun, irradiance=lights.hidden_radiance[-1])))


def _sun(problem: LightProblem, guess: SunGuess) -> Sun:
    patch, seed = problem.surface.sample_patch, problem.seed
    room = problem.samples, patch, problem.transport, problem.field, seed
    return sun_from(guess.direction, guess.irradiance, problem.tracer, *room)


def _direct(problem: LightProblem, lights: Lights) -> np.ndarray:
    """(N, 3) irradiance / pi by the sun."""
    return problem.hidden.sunlight(lights.hidden_radiance, problem.transport.kappa)
