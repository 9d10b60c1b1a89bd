"""Light that arrives at patches: gather rays to other patches, and area sampling of emitters with shadow rays.

With L the radiance per patch and e the radiance per emitter, irradiance / pi is ``Ld = G L + B e`` (+ light from
outside through the rays that escape). ``G`` is kept as the hit patch of every ray. ``B`` combines both ways to find an
emitter, the gather rays that happened to hit it and points sampled on it, with the balance heuristic (Veach 1997,
eq. 9.8): area sampling alone is noisy next to a large window, cosine sampling alone misses small lamps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..parallel import BLOCK, over_random_blocks
from ..progress import Progress
from .diffuse import schlick
from .sampling import cosine_directions, dot, r2_sequence
from .tracer import Tracer

POINT_SETS = 1024
"""Sets of points on an emitter, of which every patch takes one at random. Drawing points anew for each patch costs as
much as its rays; of patches near each other, over which noise is averaged, hardly two share a set."""


@dataclass(frozen=True)
class Origins:
    """Points on patches from which rays start: ``k`` per patch, picked among the pixels that saw the patch.

    Attributes:
        position: (P, k, 3) float32 metres.
        normal: (P, k, 3) float32 unit, on the visible side.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]


@dataclass(frozen=True)
class GatherRays:
    """Cosine-distributed rays from every patch and what they hit.

    Attributes:
        face: (P, R) int32 face, -1 where the ray escaped.
        direction: (P, R, 3) float16 unit direction, away from the patch.
        distance: (P, R) float32 metres.
        schlick_start, schlick_end: (P, R) float16 Schlick's S of the angles at which a ray leaves and arrives.
    """

    face: NDArray[np.int32]
    direction: NDArray[np.float16]
    distance: NDArray[np.float32]
    schlick_start: NDArray[np.float16]
    schlick_end: NDArray[np.float16]


def ray_origins(origins: Origins, rows: slice, n_rays: int, epsilon: float) -> tuple[NDArray, NDArray]:
    """Positions off the surface and normals, each (rows · n_rays, 3), cycling over a patch's points."""
    k = origins.position.shape[1]
    which = np.arange(n_rays) % k
    normal = origins.normal[rows, which].reshape(-1, 3)
    return origins.position[rows, which].reshape(-1, 3) + epsilon * normal, normal


def gather(
    tracer: Tracer, origins: Origins, n_rays: int, rng: np.random.Generator, progress: Progress
) -> tuple[GatherRays, NDArray[np.float32]]:
    """Trace ``n_rays`` cosine-distributed rays from every patch.

    Returns:
        The rays, and the points they hit, (P, R, 3) metres (the origin where a ray escaped).
    """
    n = len(origins.position)
    face = np.empty((n, n_rays), np.int32)
    point = np.empty((n, n_rays, 3), np.float32)
    direction = np.empty((n, n_rays, 3), np.float16)
    distance = np.empty((n, n_rays), np.float32)
    schlick_start = np.empty((n, n_rays), np.float16)
    schlick_end = np.empty((n, n_rays), np.float16)

    def work(rows: slice, rng: np.random.Generator) -> None:
        position, normal = ray_origins(origins, rows, n_rays, tracer.epsilon)
        d = cosine_directions(normal, r2_sequence(rows.stop - rows.start, n_rays, rng).reshape(-1, 2))
        hits = tracer.closest(position, d)
        face[rows] = hits.face.reshape(-1, n_rays)
        reach = np.where(hits.face < 0, 0, hits.distance)
        point[rows] = (position + d * reach[:, None]).reshape(-1, n_rays, 3)
        direction[rows] = d.reshape(-1, n_rays, 3)
        distance[rows] = hits.distance.reshape(-1, n_rays)
        schlick_start[rows] = schlick(dot(d, normal)).reshape(-1, n_rays)
        schlick_end[rows] = schlick(np.abs(dot(d, tracer.normals[hits.face]))).reshape(-1, n_rays)

    over_random_blocks(n, BLOCK // n_rays, work, rng, progress.update)
    return GatherRays(face, direction, distance, schlick_start, schlick_end), point


def emitter_of_face(emitters: Sequence[NDArray[np.integer]], n_faces: int) -> NDArray[np.int64]:
    """(F + 1,) index of the emitter each face belongs to, else -1; the last entry is that of no face at all, -1."""
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
) -> NDArray[np.float32]:
    """``B`` (P, E, 2): the share of a patch's cosine-weighted hemisphere that each emitter fills, with visibility,
    and the same weighted by Schlick's S, for diffuse lobes (:func:`iris_addon.transport.diffuse.under_lobe`).

    Args:
        emitters: face indices of each emitter.
        n_samples: points sampled on each emitter per patch, before patches that cannot see it are left out.
    """
    n, n_rays = rays.face.shape
    result = np.zeros((n, len(emitters), 2), np.float32)
    if not emitters:
        return result
    area = np.array([tracer.areas[faces].sum() for faces in emitters], np.float32)
    label = emitter_of_face(emitters, len(tracer.areas))
    _add_gathered(result, tracer, origins, rays, label, area, n_samples)
    for index, faces in enumerate(emitters):
        _add_sampled(result[:, index], tracer, origins, faces, float(area[index]), n_rays, n_samples, rng)
        progress.update((index + 1) / len(emitters))
    return result


