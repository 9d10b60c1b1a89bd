"""Evidence on lamps: what photos show of a lamp itself, equation (20), and which cells and patches lie on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..transport.form_factors import emitter_of_face
from .balance import Evidence
from .brightness import Brightness
from .candidates import tie_fixtures
from .lamp_pattern import LampPattern
from .problem import LightProblem, Lights

CLIPPED_LAMP_FACTOR = 2.0
"""Expected radiance of a clipped lamp over its bound; a speck whose light reaches no patch stays about there."""
PATTERN_CLIPS = 0.05
"""Share of the area of a lamp with a pattern that may clip where its mean radiance counts as measured."""
CLIPS_TOO = 0.5
"""Share of the radiance at which one channel clips from which another may clip as well: blur makes clipped pixels
darker, and JPEG keeps their color as the mean over several."""
LAMP_QUANTILE = 0.8
"""Quantile over a lamp's unclipped pixels at which its radiance is measured; its edge or a blind is darker."""


def lamp_evidence(problem: LightProblem, emitters: list[NDArray[np.int64]], before: Lights) -> Evidence:
    """Bounds and measurements per lamp from the pixels on it.

    Args:
        before: lights that know which copies of one model are unlike, and the profiles of lamps. Of lamps with a
            profile, and of those that are asked for one, nothing is measured: photos show them from some angles, which
            the fit of a profile accounts for. What they show is a bound, since no angle is brighter than the brightest
            of the profile.
    """
    seen, face, cell = problem.brightness, problem.samples.face, problem.cells.of_pixel
    label = emitter_of_face(emitters, len(problem.regions))
    on_lamp = np.flatnonzero(label[face] >= 0)
    order = on_lamp[np.argsort(label[face[on_lamp]], kind="stable")]
    per_lamp = np.split(order, np.cumsum(np.bincount(label[face[order]], minlength=len(emitters)))[:-1])
    bound = np.zeros((len(emitters), 3))
    measured, expected = np.full((2, len(emitters), 3), np.nan)
    for index, own in enumerate(per_lamp[: len(emitters)]):
        if len(own) == 0:
            continue  # no photo shows it
        pattern = problem.pattern_of(emitters[index])
        inner = own[problem.inner_cells[cell[own]]]
        if pattern is not None:
            bound[index], measured[index] = _mean_over(seen, pattern)
        elif len(inner):
            bound[index], measured[index] = _seen_of(seen, cell[inner])
        else:
            bound[index], expected[index] = _seen_beside_edges(seen, cell[own])
    expected = np.where((bound > 0) & np.isnan(measured) & np.isnan(expected), CLIPPED_LAMP_FACTOR * bound, expected)
    for index, faces in enumerate(emitters):
        profile = before.profile_of(faces)
        if profile is None and not problem.asked_for_profile(faces):
            continue
        shown, measured[index] = np.fmax(bound[index], measured[index]), np.nan
        bound[index] = 0.0 if profile is None else shown / profile.values.max()
        expected[index] = before.radiance[columns_of([faces], before.emitters)[0]]
    return Evidence(bound, measured, _tied(problem, emitters, before.apart_of(emitters)), expected)


def _seen_of(seen: Brightness, cells: NDArray[np.integer]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3,) bound on the radiance of a lamp, and (3,) its measurement or NaN, from the ``cells`` (k,) of its pixels."""
    bound, measured = np.median(seen.bound[cells], axis=0), np.full(3, np.nan)
    for channel in range(3):
        # An unclipped pixel below the bound of clipped ones shows the lamp's edge.
        values = seen.measured[cells, channel]
        unclipped = values >= 0.98 * bound[channel]
        if unclipped.mean() > 0.3:
            measured[channel] = np.quantile(values[unclipped], LAMP_QUANTILE)
    clips_too = (measured > CLIPS_TOO * bound.max()) & (measured <= bound.max())
    bound[clips_too] = np.maximum(bound, measured)[clips_too]
    measured[clips_too] = np.nan
    return bound, measured


def _seen_beside_edges(seen: Brightness, cells: NDArray[np.integer]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3,) bound on the radiance of a lamp that all its pixels mix with what is around it, and (3,) its expectation.

    They are darker than the lamp, and where the photo clips there before it is blurred, darker than what clips.
    """
    shown, clips = np.fmax(seen.bound[cells], seen.measured[cells]), (seen.bound[cells] > 0).any(0)
    bound = np.nan_to_num(np.nanquantile(shown, LAMP_QUANTILE, axis=0))
    return bound, np.where(clips, CLIPPED_LAMP_FACTOR, 1.0) * bound


