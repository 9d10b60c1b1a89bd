"""Where the sun stands: the direction whose visibility explains the patches of light that nothing else does.

For a direction s, light of a sun there reaches what sees s through the openings of the mesh. Given the light and the
albedo found without a sun, each surface says how well it agrees: log L against log a (I + E V cos θ / π), with V the
visibility of s and E the sun's irradiance. Directions through which gather rays escape are tried first, on one point
per patch (:func:`_screened`). The borders of the patches of light then give the direction to a tenth of a degree, on
single pixels that see some of the directions under test and not others (:func:`refined`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..base.group_by import group_medians
from ..base.parallel import over_each
from ..base.random_streams import stream
from ..model.response import LUMINANCE
from ..model.sphere import even_directions
from ..rays.tracer import Tracer
from ..response.radiance import GroupRadiance
from ..surface.photo_samples import ShownPixels
from ..transport.gather import ESCAPED
from .lamp_radiance import patch_weight, patches_on
from .problem import LightProblem, Lights
from .sun import MIN_COSINE, pixel_visibility

SCREENED_DIRECTIONS = 5000
"""Directions of the sphere that are tried, 2.9 degrees apart: a window one metre wide casts a patch of light that moves
by a tenth of its width between two of them."""
SCREENED_PATCHES = 4000
"""Patches at most on which directions are tried."""
SCREENED_KEPT, SCREENED_APART = 3, np.radians(6.0)
"""Best directions that are refined, and the angle between them at least."""
STRENGTHS = 2.0 ** np.arange(-1, 10)
"""Irradiance of the sun that is tried, times that in the median patch."""
SUN_ROBUST_LOG = 0.3
"""Deviation of log radiance at which a surface starts to count as an outlier in the search."""
GRIDS = ((2.6, 21), (0.45, 13), (0.1, 9))
"""Half the width of each finer grid of directions, degrees, and directions along its side. The first is dense enough
for the slats of a blind, whose stripes fit again one stripe further."""
GRID_MOVES = 3
"""Times that a grid is centred again on its best direction, as long as that lies at its edge."""
REFINED_POOL, REFINED_PIXELS = 60_000, 3000
"""Pixels that are looked through for such as tell directions apart, and of those used at most."""
MIN_LIT_PIXELS = 50
"""Pixels that tell directions apart below which there is no border to fit."""


@dataclass(frozen=True)
class SunGuess:
    """A direction to the sun, (3,) unit, the irradiance (3,) there, and what it explains of the loss of the search."""

    direction: NDArray[np.float64]
    irradiance: NDArray[np.float64]
    gain: float


@dataclass(frozen=True)
class LitPoints:
    """Surface points that are asked for sunlight.

    Attributes:
        level: (n,) log of the light that is there without the sun, irradiance / pi.
        needed: (n,) log luminance over albedo: the log light that the photos show, or a bound on it.
        clipped: (n,) bool, whether it is a bound.
        weight: (n,) statistical weight.
    """

    level: NDArray[np.float64]
    needed: NDArray[np.float64]
    clipped: NDArray[np.bool_]
    weight: NDArray[np.float64]

    def loss(self, rows: NDArray[np.integer]) -> float:
        """Robust loss at ``rows`` (m,) without a sun."""
        return float(self.weight[rows] @ self._loss(rows, self.level[rows]))

    def gain(self, rows: NDArray[np.integer], sunlight: NDArray[np.floating]) -> float:
        """Fall of the robust loss by ``sunlight`` (m,), irradiance / pi, at ``rows`` (m,)."""
        level = self.level[rows]
        before = self._loss(rows, level)
        return float(self.weight[rows] @ (before - self._loss(rows, np.log(np.exp(level) + sunlight))))

    def _loss(self, rows: NDArray[np.integer], light: NDArray[np.floating]) -> NDArray[np.float64]:
        off = self.needed[rows] - light
        off = np.where(self.clipped[rows], np.maximum(off, 0), off)
        return np.log1p((off / SUN_ROBUST_LOG) ** 2)


def find_suns(
    problem: LightProblem, tracer: Tracer, observed: GroupRadiance, lights: Lights, shown: ShownPixels
) -> list[SunGuess]:
    """Directions to the sun that explain most of what ``lights`` leave unexplained, the best first.

    Args:
        tracer: of what casts shadows.
        lights: without a sun; irradiance of the sun is given where they have one.
        shown: the pixels of ``problem``.
    """
    points = lit_pixels(problem, lights, shown)
    guesses = [refined(problem, tracer, points, guess) for guess in _screened(problem, tracer, observed, lights)]
    return sorted((guess for guess in guesses if guess is not None), key=lambda guess: -guess.gain)


def _screened(problem: LightProblem, tracer: Tracer, observed: GroupRadiance, lights: Lights) -> list[SunGuess]:
    """The best directions on a coarse grid, by patches; none where none explains enough to be looked at closer."""
    n, origins = problem.transport.n_seen, problem.transport.origins
    clipped = ~observed.known.all(1)
    radiance = np.where(observed.known, observed.radiance, observed.bound)
    weight = np.where(patches_on(problem, lights.mask)[:n] | (radiance.min(1) <= 0), 0, patch_weight(problem, observed))
    # Patches that are clipped carry no weight of pixels, but show sunlight more than any.
    weight = np.where(clipped & (radiance.min(1) > 0), np.median(weight[weight > 0]), weight)
    rows = np.flatnonzero(weight > 0)
    if len(rows) > SCREENED_PATCHES:
        rows = rows[np.linspace(0, len(rows) - 1, SCREENED_PATCHES).astype(np.int64)]
    shown = np.asarray(radiance @ LUMINANCE, np.float64)
    points = _points(shown, lights.irradiance[:n] @ LUMINANCE, clipped, weight, problem.surface.region)
    start = (origins.position[rows, 0] + tracer.epsilon * origins.normal[rows, 0]).astype(np.float32)
    normal = origins.normal[rows, 0]
    unit = float(np.median(np.exp(points.level[rows])))

    def tried(direction: NDArray[np.float64]) -> tuple[float, NDArray[np.float64], float]:
        """What a sun there explains at its best strength, and that."""
        cosine = normal @ direction.astype(np.float32)
        facing = np.flatnonzero(cosine > MIN_COSINE)
        along = np.broadcast_to(direction.astype(np.float32), (len(facing), 3))
        lit = facing[tracer.unoccluded(start[facing], along, np.full(len(facing), np.inf))]
        gains = [points.gain(rows[lit], unit * s * cosine[lit]) for s in STRENGTHS]
        return max(gains), direction, np.pi * unit * STRENGTHS[int(np.argmax(gains))]

    kept: list[SunGuess] = []
    found = sorted(over_each(list(_escaping_directions(problem)), tried), key=lambda each: -each[0])
    without = points.loss(rows)
    if not found or not problem.decisions.accept("sun_candidate", without, without - found[0][0]):
        return []
    for gain, direction, strength in found:
        if gain > 0 and all(direction @ other.direction < np.cos(SCREENED_APART) for other in kept):
            kept.append(SunGuess(direction, np.full(3, strength), gain))
        if len(kept) == SCREENED_KEPT:
            break
    return kept


def _escaping_directions(problem: LightProblem) -> NDArray[np.float64]:
    """(m, 3) directions of an even grid near which a gather ray of a seen patch leaves the room."""
    grid = even_directions(SCREENED_DIRECTIONS)
    t = problem.transport
    row, ray = np.nonzero(t.target == ESCAPED)
    nearest = cKDTree(grid).query(t.rays.direction[row, ray].astype(np.float64), workers=-1)[1]
    return grid[np.unique(nearest)]


def _points(
    luminance: NDArray[np.floating],
    light: NDArray[np.floating],
    clipped: NDArray[np.bool_],
    weight: NDArray[np.floating],
    region: NDArray[np.integer],
) -> LitPoints:
    """Points (n,) with the albedo of their region taken off: the median over its unclipped ones."""
    level = np.log(np.maximum(light, 1e-6))
    albedo = np.log(np.maximum(luminance, 1e-6)) - level
    by = np.flatnonzero(~clipped & (weight > 0))
    n_regions = int(region.max()) + 1
    typical = group_medians(albedo[by, None], region[by], n_regions)[:, 0]
    counted = np.bincount(region[by], minlength=n_regions) > 0
    typical = np.where(counted, typical, np.median(albedo[by]) if len(by) else 0.0)
    return LitPoints(level, albedo + level - typical[region], clipped, weight)


# ---- To a tenth of a degree, by pixels -----------------------------------------------------------------------------


def lit_pixels(problem: LightProblem, lights: Lights, shown: ShownPixels) -> LitPoints:
    """The pixels of ``problem`` as points that are asked for sunlight; those on lamps have no weight.

    Args:
        lights: irradiance without a sun.
    """
    patch = problem.surface.sample_patch
    return _points(
        shown.luminance,
        (lights.irradiance[: problem.transport.n_seen] @ LUMINANCE)[patch],
        shown.clipped,
        (shown.usable & ~lights.mask[problem.samples.face]).astype(np.float64),
        problem.surface.region[patch],
    )


def refined(problem: LightProblem, tracer: Tracer, points: LitPoints, guess: SunGuess) -> SunGuess | None:
    """The direction near ``guess`` that the borders of sunlight agree with best; None where there are none.

    Args:
        points: the pixels of ``problem``, of :func:`lit_pixels`.
    """
    samples, rng = problem.samples, stream(problem.seed, "lighting.sun_pixels")
    done = 0.0  # the width of the grid that no longer moves
    direction, strength, gain = guess.direction, float(guess.irradiance @ LUMINANCE), -np.inf
    pool = np.flatnonzero((points.weight > 0) & (samples.normal @ direction.astype(np.float32) > MIN_COSINE))
    if len(pool) > REFINED_POOL:
        pool = np.sort(rng.choice(pool, REFINED_POOL, replace=False))
    for half, side in (grid for grid in GRIDS for _ in range(GRID_MOVES)):
        if half == done:
            continue
        across = np.linalg.svd(direction[None])[2][1:]
        telling = _telling_apart(tracer, problem, direction, np.radians(half) * across, pool)
        if len(telling) < MIN_LIT_PIXELS:
            break
        if len(telling) > REFINED_PIXELS:
            telling = np.sort(rng.choice(telling, REFINED_PIXELS, replace=False))
        steps = np.radians(np.linspace(-half, half, side))
        tried = direction + (np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2) @ across)
        tried /= np.linalg.norm(tried, axis=1, keepdims=True)
        strengths = strength * 2.0 ** np.arange(-1.0, 1.5, 0.5)

        def explained(one: NDArray[np.float64], by: NDArray = strengths, of: NDArray = telling) -> list[float]:
            """What a sun there explains at each strength."""
            lit = of[pixel_visibility(tracer, samples, one, of) > 0]
            cosine = samples.normal[lit] @ one.astype(np.float32)
            return [points.gain(lit, s / np.pi * cosine) for s in by]

        gains = np.array(over_each(list(tried), explained))
        at, level = np.unravel_index(int(np.argmax(gains)), gains.shape)
        if tried[at] @ direction > np.cos(np.radians(0.8 * half)):
            done = half
        gain, direction, strength = float(gains[at, level]), tried[at], float(strengths[level])
    if not np.isfinite(gain):
        return None
    return SunGuess(direction, guess.irradiance * (strength / float(guess.irradiance @ LUMINANCE)), gain)


def _telling_apart(
    tracer: Tracer,
    problem: LightProblem,
    direction: NDArray[np.float64],
    steps: NDArray[np.float64],
    pool: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Those of the pixels ``pool`` that see some of the directions around ``direction`` and not others.

    Args:
        steps: (2, 3) to the edges of the square of directions.
    """
    offsets = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    seen = np.zeros(len(pool))
    for a, b in offsets:
        one = direction + a * steps[0] + b * steps[1]
        seen += pixel_visibility(tracer, problem.samples, one / np.linalg.norm(one), pool)
    return pool[(seen > 0) & (seen < len(offsets))]