def _add_gathered(
    result: NDArray[np.float32],
    tracer: Tracer,
    origins: Origins,
    rays: GatherRays,
    label: NDArray[np.int64],
    area: NDArray[np.float32],
    n_samples: int,
) -> None:
    """Add the gather rays that hit an emitter, weighted against the area samples they compete with."""
    n_rays = rays.face.shape[1]
    row, column = np.nonzero((label >= 0)[rays.face])
    face = rays.face[row, column]
    k = label[face]
    direction = rays.direction[row, column].astype(np.float32)
    cos_light = np.abs((tracer.normals[face] * direction).sum(1))
    cos_surface = np.abs((origins.normal[row, column % origins.normal.shape[1]] * direction).sum(1))
    per_area = cos_surface * cos_light / np.maximum(np.pi * rays.distance[row, column] ** 2, 1e-9)
    weight = n_rays * per_area / (n_rays * per_area + n_samples / area[k])
    for kind, factor in enumerate(with_schlick(cos_surface).T):
        total = np.bincount(row * len(area) + k, weight / n_rays * factor, minlength=result[..., 0].size)
        result[..., kind] += total.reshape(len(result), len(area))


def with_schlick(cosine: NDArray[np.floating]) -> NDArray[np.floating]:
    """(n, 2) of 1 and S of the cosines (n,)."""
    return np.stack([np.ones_like(cosine), schlick(cosine)], -1)


def _add_sampled(
    column: NDArray[np.float32],
    tracer: Tracer,
    origins: Origins,
    faces: NDArray[np.integer],
    area: float,
    n_rays: int,
    n_samples: int,
    rng: np.random.Generator,
) -> None:
    """Add shadow rays to ``n_samples`` points on one emitter; ``column`` (P, 2).

    Coordinates run along the first axis: sums over three numbers are then sums of arrays.
    """
    points, normals = _sets_of_points(tracer, faces, n_samples, rng)
    which = np.arange(n_samples) % origins.position.shape[1]

    def work(rows: slice, rng: np.random.Generator) -> None:
        chosen = rng.integers(POINT_SETS, size=rows.stop - rows.start)
        normal = np.moveaxis(origins.normal[rows], 2, 0)
        position = np.moveaxis(origins.position[rows], 2, 0) + np.float32(tracer.epsilon) * normal
        position, normal = (values[..., which].reshape(3, -1) for values in (position, normal))
        offset = points[:, chosen].reshape(3, -1) - position
        square = np.maximum(dot(offset.T, offset.T), np.float32(1e-9))
        length = np.sqrt(square)
        direction = offset / length
        cos_surface = dot(direction.T, normal.T)
        cos_light = np.abs(dot(direction.T, normals[:, chosen].reshape(3, -1).T))
        live = np.flatnonzero((cos_surface > 1e-4) & (cos_light > 1e-4))
        live = live[tracer.unoccluded(position[:, live].T, direction[:, live].T, length[live])]
        per_area = cos_surface[live] * cos_light[live] / (np.pi * square[live])
        weight = (n_samples / area) / (n_samples / area + n_rays * per_area)
        value = weight * per_area * area / n_samples
        for kind, factor in enumerate(with_schlick(cos_surface[live]).T):
            total = np.bincount(live // n_samples, value * factor, minlength=len(chosen))
            column[rows, kind] += total.astype(np.float32)

    over_random_blocks(len(column), BLOCK // n_samples, work, rng)


def _sets_of_points(
    tracer: Tracer, faces: NDArray[np.integer], n_samples: int, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Position and normal, both (3, POINT_SETS, n_samples), of points spread over an emitter, each set on its own.

    Faces are chosen in order of area, and a run of the R2 sequence is as even as the whole: so are the points of each.
    """
    cumulative = np.cumsum(tracer.areas[faces])
    strata = (np.arange(n_samples) + rng.random((POINT_SETS, n_samples))) * (cumulative[-1] / n_samples)
    pick = faces[np.minimum(np.searchsorted(cumulative, strata, side="right"), len(faces) - 1)]
    u = r2_sequence(POINT_SETS, n_samples, rng)
    u = np.where(u.sum(-1, keepdims=True) > 1, 1 - u, u)
    corner, second, third = np.moveaxis(tracer.corners[pick].astype(np.float32), 2, 0)
    position = corner + u[..., :1] * (second - corner) + u[..., 1:] * (third - corner)
    position, normal = (np.ascontiguousarray(np.moveaxis(v, 2, 0)) for v in (position, tracer.normals[pick]))
    return position, normal
