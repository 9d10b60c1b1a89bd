"""Lamps with a pattern: screens, shades and windows with a view, which are not equally bright everywhere.

The light balance gives a lamp one radiance. Whether it needs more is asked of the photos alone: what half of them show
of a patch of the lamp is predicted by what the other half shows of that patch, and by what it shows of the lamp in the
middle. Clipped observations are lower bounds. Where the first prediction is accepted, the lamp shines on the room with
its pattern, the textures show it, and its radiance is the mean over its patches instead of that of bright ones.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..base.group_by import group_medians
from ..base.progress import Progress
from ..base.random_streams import stream
from ..decide import HeldOutLosses
from ..model.response import LUMINANCE
from ..model.surface_points import even_points, interpolated
from ..response.radiance import MAX_COUNTED_PIXELS, GroupRadiance
from .lamp_evidence import PATTERN_CLIPS, lamp_of_patch
from .lamp_pattern import LampPattern
from .lamp_radiance import PatchFit, form_factors_of, solve_lights
from .problem import LightProblem, Lights
from .screens import Shown

MIN_PATCHES = 12
"""Patches of a lamp that both halves of the photos show, below which it is not asked for a pattern."""
ROBUST_LOG = 0.1
"""Error of a predicted log luminance at which it starts to count as an outlier."""
AREA_POINTS = 4000
"""Points on a lamp by which the area of its patches is told."""
PLACES = 400
"""Observations of a lamp that err independently, at most."""
TINY = 1e-9


def with_patterns(
    problem: LightProblem, observed: GroupRadiance, lights: Lights, shown: Shown, fit: PatchFit, progress: Progress
) -> Lights:
    """``lights`` with the lamps that have a pattern; its light and the mean radiance of each are solved for again.

    Args:
        observed, fit: as of :func:`solve_lights`.
    """
    patterned = patterned_lamps(problem, lights, shown)
    if not len(patterned):
        return lights
    problem = replace(problem, patterns=tuple(_pattern_of(problem, lights, k) for k in patterned))
    factors = form_factors_of(problem, lights.emitters, progress, known=lights)
    solved = solve_lights(problem, observed, lights.emitters, lights, progress, factors, fit, warm_start=True)
    share = np.ones(problem.transport.n_patches, np.float32)
    for pattern in problem.patterns:
        share[pattern.patch] = pattern.share
    return replace(solved, patterned=patterned, lamp_share=share)


def _pattern_of(problem: LightProblem, lights: Lights, number: int) -> LampPattern:
    """How bright the patches of a lamp are: where photos clip, as bright as its radiance leaves for them."""
    faces, tracer = lights.emitters[number], problem.tracer
    patch = np.flatnonzero(lamp_of_patch(problem, [faces]) == 0)
    position = problem.surface.position[patch]
    chosen, weights = even_points(tracer.areas[faces], AREA_POINTS)
    nearest = cKDTree(position).query(interpolated(tracer.corners[faces[chosen]], weights))[1]
    area = np.bincount(nearest, minlength=len(patch)) / len(nearest)
    seen = problem.brightness  # the first cells are the patches
    level, clips = seen.at_least(patch) @ LUMINANCE, np.isnan(seen.measured[patch]).any(1)
    # Where little clips, what photos show is the mean, and the radiance found before is that of bright patches.
    if area @ clips > PATTERN_CLIPS:
        left = lights.radiance[number] @ LUMINANCE - area[~clips] @ level[~clips]
        level[clips] = np.maximum(left / area[clips].sum(), level[clips])
    return LampPattern(faces=faces, patch=patch, position=position, area=area, share=level / (area @ level))


def patterned_lamps(problem: LightProblem, lights: Lights, shown: Shown) -> NDArray[np.int64]:
    """Numbers of the lamps on which photos agree that one place is brighter than another."""
    decisions = problem.decisions
    if decisions.forbids("lamp_pattern") or not lights.emitters:
        return np.zeros(0, np.int64)
    o, linear = shown.observations, shown.linear
    lamp = lamp_of_patch(problem, lights.emitters)
    value = np.where(linear.unclipped, linear.radiance, linear.bound) @ LUMINANCE
    rows = np.flatnonzero((lamp[o.patch] >= 0) & (value > 0))
    patch, half = o.patch[rows], _halves(lamp[o.patch[rows]], o.view[rows], problem.seed)
    clipped, weight = ~linear.unclipped[rows].all(1), np.minimum(o.count[rows], MAX_COUNTED_PIXELS)
    log, solved = np.log(value[rows]), np.log(np.maximum(lights.radiance @ LUMINANCE, TINY))
    level = _levels(log, clipped, weight, 2 * patch + half, 2 * len(lamp), np.repeat(solved[lamp], 2))
    level = level.reshape(-1, 2)
    seen = np.flatnonzero(np.isfinite(level).all(1))
    middle = np.stack([group_medians(level[seen, k, None], lamp[seen], len(solved))[:, 0] for k in range(2)], -1)
    losses = [
        np.log1p((np.where(clipped, np.maximum(off, 0), off) / ROBUST_LOG) ** 2)
        for off in (log - middle[lamp[patch], 1 - half], log - level[patch, 1 - half])
    ]
    patches = np.bincount(lamp[seen], minlength=len(solved))
    found = []
    for k in np.flatnonzero(patches >= MIN_PATCHES):
        if lights.profile_of(lights.emitters[k]) is not None:
            continue  # by angle its places are brighter and darker alike
        own = np.flatnonzero((lamp[patch] == k) & np.isin(patch, seen))
        even, pattern = (HeldOutLosses(own, loss[own], weight[own], PLACES) for loss in losses)
        smaller, larger = (float(np.average(each.loss, weights=each.weight)) for each in (even, pattern))
        if decisions.accept("lamp_pattern", smaller, larger, even.paired_error(pattern), subject=f"lamp {k}"):
            found.append(k)
    return np.array(found, np.int64)


def _halves(lamp: NDArray[np.integer], view: NDArray[np.integer], seed: int) -> NDArray[np.int64]:
    """(m,) 0 or 1 for each observation of a ``lamp`` (m,): by chance one of two halves of the views that show it.

    Photos that take turns at two exposures would make one half clip.
    """
    n_views = int(view.max(initial=0)) + 1
    turn = stream(seed, "lighting.patterns").permutation(n_views)
    pair, of_pair = np.unique(lamp * n_views + turn[view], return_inverse=True)
    first = np.searchsorted(pair // n_views, pair // n_views)
    return ((np.arange(len(pair)) - first) % 2)[of_pair]


def _levels(
    log: NDArray[np.floating],
    clipped: NDArray[np.bool_],
    weight: NDArray[np.floating],
    group: NDArray[np.integer],
    n: int,
    solved: NDArray[np.floating],
) -> NDArray[np.float64]:
    """(n,) log luminance of each group of observations, NaN where it has none: the mean of those that do not clip; if
    all do, the ``solved`` one (n,), or their highest bound."""
    times = np.bincount(group, np.where(clipped, 0, weight), n)
    total = np.bincount(group, np.where(clipped, 0, weight * log), n)
    bound = np.full(n, -np.inf)
    np.maximum.at(bound, group, np.where(clipped, log, -np.inf))
    beyond = np.where(np.isfinite(bound), np.maximum(bound, solved), np.nan)
    return np.where(times > 0, total / np.maximum(times, TINY), beyond)
