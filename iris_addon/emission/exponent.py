"""The exponent that overlap leaves open, found by light transport.

With the exposures unknown, or recorded wrong, photos fix response, exposures and radiance only up to
(f(x^1/g), t^g, L^g). But light adds up, and its powers do not: within a part of one albedo
log L = log a + log(G L + B e), with slope 1, holds for the right g alone. Every g is held to its own best lamps;
patches that these were not fitted to decide.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from ..progress import Progress
from ..response.radiance import GroupRadiance
from ..transport.diffuse import under_lobe
from .balance import EFFECTIVE_PATCHES, ROBUST_LOG
from .candidates import Brightness
from .solve import solve_lights
from .types import LightProblem, Lights

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
