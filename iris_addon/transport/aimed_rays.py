"""Rays aimed at what is far brighter than the rest of the room: a wall beside a lamp, the inside of its shade.

A small patch that shines like a lamp is met by one gather ray in hundreds, which then stands for all of its light. So
points on such patches are taken for lights (Keller 1997, "Instant Radiosity"), sampled with shadow rays as lamps are
and weighted against the gather rays that they compete with by the balance heuristic (Veach 1997, eq. 9.8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Integer, kernel, rows_of
from ..base.group_by import entries_of
from ..base.parallel import BLOCK, over_random_blocks, over_shares
from ..model.response import LUMINANCE
from ..rays.sampling import dot, grazing, vector
from ..rays.tracer import Tracer
from .form_factors import POINT_SETS, ShadowRays, aim_at_point
from .gather import find_patches
from .transport import Transport, radiance_table, sent_back

BRIGHT = 10.0
"""Radiance, in medians of what photos show, from which a patch is aimed at."""
NOTICED = 0.02
"""Share of all light that bright patches must send to be worth rays of their own."""
POINTS_PER_FACE, MAX_POINTS = 8, 200_000
SAMPLES = 32
"""Shadow rays from every patch to bright ones, all together."""


@dataclass(frozen=True)
class BrightPoints:
    """Points on one side each of bright patches, as many per area everywhere.

    Attributes:
        position, normal: (n, 3) float32 metres, and unit on the side that shines.
        face, patch: (n,) int32.
        chance: (n,) probability that a ray is aimed at each, its share of the light.
        per_area: (N,) the same per square metre of every patch, 0 for those that are not aimed at.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    face: NDArray[np.int32]
    patch: NDArray[np.int32]
    chance: NDArray[np.float64]
    per_area: NDArray[np.float64]


def aim_at_bright(
    tracer: Tracer,
    transport: Transport,
    regions: NDArray[np.int32],
    radiance: NDArray[np.floating],
    irradiance: NDArray[np.floating],
    dark_faces: NDArray[np.bool_],
    rng: np.random.Generator,
) -> SparseRays | None:
    """Rays from the seen patches to bright ones, and, negative, the say that gather rays lose to them.

    Args:
        regions: (F,) part per face.
        radiance, irradiance: (N, 3) about what patches send, and what arrives at them over pi.
        dark_faces: (F,) faces of lamps, which are aimed at already.

    Returns:
        None where the room has no bright patches that matter.
    """
    light = np.maximum(radiance @ LUMINANCE, 0.0)
    bright = light > BRIGHT * np.median(light[: transport.n_seen])
    row, column = entries_of(transport.target, np.append(bright, [False, False]))  # the last are ESCAPED and UNKNOWN
    on = ~dark_faces[transport.rays.face[row, column]]
    row, column = row[on], column[on]
    sent = light[transport.target[row, column]].sum() / transport.target.shape[1]
    if sent <= NOTICED * (irradiance[: transport.n_seen] @ LUMINANCE).sum():
        return None
    faces = np.unique(transport.rays.face[row, column])
    points = _bright_points(tracer, transport, regions, faces, np.where(bright, light, 0.0), rng)
    if points is None:
        return None
    displaced = _displaced(tracer, transport, points, row, column)
    return SparseRays.joined([displaced, _aimed(tracer, transport, points, rng)])


