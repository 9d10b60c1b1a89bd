"""Copies of one lamp that do not shine alike: another bulb in one of them, or a dimmer.

Lamps of one model share a radiance, which the light balance then knows better than that of each. Two of a kind may have
different bulbs all the same. Each set of copies is therefore solved for with a radiance for each of them as well, and
the held-out loss tells which of the two it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.progress import Progress
from ..response.radiance import GroupRadiance
from .candidates import tie_fixtures
from .lamp_radiance import PatchFit, solve_lights
from .problem import LightProblem, Lights


def with_unlike_copies(
    problem: LightProblem, observed: GroupRadiance, lights: Lights, fit: PatchFit, progress: Progress
) -> Lights:
    """``lights``, in which copies of one model have a radiance of their own where that earns its place.

    Args:
        lights: solved for under ``observed`` and ``fit``.
    """

    def told_apart(copies: NDArray[np.int64], warm_start: bool) -> Lights:
        before = lights.told_apart(lights.emitters[k] for k in copies)
        factors = lights.form_factors
        return solve_lights(problem, observed, lights.emitters, before, progress, factors, fit, warm_start)

    for copies in _sets(problem, lights):
        tried = told_apart(copies, warm_start=True)
        error, subject = lights.paired_error(tried), f"lamps {', '.join(map(str, copies))}"
        if problem.decisions.accept("unlike_copies", lights.held_out, tried.held_out, error, subject=subject):
            lights = told_apart(copies, warm_start=False)  # what unseen patches pass on follows
    return lights


def _sets(problem: LightProblem, lights: Lights) -> list[NDArray[np.int64]]:
    """Numbers of the lamps of each set of copies that share a radiance, those of the most light first."""
    areas = problem.tracer.areas
    label = tie_fixtures(lights.emitters, areas, lights.apart, problem.tracer.corners)
    power = np.array([areas[faces].sum() for faces in lights.emitters]) * lights.radiance.mean(1)
    shared = np.array([problem.pattern_of(faces) is None for faces in lights.emitters], bool)
    sets = [np.flatnonzero((label == k) & shared) for k in np.unique(label)]
    return sorted((own for own in sets if len(own) > 1), key=lambda own: -power[own].sum())
