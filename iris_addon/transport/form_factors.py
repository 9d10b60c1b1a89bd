"""Form factors of lamps: ``B`` of equation (1), by shadow rays to them and the gather rays that meet them.

Both ways to find an emitter are combined by the balance heuristic (Veach 1997, eq. 9.8), equation (8): area sampling
alone is noisy beside a large window, cosine sampling alone misses small lamps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Integer, Real, inlined, kernel, rows_of
from ..base.group_by import entries_of
from ..base.parallel import BLOCK, over_each, random_blocks
from ..base.progress import Progress
from ..brdf.diffuse import schlick
from ..rays.sampling import Origins, Vector, grazing, r2_sequence, vector
from ..rays.tracer import Tracer
from .gather import GatherRays

Pattern = Callable[[NDArray[np.floating]], NDArray[np.float32]]
"""How bright an emitter is at points (n, 3) on it, over its mean, (n,)."""
Profiles = Callable[[NDArray[np.floating]], NDArray[np.floating]]
"""How bright an emitter is at cosines (n,) of the angle to its normal, (n, K) for K profiles at once."""
POINT_SETS = 1024
"""Sets of points on an emitter, of which each patch takes one at random. To draw points anew for each patch would cost
as much as its rays; of the neighbouring patches that noise is averaged over, hardly two share a set."""
MIN_COSINE = 1e-4
"""Least cosine at either end of a ray to a point on a light source."""


def emitter_of_face(emitters: Sequence[NDArray[np.integer]], n_faces: int) -> NDArray[np.int64]:
    """(F + 1,) index of the emitter of each face, -1 for none; the last entry, for rays that meet no face, is -1."""
    label = np.full(n_faces + 1, -1, np.int64)
    for index, faces in enumerate(emitters):
        label[faces] = index
    return label


def emitter_form_factors(
    tracer: Tracer,
    origins: Origins,
    rays: GatherRays,
    emitters: Sequence[NDArray[np.integer]],
    n_samples: int,
    rng: np.random.Generator,
    progress: Progress,
    patterns: Mapping[int, Pattern] = MappingProxyType({}),
) -> NDArray[np.float32]:
    """``B`` (P, E, 2): the visible share of a patch's cosine-weighted hemisphere that each emitter fills, and the same
    weighted by Schlick's S, for diffuse lobes (:func:`iris_addon.brdf.diffuse.under_lobe`).

    Args:
        origins, rays: of the P patches.
        emitters: face indices of each emitter.
        n_samples: points sampled on each emitter per patch, before patches that cannot see it are left out.
        patterns: of emitters that are not equally bright everywhere, by their number; B is then weighted by it.
    """
    n, n_rays = rays.face.shape
    result = np.zeros((n, len(emitters), 2), np.float32)
    if not emitters:
        return result
    gathered = _gathered(tracer, origins, rays, emitters, n_samples)
    for k in range(len(emitters)):
        gathered.of(k).add_to(result[:, k : k + 1], n_rays, patterns.get(k))
    # One job per lamp and block of patches, so that all cores are busy where either are few.
    generators = rng.spawn(2 * len(emitters))
    points = over_each(
        range(len(emitters)),
        lambda k: _EmitterPoints.draw(tracer, emitters[k], n_samples, generators[2 * k]).under(patterns.get(k)),
    )
    jobs = [
        (k, rows, generator)
        for k in range(len(emitters))
        for rows, generator in random_blocks(n, BLOCK // n_samples, generators[2 * k + 1])
    ]

    def add(job: tuple[int, slice, np.random.Generator]) -> None:
        k, rows, generator = job
        _add_sampled(result[rows, k : k + 1], tracer, origins, rows, points[k], n_rays, generator)

    over_each(jobs, add, progress.update)
    return result


def profile_form_factors(
    tracer: Tracer,
    origins: Origins,
    rays: GatherRays,
    faces: NDArray[np.integer],
    n_samples: int,
    rng: np.random.Generator,
    profiles: Profiles,
) -> NDArray[np.float32]:
    """(P, K, 2) form factors of one emitter of ``faces`` with each of K ``profiles``, by the same rays."""
    n, n_rays = rays.face.shape
    result = np.zeros((n, profiles(np.ones(1)).shape[1], 2), np.float32)
    _gathered(tracer, origins, rays, [faces], n_samples).add_to(result, n_rays, profiles=profiles)
    of_points, of_rays = rng.spawn(2)
    points = replace(_EmitterPoints.draw(tracer, faces, n_samples, of_points), profiles=profiles)

    def add(job: tuple[slice, np.random.Generator]) -> None:
        rows, generator = job
        _add_sampled(result[rows], tracer, origins, rows, points, n_rays, generator)

    over_each(list(random_blocks(n, BLOCK // n_samples, of_rays)), add)
    return result


@dataclass(frozen=True)
class _Gathered:
    """The m gather rays that hit emitters, weighed against area samples.

    Attributes:
        row: (m,) the patch that each starts from.
        emitter: (m,) the emitter that it meets.
        weight: (m,) by the balance heuristic.
        end: (m, 3) metres.
        cos_surface, cos_light: (m,) at either end.
    """

    row: NDArray[np.int64]
    emitter: NDArray[np.int64]
    weight: NDArray[np.floating]
    end: NDArray[np.floating]
    cos_surface: NDArray[np.floating]
    cos_light: NDArray[np.floating]

    def of(self, emitter: int) -> _Gathered:
        """The rays that meet one emitter."""
        on = np.flatnonzero(self.emitter == emitter)
        names = (field.name for field in fields(self))
        return _Gathered(**{name: getattr(self, name)[on] for name in names})

    def add_to(
        self,
        columns: NDArray[np.float32],
        n_rays: int,
        pattern: Pattern | None = None,
        profiles: Profiles | None = None,
    ) -> None:
        """Add all of them, of ``n_rays`` per patch, to the form factors ``columns`` (P, K, 2)."""
        share = np.ones((len(self.row), 1), np.float32) if profiles is None else profiles(self.cos_light)
        if pattern is not None:
            share = share * pattern(self.end)[:, None]
        for kind, factor in enumerate(with_schlick(self.cos_surface).T):
            for k, each in enumerate(share.T):
                weight = self.weight * each / n_rays * factor
                columns[:, k, kind] += np.bincount(self.row, weight, minlength=len(columns))


def _gathered(
    tracer: Tracer,
    origins: Origins,
    rays: GatherRays,
    emitters: Sequence[NDArray[np.integer]],
    n_samples: int,
) -> _Gathered:
    """The gather rays that hit one of ``emitters``, weighed against ``n_samples`` points on it."""
    n_rays = rays.face.shape[1]
    area = np.array([tracer.areas[faces].sum() for faces in emitters], np.float32)
    label = emitter_of_face(emitters, len(tracer.areas))
    row, column = entries_of(rays.face, label >= 0)
    face = rays.face[row, column]
    emitter = label[face]
    direction, distance = rays.direction[row, column].astype(np.float32), rays.distance[row, column]
    cos_light = np.abs((tracer.normals[face] * direction).sum(1))
    start = row, column % origins.normal.shape[1]
    cos_surface = np.abs((origins.normal[start] * direction).sum(1))
    per_area = cos_surface * cos_light / np.maximum(np.pi * distance**2, 1e-9)
    return _Gathered(
        row=row,
        emitter=emitter,
        weight=n_rays * per_area / (n_rays * per_area + n_samples / area[emitter]),
        end=origins.position[start] + direction * distance[:, None],
        cos_surface=cos_surface,
        cos_light=cos_light,
    )


def with_schlick(cosine: NDArray[np.floating]) -> NDArray[np.floating]:
    """(n, 2) the number 1 and Schlick's S of the cosines (n,)."""
    return np.stack([np.ones_like(cosine), schlick(cosine)], -1)


