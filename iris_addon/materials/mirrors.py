"""Mirrors: metals whose reflection is as sharp as photos tell.

The fit of gloss compares patches, and no roughness below the least of its levels blurs a reflection by less than a
patch. Pixels are finer. What a photo shows in a mirror, some photo shows directly where the line of sight arrives after
its reflection. Pixels of a smooth metal are predicted by those nearest to that point, and by the mean of those within
the lobe that the fit has found; :mod:`iris_addon.decide` compares the errors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..base.group_by import thinned
from ..decide import Decisions, HeldOutLosses
from ..rays.sampling import dot, r2_sequence
from ..rays.tracer import Tracer, points_on_faces
from ..surface.photo_samples import ShownPixels
from ..surface.primary_rays import PixelSamples
from .gloss import Gloss

SMOOTH = 0.15
"""Roughness of a metal below which it may be a mirror."""
MIN_PIXELS, MAX_PIXELS = 60, 1500
"""Pixels of a region on which it is asked: with fewer it stays as it is, of more that many are taken."""
LOBE_RAYS = 16
"""Reflected rays in the lobe of a pixel."""
KNOWN_RAYS = 0.75
"""Share of them that has to end where a photo looks directly."""
NEAREST, REACH = 3, 0.05
"""Pixels that show the end of a ray, and their distance from it, at most, metres."""
SEEN_PIXELS = 2_000_000
"""Pixels that such ends are looked up among, at most."""
ROBUST_LOG = 0.1
"""Error of a predicted log luminance at which it starts to count as an outlier."""
PLACES = 400
"""Pixels of a region that err independently, at most: each shows another place of the room."""
TINY = 1e-6


def with_mirrors(
    gloss: Gloss,
    tracer: Tracer,
    samples: PixelSamples,
    shown: ShownPixels,
    region: NDArray[np.integer],
    rng: np.random.Generator,
    decisions: Decisions,
) -> Gloss:
    """``gloss`` with a roughness of 0 where a smooth metal is a mirror.

    Args:
        samples: the n pixels on the mesh; ``shown``, what photos show there.
        region: (n,) of each.
    """
    smooth = smooth_metals(gloss)
    if decisions.forbids("mirror") or not len(smooth):
        return gloss
    told = shown.usable & ~shown.clipped
    asked = _pixels_of(smooth, region, told)
    direct = np.flatnonzero(shown.usable & ~np.isin(region, smooth))
    if not len(asked) or len(direct) < NEAREST:
        return gloss
    direct = direct[:: 1 + len(direct) // SEEN_PIXELS]
    # Beside a lamp that clips, its surroundings are not what a ray shows.
    level = np.where(shown.clipped, np.nan, shown.luminance)[direct]
    tree = cKDTree(samples.position[direct])
    roughness = gloss.roughness.copy()
    for number in np.unique(region[asked]):
        own = asked[region[asked] == number]
        if len(own) < MIN_PIXELS:
            continue
        pixels, seen = samples.take(own), np.log(np.maximum(shown.luminance[own], TINY))
        losses = []
        for alpha in (float(roughness[number]) ** 2, 0.0):
            reflected = _reflected(pixels, alpha, 1 if alpha == 0 else LOBE_RAYS, rng)
            losses.append(_loss(seen, _shown_at_ends(tracer, pixels, reflected, tree, level)))
        known = np.flatnonzero(np.isfinite(losses).all(0))
        if len(known) < MIN_PIXELS:
            continue
        blurred, sharp = (HeldOutLosses(known, loss[known], np.ones(len(known)), PLACES) for loss in losses)
        figures = float(blurred.loss.mean()), float(sharp.loss.mean()), blurred.paired_error(sharp)
        if decisions.accept("mirror", *figures, subject=f"region {number}"):
            roughness[number] = 0.0
    return replace(gloss, roughness=roughness)


def smooth_metals(gloss: Gloss) -> NDArray[np.int64]:
    """Regions of metal that may be mirrors."""
    return np.flatnonzero((gloss.metallic > 0.5) & (gloss.roughness < SMOOTH))


def _pixels_of(regions: NDArray[np.int64], region: NDArray[np.integer], usable: NDArray[np.bool_]) -> NDArray[np.int64]:
    """``usable`` pixels of the ``regions``, an even selection of each."""
    rows = np.flatnonzero(usable & np.isin(region, regions))
    step = 1 + np.bincount(region[rows], minlength=int(regions.max()) + 1) // MAX_PIXELS
    return thinned(rows, region, step)


def _reflected(pixels: PixelSamples, alpha: float, n_rays: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(k, n_rays, 3) unit directions of lines of sight reflected off GGX normals of width ``alpha``."""
    normal, toward = pixels.normal.astype(np.float64), pixels.direction.astype(np.float64)
    across = np.cross(normal, np.where(np.abs(normal[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    u, v = np.moveaxis(r2_sequence(len(normal), n_rays, rng).astype(np.float64), -1, 0)
    slope, angle = alpha * np.sqrt(u / (1 - u)), 2 * np.pi * v
    half = normal[:, None] + slope[..., None] * (
        np.cos(angle)[..., None] * across[:, None] + np.sin(angle)[..., None] * np.cross(normal, across)[:, None]
    )
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    return 2 * np.einsum("kra,ka->kr", half, toward)[..., None] * half - toward[:, None]


def _shown_at_ends(
    tracer: Tracer,
    pixels: PixelSamples,
    reflected: NDArray[np.float64],
    tree: cKDTree,
    level: NDArray[np.floating],
) -> NDArray[np.float64]:
    """(k,) mean luminance of what photos show directly where ``reflected`` rays (k, r, 3) of pixels end; NaN where too
    few of them end where a photo looks.

    Args:
        tree: of the places of pixels with the luminance ``level``, NaN where they clip.
    """
    n_rays = reflected.shape[1]
    along = reflected.reshape(-1, 3)
    normal = np.repeat(pixels.normal.astype(np.float64), n_rays, axis=0)
    start = np.repeat(pixels.position.astype(np.float64), n_rays, axis=0) + 2 * tracer.epsilon * normal
    hits = tracer.closest(start, along)
    met = np.flatnonzero((hits.face >= 0) & (dot(along, normal) > 0))
    ends = points_on_faces(tracer.corners, hits.face[met], hits.barycentric[met])
    distance, near = tree.query(ends, k=NEAREST, distance_upper_bound=REACH, workers=-1)
    seen = np.full(len(along), np.nan)
    found = np.isfinite(distance).all(1)
    seen[met[found]] = level[near[found]].mean(1)
    seen = seen.reshape(-1, n_rays)
    known = np.isfinite(seen)
    mean = np.where(known, seen, 0.0).sum(1) / np.maximum(known.sum(1), 1)
    return np.where(known.mean(1) >= KNOWN_RAYS, mean, np.nan)


def _loss(seen: NDArray[np.floating], predicted: NDArray[np.floating]) -> NDArray[np.float64]:
    """(k,) robust loss of log luminance but for a common factor, which is the metal's reflectance."""
    deviation = seen - np.log(np.maximum(predicted, TINY))
    known = np.isfinite(deviation)
    middle = np.median(deviation[known]) if known.any() else 0.0
    return np.log1p(((deviation - middle) / ROBUST_LOG) ** 2)