def _bright_points(
    tracer: Tracer,
    transport: Transport,
    regions: NDArray[np.int32],
    faces: NDArray[np.int32],
    light: NDArray[np.floating],
    rng: np.random.Generator,
) -> BrightPoints | None:
    """Points on the bright patches (``light`` (N,) > 0) of ``faces``; None where none falls on one."""
    areas = tracer.areas[faces].astype(np.float64)
    total = MAX_POINTS - POINTS_PER_FACE * len(faces)
    count = POINTS_PER_FACE + (max(total, 0) * areas / areas.sum()).astype(np.int64)
    face = np.repeat(faces, count)
    u = rng.random((len(face), 2))
    u = np.where(u.sum(1, keepdims=True) > 1, 1 - u, u)
    first, second, third = tracer.corners[face].transpose(1, 0, 2)
    position = (first + u[:, :1] * (second - first) + u[:, 1:] * (third - first)).astype(np.float32)
    area = np.repeat(areas / count, count)
    sides = []
    for normal in (tracer.normals[face], -tracer.normals[face]):
        patch = find_patches(tracer, transport.grid, regions, face, position, -normal)
        on = np.flatnonzero((patch >= 0) & (light[patch] > 0))
        sides.append((position[on], normal[on], face[on], patch[on], area[on]))
    position, normal, face, patch, area = map(np.concatenate, zip(*sides, strict=True))
    if not len(patch):
        return None
    power = area * light[patch]
    per_area = np.zeros(len(light))
    per_area[patch] = light[patch] / power.sum()
    return BrightPoints(
        position=position, normal=normal, face=face, patch=patch, chance=power / power.sum(), per_area=per_area
    )


def _displaced(
    tracer: Tracer, transport: Transport, points: BrightPoints, row: NDArray[np.integer], column: NDArray[np.integer]
) -> SparseRays:
    """What gather rays (``row``, ``column``) that met bright patches lose: they compete with aimed ones."""
    rays, origins = transport.rays, transport.origins
    n_rays = rays.face.shape[1]
    face, target = rays.face[row, column], transport.target[row, column]
    direction = rays.direction[row, column].astype(np.float32)
    cos_light = np.abs(dot(direction, tracer.normals[face]))
    cos_surface = np.abs(dot(direction, origins.normal[row, column % origins.normal.shape[1]]))
    gathered = n_rays * cos_surface * cos_light / np.maximum(np.pi * rays.distance[row, column] ** 2, 1e-9)
    aimed = SAMPLES * points.per_area[target]
    loses = -aimed / np.maximum(gathered + aimed, 1e-30)  # a patch without a point is not aimed at
    weight = loses / n_rays * _lobes(transport, row, target, cos_surface, cos_light, direction)
    return SparseRays(
        n_rows=transport.n_patches, row=row, weight=weight[:, None].astype(np.float32), target=target, face=face
    )