@dataclass(frozen=True)
class _EmitterPoints:
    """Points spread over one emitter: POINT_SETS sets of ``n_samples``, each spread over it on its own.

    Attributes:
        position, normal: (POINT_SETS · n_samples, 3) float32 metres, and unit.
        n_samples: points of each set.
        area: of the emitter, square metres.
        share: (POINT_SETS · n_samples,) float32 how bright the emitter is there, over its mean.
        profiles: how bright it is by the angle to its normal; None where alike.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    n_samples: int
    area: float
    share: NDArray[np.float32]
    profiles: Profiles | None = None

    @staticmethod
    def draw(tracer: Tracer, faces: NDArray[np.integer], n_samples: int, rng: np.random.Generator) -> _EmitterPoints:
        """Points on an emitter of ``faces``.

        Faces are chosen in order of area, and any run of the R2 sequence is evenly spread: so are the points of a set.
        """
        cumulative = np.cumsum(tracer.areas[faces])
        strata = (np.arange(n_samples) + rng.random((POINT_SETS, n_samples))) * (cumulative[-1] / n_samples)
        pick = faces[np.minimum(np.searchsorted(cumulative, strata, side="right"), len(faces) - 1)]
        u = r2_sequence(POINT_SETS, n_samples, rng)
        u = np.where(u.sum(-1, keepdims=True) > 1, 1 - u, u)
        corner, second, third = np.moveaxis(tracer.corners[pick].astype(np.float32), 2, 0)
        position = corner + u[..., :1] * (second - corner) + u[..., 1:] * (third - corner)
        return _EmitterPoints(
            position=position.reshape(-1, 3),
            normal=tracer.normals[pick.ravel()],
            n_samples=n_samples,
            area=float(np.float32(tracer.areas[faces].sum())),
            share=np.ones(pick.size, np.float32),
        )

    def under(self, pattern: Pattern | None) -> _EmitterPoints:
        """The points of an emitter with that pattern."""
        return self if pattern is None else replace(self, share=pattern(self.position))

    def share_of(self, rays: ShadowRays) -> NDArray[np.float32]:
        """(m, K) how bright the emitter is at the ends of m ``rays``, towards their starts."""
        share = self.share[rays.pick][:, None]
        return share if self.profiles is None else (share * self.profiles(rays.cos_light)).astype(np.float32)


def _add_sampled(
    columns: NDArray[np.float32],
    tracer: Tracer,
    origins: Origins,
    rows: slice,
    points: _EmitterPoints,
    n_rays: int,
    rng: np.random.Generator,
) -> None:
    """Add shadow rays from the patches ``rows`` to one emitter to ``columns`` (n, K, 2), its form factors there.

    Args:
        n_rays: gather rays of a patch, which may find the emitter as well.
    """
    shadow = ShadowRays.empty(len(columns) * points.n_samples)
    chosen = rng.integers(POINT_SETS, size=len(columns))
    ends = points.position, points.normal, chosen, points.n_samples
    count = _toward_points(*origins.flat(rows), tracer.epsilon, *ends, shadow)
    shadow = rows_of(shadow, slice(count))
    clear = tracer.unoccluded(shadow.start, shadow.along, shadow.length)
    _add_visible(shadow, clear, points.share_of(shadow), points.area, n_rays, points.n_samples, columns)


class ShadowRays(NamedTuple):
    """n rays from patches to points on light sources.

    Attributes:
        start, along: (n, 3) float32 metres, and unit.
        length: (n,) float32 metres.
        row: (n,) int32 the patch that each starts from.
        pick: (n,) int32 the point that each goes to.
        cos_surface, cos_light: (n,) float32 at either end.
    """

    start: NDArray[np.float32]
    along: NDArray[np.float32]
    length: NDArray[np.float32]
    row: NDArray[np.int32]
    pick: NDArray[np.int32]
    cos_surface: NDArray[np.float32]
    cos_light: NDArray[np.float32]

    @staticmethod
    def empty(n: int) -> ShadowRays:
        """Uninitialised rays."""
        start, along = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        row, pick = np.empty(n, np.int32), np.empty(n, np.int32)
        length, cos_surface, cos_light = (np.empty(n, np.float32) for _ in range(3))
        return ShadowRays(start, along, length, row, pick, cos_surface, cos_light)


@inlined
def aim_at_point(
    shadow: ShadowRays, at: Integer, origin: Vector, n: Vector, epsilon: Real, point: Vector, m: Vector
) -> bool:
    """Fill row ``at`` with the ray from ``origin``, of normal ``n``, to ``point``, of normal ``m``; returns whether
    both lie in front of each other."""
    ox, oy, oz = origin[0] + epsilon * n[0], origin[1] + epsilon * n[1], origin[2] + epsilon * n[2]
    dx, dy, dz = point[0] - ox, point[1] - oy, point[2] - oz
    length = math.sqrt(max(dx * dx + dy * dy + dz * dz, 1e-9))
    dx, dy, dz = dx / length, dy / length, dz / length
    shadow.start[at, 0], shadow.start[at, 1], shadow.start[at, 2] = ox, oy, oz
    shadow.along[at, 0], shadow.along[at, 1], shadow.along[at, 2] = dx, dy, dz
    shadow.length[at] = length
    cos_surface = dx * n[0] + dy * n[1] + dz * n[2]
    cos_light = -(dx * m[0] + dy * m[1] + dz * m[2])
    shadow.cos_surface[at], shadow.cos_light[at] = cos_surface, cos_light
    return cos_surface > MIN_COSINE and abs(cos_light) > MIN_COSINE


@kernel
def _toward_points(
    position: NDArray[np.float32],
    normal: NDArray[np.float32],
    per_patch: int,
    epsilon: float,
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    chosen: NDArray[np.integer],
    n_samples: int,
    shadow: ShadowRays,
) -> int:
    """Fill ``shadow`` with the rays from n patches to the set of points that each has ``chosen`` (n,); returns
    how many.

    Args:
        position, normal: (n · per_patch, 3) points on the patches.
        points, normals: (POINT_SETS · n_samples, 3) on the emitter.
    """
    count = 0
    for p in range(len(chosen)):
        for s in range(n_samples):
            start, end = p * per_patch + s % per_patch, chosen[p] * n_samples + s
            origin, n = vector(position, start), vector(normal, start)
            if aim_at_point(shadow, count, origin, n, epsilon, vector(points, end), vector(normals, end)):
                shadow.row[count], shadow.pick[count] = p, end
                count += 1
    return count


@kernel
def _add_visible(
    shadow: ShadowRays,
    clear: NDArray[np.bool_],
    share: NDArray[np.float32],
    area: float,
    n_rays: int,
    n_samples: int,
    columns: NDArray[np.float32],
) -> None:
    """Add the rays that are ``clear`` (m,) to ``columns`` (n, K, 2), by the balance heuristic against the gather rays.

    Args:
        share: (m, K) how bright the emitter is at the end of each ray, towards its start.
    """
    for i in range(len(clear)):
        if clear[i]:
            cosine = shadow.cos_surface[i]
            per_area = cosine * abs(shadow.cos_light[i]) / (math.pi * shadow.length[i] ** 2)
            value = per_area / (n_samples / area + n_rays * per_area)
            for k in range(share.shape[1]):
                columns[shadow.row[i], k, 0] += value * share[i, k]
                columns[shadow.row[i], k, 1] += value * share[i, k] * grazing(cosine)