def _tied(
    problem: LightProblem, emitters: list[NDArray[np.int64]], apart: NDArray[np.bool_] | None = None
) -> NDArray[np.int64]:
    """(E,) label of lamps that share one radiance; one with a pattern or ``apart`` (E,) has its own."""
    tie = tie_fixtures(emitters, problem.tracer.areas, apart, problem.tracer.corners)
    own = [k for k, faces in enumerate(emitters) if problem.pattern_of(faces) is not None]
    tie[own] = len(emitters) + np.arange(len(own))
    return np.unique(tie, return_inverse=True)[1]


def _mean_over(seen: Brightness, pattern: LampPattern) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3,) least mean radiance over the patches of a lamp, and the mean (3,) where hardly any clips.

    A pattern has no brighter part that stands for all of it.
    """
    clips = np.isnan(seen.measured[pattern.patch])  # the first cells are the patches
    mean = pattern.area @ seen.at_least(pattern.patch)
    return mean, np.where(pattern.area @ clips <= PATTERN_CLIPS, mean, np.nan)


def with_hidden(lamps: Evidence, expected: NDArray[np.float64]) -> Evidence:
    """Evidence on lamps and lobes of outside light together; lobes have an expectation (H, 3) only."""
    n, h = len(lamps.tie), len(expected)
    nothing = np.full((h, 3), np.nan)
    first_free = int(lamps.tie.max()) + 1 if n else 0
    return Evidence(
        np.concatenate([lamps.bound, np.zeros((h, 3))]),
        np.concatenate([lamps.measured, nothing]),
        np.concatenate([lamps.tie, first_free + np.arange(h)]),
        np.concatenate([lamps.expected, expected]),
    )


def columns_of(emitters: list[NDArray[np.int64]], known: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """(E,) index of each emitter among those ``known``, -1 where it is none of them."""
    column = {faces.tobytes(): k for k, faces in enumerate(known)}
    return np.array([column.get(faces.tobytes(), -1) for faces in emitters], np.int64)


def lamp_of_cell(problem: LightProblem, emitters: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """(C,) index of the emitter that covers most of each cell, -1 for none."""
    return _lamp_of(problem, emitters, problem.cells.of_pixel, problem.cells.count)


def lamp_of_patch(problem: LightProblem, emitters: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """(P,) the same of each seen patch."""
    return _lamp_of(problem, emitters, problem.surface.sample_patch, problem.surface.count)


def _lamp_of(
    problem: LightProblem,
    emitters: list[NDArray[np.int64]],
    group: NDArray[np.integer],
    count: NDArray[np.integer] | NDArray[np.floating],
) -> NDArray[np.int64]:
    """(n,) index of the emitter that most pixels of each group show, -1 for none; pixels are of a ``group`` (k,) with
    ``count`` (n,) pixels."""
    label = emitter_of_face(emitters, len(problem.regions))[problem.samples.face]
    on = np.flatnonzero(label >= 0)
    pair, pixels = np.unique(group[on].astype(np.int64) * len(emitters) + label[on], return_counts=True)
    of, lamp = np.divmod(pair, max(1, len(emitters)))
    most = pixels > 0.5 * count[of]
    result = np.full(len(count), -1, np.int64)
    result[of[most]] = lamp[most]
    return result