def _aimed(tracer: Tracer, transport: Transport, points: BrightPoints, rng: np.random.Generator) -> SparseRays:
    """SAMPLES shadow rays from every seen patch; those that arrive."""
    origins, n_rays = transport.origins, transport.rays.face.shape[1]
    cumulative = np.cumsum(points.chance)
    strata = (np.arange(SAMPLES) + rng.random((POINT_SETS, SAMPLES))) * (cumulative[-1] / SAMPLES)
    sets = np.minimum(np.searchsorted(cumulative, strata, side="right"), len(cumulative) - 1).astype(np.int32)
    arrived: dict[int, SparseRays] = {}

    def work(rows: slice, rng: np.random.Generator) -> None:
        pick = sets[rng.integers(POINT_SETS, size=rows.stop - rows.start)]
        shadow = ShadowRays.empty(pick.size)
        count = _toward_picked(*origins.flat(rows), tracer.epsilon, points.position, points.normal, pick, shadow)
        shadow = rows_of(shadow, slice(count))
        clear = tracer.unoccluded(shadow.start, shadow.along, shadow.length)
        shadow = rows_of(shadow, clear)
        row, target = rows.start + shadow.row, points.patch[shadow.pick]
        filled = shadow.cos_surface * shadow.cos_light / (np.pi * shadow.length**2)
        weight = filled / (n_rays * filled + SAMPLES * points.per_area[target])
        weight = weight * _lobes(transport, row, target, shadow.cos_surface, shadow.cos_light, shadow.along)
        arrived[rows.start] = SparseRays(
            n_rows=transport.n_patches,
            row=row,
            weight=weight[:, None].astype(np.float32),
            target=target,
            face=points.face[shadow.pick],
        )

    over_random_blocks(len(origins.position), BLOCK // SAMPLES, work, rng)
    return SparseRays.joined([arrived[start] for start in sorted(arrived)])


@kernel
def _toward_picked(
    position: NDArray[np.float32],
    normal: NDArray[np.float32],
    per_patch: int,
    epsilon: float,
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    pick: NDArray[np.int32],
    shadow: ShadowRays,
) -> int:
    """Rays from patches, ``per_patch`` points (n, 3) each, to those of ``points`` (m, 3) that each has picked (n, S),
    if they shine there; how many."""
    count = 0
    for p in range(pick.shape[0]):
        for s in range(pick.shape[1]):
            k, at = p * per_patch + s % per_patch, pick[p, s]
            origin, n = vector(position, k), vector(normal, k)
            faces = aim_at_point(shadow, count, origin, n, epsilon, vector(points, at), vector(normals, at))
            if faces and shadow.cos_light[count] > 0:
                shadow.row[count], shadow.pick[count] = p, at
                count += 1
    return count


@kernel
def _lobe_factors(
    lobes: NDArray[np.float32],
    kappa: NDArray[np.floating],
    row: NDArray[np.integer],
    target: NDArray[np.integer],
    cos_start: NDArray[np.floating],
    cos_end: NDArray[np.floating],
    direction: NDArray[np.float32],
    factor: NDArray[np.float64],
) -> None:
    for i in range(len(factor)):
        back = sent_back(lobes, target[i], grazing(cos_end[i]), direction[i, 0], direction[i, 1], direction[i, 2])
        factor[i] = (1 + kappa[row[i]] * grazing(cos_start[i])) * back


def _lobes(
    transport: Transport,
    row: NDArray[np.integer],
    target: NDArray[np.integer],
    cos_start: NDArray[np.floating],
    cos_end: NDArray[np.floating],
    direction: NDArray[np.floating],
) -> NDArray[np.floating]:
    """The diffuse lobes at both ends of each ray over Lambert's."""
    factor = np.empty(len(row))
    _lobe_factors(transport.lobes, transport.kappa, row, target, cos_start, cos_end, direction, factor)
    return factor


# ---- Rays beside the gather rays, from few of the patches or to few of them -----------------------------------------


@dataclass(frozen=True)
class SparseRays:
    """k rays, each with its own weight.

    Attributes:
        n_rows: N patches, seen and unseen.
        row: (k,) patch that gathers.
        weight: (k, 1) or (k, 3) float32 share of the radiance met that arrives as irradiance / pi.
        target: (k,) int32 patch met, UNKNOWN or ESCAPED.
        face: (k,) int32 face met, -1 where escaped.
    """

    n_rows: int
    row: NDArray[np.integer]
    weight: NDArray[np.float32]
    target: NDArray[np.int32]
    face: NDArray[np.int32]

    @staticmethod
    def joined(rays: Sequence[SparseRays]) -> SparseRays:
        """All rays of several sets between the same patches."""
        columns = zip(*((one.row, one.weight, one.target, one.face) for one in rays), strict=True)
        return SparseRays(rays[0].n_rows, *map(np.concatenate, columns))

    def gather_radiance(
        self, radiance: NDArray[np.floating], unknown: NDArray[np.floating], emitter_faces: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """(N, 3) irradiance / pi to be added to :meth:`iris_addon.transport.transport.Transport.gather_radiance`, whose
        arguments these are."""
        table, dark = radiance_table(radiance, unknown), np.append(emitter_faces, False)
        sums = np.zeros((self.n_rows, 3))
        over_shares(
            self.n_rows,
            lambda own: _gather(self.row, own.start, self.weight, self.target, self.face, table, dark, sums[own]),
        )
        return sums.astype(np.float32)


@kernel
def _gather(
    row: NDArray[np.integer],
    begin: Integer,
    weight: NDArray[np.float32],
    target: NDArray[np.int32],
    face: NDArray[np.int32],
    table: NDArray[np.float32],
    dark: NDArray[np.bool_],
    sums: NDArray[np.float64],
) -> None:
    """Weighted radiance of the rays of the rows (n, 3) from ``begin`` on; those that meet ``dark`` faces carry none."""
    last = weight.shape[1] - 1
    for i in range(len(row)):
        r = row[i] - begin
        if 0 <= r < len(sums) and not dark[face[i]]:
            for c in range(3):
                sums[r, c] += weight[i, min(c, last)] * table[target[i], c]
