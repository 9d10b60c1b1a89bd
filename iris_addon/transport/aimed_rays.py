"""Shadow rays aimed at patches far brighter than the rest of the room: a wall beside a lamp, the inside of its shade.

Of the gather rays one in hundreds meets a small bright patch, and then stands for all of its light. Points on such
patches therefore serve as lights (Keller 1997, "Instant Radiosity"). Like lamps they are sampled with shadow rays,
weighted against the gather rays by the balance heuristic (Veach 1997, eq. 9.8). :class:`SparseRays` holds these rays
and the weight that the gather rays lose to them.
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

BRIGHT_RADIANCE = 10.0
"""Radiance from which on a patch is bright, in medians of the seen patches."""
BRIGHT_MIN_SHARE = 0.02
"""Share of all light that bright patches must send to get rays of their own."""
LONE_RAY_SHARE, LONE_RAYS_MIN = 0.3, 0.002
"""Or share of the light of a patch that one ray to a bright one brings, and share of the seen patches with such a ray:
the rim of a lamp sends next to nothing, and each of the few rays that meet it makes a spot."""
POINTS_PER_FACE, MAX_POINTS = 8, 200_000
"""Points on bright patches: per face at least, and about in all."""
AIMED_RAYS = 32
"""Shadow rays from each patch to all bright ones together."""


@dataclass(frozen=True)
class BrightPoints:
    """n points on bright patches, each on one side of the surface, of uniform density.

    Attributes:
        position, normal: (n, 3) float32 metres, and unit on the bright side.
        face, patch: (n,) int32.
        probability: (n,) that an aimed ray goes to each: its share of the light.
        density: (N,) the same per square metre of each patch, 0 for those that are not bright.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    face: NDArray[np.int32]
    patch: NDArray[np.int32]
    probability: NDArray[np.float64]
    density: NDArray[np.float64]


def aim_at_bright(
    tracer: Tracer,
    transport: Transport,
    regions: NDArray[np.int32],
    radiance: NDArray[np.floating],
    irradiance: NDArray[np.floating],
    dark_faces: NDArray[np.bool_],
    rng: np.random.Generator,
) -> SparseRays | None:
    """Rays from the seen patches to bright ones, and with negative weight what gather rays lose to them.

    Args:
        regions: (F,) region of each face.
        radiance: (N, 3) that patches send, about.
        irradiance: (N, 3) irradiance / pi at patches, about.
        dark_faces: (F,) faces of lamps, which have shadow rays already.

    Returns:
        None where bright patches do not matter.
    """
    light = np.maximum(radiance @ LUMINANCE, 0.0)
    bright = light > BRIGHT_RADIANCE * np.median(light[: transport.n_seen])
    row, column = entries_of(
        transport.target, np.append(bright, [False, False])
    )  # the last two are ESCAPED and UNKNOWN
    on = ~dark_faces[transport.rays.face[row, column]]
    row, column = row[on], column[on]
    sent = light[transport.target[row, column]].sum() / transport.target.shape[1]
    arriving = irradiance[: transport.n_seen] @ LUMINANCE
    if sent <= BRIGHT_MIN_SHARE * arriving.sum():
        alone = light[transport.target[row, column]] > LONE_RAY_SHARE * transport.target.shape[1] * arriving[row]
        if len(np.unique(row[alone])) <= LONE_RAYS_MIN * transport.n_seen:
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
    """Points on ``faces`` that lie on bright patches, whose ``light`` (N,) is positive; None without any."""
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
    density = np.zeros(len(light))
    density[patch] = light[patch] / power.sum()
    return BrightPoints(
        position=position, normal=normal, face=face, patch=patch, probability=power / power.sum(), density=density
    )


def _displaced(
    tracer: Tracer, transport: Transport, points: BrightPoints, row: NDArray[np.integer], column: NDArray[np.integer]
) -> SparseRays:
    """What the gather rays ``row``, ``column`` (n,) that meet bright patches lose to the aimed ones."""
    rays, origins = transport.rays, transport.origins
    n_rays = rays.face.shape[1]
    face, target = rays.face[row, column], transport.target[row, column]
    direction = rays.direction[row, column].astype(np.float32)
    cos_light = np.abs(dot(direction, tracer.normals[face]))
    cos_surface = np.abs(dot(direction, origins.normal[row, column % origins.normal.shape[1]]))
    gathered = n_rays * cos_surface * cos_light / np.maximum(np.pi * rays.distance[row, column] ** 2, 1e-9)
    aimed = AIMED_RAYS * points.density[target]
    loses = -aimed / np.maximum(gathered + aimed, 1e-30)  # no ray is aimed at a patch without a point
    weight = loses / n_rays * _lobes(transport, row, target, cos_surface, cos_light, direction)
    return SparseRays(
        n_rows=transport.n_patches, row=row, weight=weight[:, None].astype(np.float32), target=target, face=face
    )


def _aimed(tracer: Tracer, transport: Transport, points: BrightPoints, rng: np.random.Generator) -> SparseRays:
    """Of AIMED_RAYS shadow rays from each seen patch those that arrive."""
    origins, n_rays = transport.origins, transport.rays.face.shape[1]
    cumulative = np.cumsum(points.probability)
    strata = (np.arange(AIMED_RAYS) + rng.random((POINT_SETS, AIMED_RAYS))) * (cumulative[-1] / AIMED_RAYS)
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
        weight = filled / (n_rays * filled + AIMED_RAYS * points.density[target])
        weight = weight * _lobes(transport, row, target, shadow.cos_surface, shadow.cos_light, shadow.along)
        arrived[rows.start] = SparseRays(
            n_rows=transport.n_patches,
            row=row,
            weight=weight[:, None].astype(np.float32),
            target=target,
            face=points.face[shadow.pick],
        )

    over_random_blocks(len(origins.position), BLOCK // AIMED_RAYS, work, rng)
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
    """Fill ``shadow`` with the rays from patches to the points (m, 3) that each has picked (n, S); returns how many.

    Args:
        position, normal: (n · per_patch, 3) points on the patches.
    """
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
    """(n,) factor of the diffuse lobes at both ends of each ray, relative to Lambert's."""
    factor = np.empty(len(row))
    _lobe_factors(transport.lobes, transport.kappa, row, target, cos_start, cos_end, direction, factor)
    return factor


# ---- the rays ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SparseRays:
    """k rays between a few patches, in addition to the gather rays.

    Attributes:
        n_rows: number N of patches, seen and unseen.
        row: (k,) patch that gathers.
        weight: (k, 1) or (k, 3) float32 irradiance / pi per radiance met, of all or of each channel.
        target: (k,) int32 patch met, UNKNOWN or ESCAPED.
        face: (k,) int32 face met, -1 where the ray escapes.
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
        """(N, 3) irradiance / pi to be added to that of
        :meth:`iris_addon.transport.transport.Transport.gather_radiance`, which has the same arguments."""
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
    """Add to ``sums`` (n, 3) the weighted radiance of the rays of the rows from ``begin`` on; rays that end on ``dark``
    faces carry none."""
    last = weight.shape[1] - 1
    for i in range(len(row)):
        r = row[i] - begin
        if 0 <= r < len(sums) and not dark[face[i]]:
            for c in range(3):
                sums[r, c] += weight[i, min(c, last)] * table[target[i], c]
