"""Highlights: bright faces of a scan on which photos may see a lamp mirrored.

A polished floor in front of a window is as bright as a lamp wherever a photo shows it, since all photos show it from
the room. What gives it away is where their rays go on: to something as bright. A lamp mirrors the room.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.random_streams import stream
from ..brdf.ggx import DIELECTRIC_F0, grazing_fresnel
from ..surface.topology import component_labels
from .brightness import VIEW_QUANTILE
from .problem import LightProblem

MIRROR_RAYS = 4
"""Rays per pixel into the lobe around the mirrored direction."""
MIRROR_LOBE = 0.15
"""Standard deviation of the normal about that of the patch, sine: noise of the scan, and the width of a gloss."""
HIGHLIGHT_MIN_SHARE = 0.5
"""Share of the pixels of a bright surface on highlights above which it is one as a whole."""
MIRROR_HEADROOM = 8.0
"""Radiance of a lamp over the bound at which it clips, at most, where it is taken for the cause of a highlight."""


def without_highlights(
    problem: LightProblem, emitting: NDArray[np.bool_], level: NDArray[np.floating], clipped: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """(F,) emitting faces without those of scans of which nearly all pixels may mirror another.

    A dielectric mirrors a twentieth of what is in front of it, and a third of what it is seen against at 77 degrees.
    Two windows that face each other are therefore no highlights of each other.

    Args:
        emitting: (F,) bool.
        level: (F,) brightness of each face, scene-linear.
        clipped: (F,) faces that are brighter than that by an unknown factor.
    """
    samples, n_faces = problem.samples, len(emitting)
    at = np.flatnonzero((emitting & problem.scanned)[samples.face])
    if not len(at):
        return emitting
    rng = stream(problem.seed, "lighting.highlights")
    face, mirrors = samples.face[at], np.zeros(len(at), bool)
    towards = samples.direction[at]
    normal = problem.surface.normal[problem.surface.sample_patch[at]]
    for _ in range(MIRROR_RAYS):
        turned = normal + MIRROR_LOBE * rng.standard_normal(normal.shape, np.float32)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        away = 2 * (turned * towards).sum(1, keepdims=True) * turned - towards
        # From above the noise of the surface, or it would mirror itself.
        start = samples.position[at] + 2 * samples.footprint[at, None] * normal
        hit = problem.tracer.hit_faces(start, away)
        leaves = (away * normal).sum(1) > 0
        cosine = np.clip((turned * towards).sum(1), 1e-3, 1.0)
        reflectance = DIELECTRIC_F0 + (1 - DIELECTRIC_F0) * grazing_fresnel(cosine)
        bright = reflectance * level[hit] * np.where(clipped[hit], MIRROR_HEADROOM, 1.0) > level[face]
        mirrors |= leaves & (hit >= 0) & emitting[hit] & bright
    count, mirroring = np.bincount(face, minlength=n_faces), np.bincount(face, mirrors, n_faces)
    highlight = mirroring > (1 - VIEW_QUANTILE) * count
    # The rim of a highlight, which the lobe just misses, belongs to it.
    a, b = problem.adjacency
    joined = emitting[a] & emitting[b] & problem.scanned[a] & problem.scanned[b]
    label = component_labels(n_faces, a[joined], b[joined])
    whole = np.bincount(label, count * highlight) > HIGHLIGHT_MIN_SHARE * np.bincount(label, count)
    return emitting & ~highlight & ~whole[label]
