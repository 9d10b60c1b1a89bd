"""The cached light transport between patches: where every gather ray ends, traced once and never again.

Rows 0 ... P-1 are the patches that photos see; rows P ... N-1 are surfaces that no photo sees but that light bounces
off, found because gather rays ended there. Their radiance is not observed and follows from transport.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from ..grouping import group_equal
from ..parallel import BLOCK, over_blocks
from ..progress import Progress
from ..surface.build import ORIGINS_PER_PATCH, Surface
from ..surface.patches import KeyIndex, PatchGrid, cell_keys
from .diffuse import burley_roughness
from .gather import GatherRays, Origins, gather
from .light_moments import LightMoments
from .sampling import dot
from .tracer import Tracer

UNKNOWN, ESCAPED = -1, -2
UNSEEN_RAYS_SHARE = 4
"""Unseen patches get one in so many of the rays: their radiance is second-hand anyway."""


@dataclass(frozen=True)
class Transport:
    """Gather rays of all N patches.

    Attributes:
        n_seen: patches that photos see.
        origins: where the rays of each patch start.
        rays: of the seen patches; ``unseen_rays`` of the others.
        target, unseen_target: (P, R) and (N - P, R') int32 patch hit, UNKNOWN or ESCAPED.
        part: (N,) part of each patch.
        device: where torch sums over rays.
        kappa: (N,) grazing gain of the diffuse lobe of each patch, see :mod:`iris_addon.transport.diffuse`.
        moments: where the light of the seen patches comes from, once that is about known and their lobe is Burley's;
            without, what they send is that of light from all sides.
    """

    n_seen: int
    origins: Origins
    unseen_origins: Origins
    rays: GatherRays
    unseen_rays: GatherRays
    target: NDArray[np.int32]
    unseen_target: NDArray[np.int32]
    part: NDArray[np.int32]
    grids: tuple[PatchGrid, PatchGrid]
    kappa: NDArray[np.float64]
    device: str = "cpu"
    moments: LightMoments | None = None

    @property
    def n_patches(self) -> int:
        """All patches, seen and unseen."""
        return self.n_seen + len(self.unseen_target)

    def escaped(self) -> NDArray[np.float64]:
        """(N,) share of each patch's rays that leave the mesh."""
        return np.concatenate([(self.target == ESCAPED).mean(1), (self.unseen_target == ESCAPED).mean(1)])

    def gather_radiance(
        self, radiance: NDArray[np.floating], unknown: NDArray[np.floating], emitter_faces: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """``G L``: mean radiance over each patch's rays, weighted by the diffuse lobes at both ends.

        Args:
            radiance: (N, 3) per patch, without the view factor of its lobe.
            unknown: (3,) for rays that end on a surface without a patch.
            emitter_faces: (F,) faces whose light is counted elsewhere; rays that end there carry nothing.

        Returns:
            (N, 3) irradiance / pi, without emitters and without light from outside.
        """
        # Turned by two, so that ESCAPED and UNKNOWN, which count from the end, come first: torch counts from zero.
        table = torch.from_numpy(np.roll(radiance_table(radiance, unknown), 2, axis=0)).to(self.device)
        dark = np.append(emitter_faces, False)
        seen = _mean_of_targets(table, self.rays, self.target, dark, self._lobe_weights[0])
        unseen = _mean_of_targets(table, self.unseen_rays, self.unseen_target, dark, self._lobe_weights[1])
        return np.concatenate([seen, unseen])

    @cached_property
    def _lobe_weights(self) -> tuple[NDArray[np.float32] | None, NDArray[np.float32] | None]:
        """Of the rays of seen and of unseen patches; None where all patches are Lambertian. Many lamps are tried."""
        if not self.kappa.any():
            return None, None
        return (
            self._both_lobes(self.rays, self.target, self.kappa[: self.n_seen]),
            self._both_lobes(self.unseen_rays, self.unseen_target, self.kappa[self.n_seen :]),
        )

    def _both_lobes(self, rays: GatherRays, target: NDArray[np.int32], own: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n, R) ``1 + κ S`` where a ray starts, κ being ``own`` (n,), times the factor of the lobe where it ends."""
        weight = np.empty(target.shape, np.float32)

        def work(rows: slice) -> None:
            starting = 1 + own[rows, None].astype(np.float32) * rays.schlick_start[rows]
            weight[rows] = starting * self.sent_back(target[rows], rays.schlick_end[rows], rays.direction[rows])

        over_blocks(len(target), BLOCK // target.shape[1], work)
        return weight

    def sent_back(
        self, target: NDArray[np.integer], schlick: NDArray[np.floating], direction: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """What patches send back along the rays that meet them over what their radiance counts as; 1 for no patch.

        Args:
            target: patch met, any shape.
            schlick: of the same shape, S of the angles at which the rays arrive.
            direction: the same shape and 3, unit, of the rays.
        """
        schlick = schlick.astype(np.float32, copy=False)

        def coefficient(k: int) -> NDArray[np.float32]:
            head_on, grazing = (table.take(target, mode="wrap") for table in self._lobes[:, k])
            return head_on + schlick * grazing

        factor = coefficient(0)
        if self.moments is not None:
            for axis in range(3):
                factor -= coefficient(1 + axis) * direction[..., axis]
        return factor

    @cached_property
    def _lobes(self) -> NDArray[np.float32]:
        """(2, 4, N + 2) as of :meth:`LightMoments.lobes`; those of light from all sides where there are no moments, and
        the last two for UNKNOWN and ESCAPED."""
        lobes = np.zeros((2, 4, self.n_patches + 2), np.float32)
        lobes[0, 0] = 1
        lobes[1, 0, : self.n_patches] = self.kappa
        if self.moments is not None:
            lobes[..., : self.n_seen] = self.moments.lobes(burley_roughness(self.kappa[: self.n_seen]))
        return lobes


def _mean_of_targets(
    table: torch.Tensor,
    rays: GatherRays,
    target: NDArray[np.int32],
    dark: NDArray[np.bool_],
    weight: NDArray[np.float32] | None,
) -> NDArray[np.float32]:
    """(n, 3) of the rays (n, R); those that end on ``dark`` (F + 1,) faces, the last for none, carry nothing."""
    index = np.empty(target.shape, np.int32)

    def work(rows: slice) -> None:
        np.add(target[rows], 2, out=index[rows])
        np.putmask(index[rows], dark.take(rays.face[rows]), ESCAPED + 2)

    over_blocks(len(target), BLOCK // target.shape[1], work)
    at = torch.from_numpy(index).to(table.device)
    say = None if weight is None else torch.from_numpy(weight).to(table.device)
    # The mode "mean" takes seven times as long on the CPU.
    total = torch.nn.functional.embedding_bag(at, table, mode="sum", per_sample_weights=say)
    return (total / target.shape[1]).cpu().numpy()


def radiance_table(radiance: NDArray[np.floating], unknown: NDArray[np.floating]) -> NDArray[np.float32]:
    """(N + 2, 3) radiance of the patches and, last, darkness and surfaces without a patch: where ESCAPED and UNKNOWN
    lead, counted from the end."""
    return np.concatenate([radiance, np.zeros((1, 3)), np.asarray(unknown)[None]]).astype(np.float32)


def table_rows(target: NDArray[np.int32], face: NDArray[np.int32], dark_faces: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Row of :func:`radiance_table` for every ray; those that end on ``dark_faces`` (F,) carry nothing."""
    return np.where(dark_faces[face] & (face >= 0), np.int32(ESCAPED), target)


def facing_normals(tracer: Tracer, face: NDArray[np.integer], direction: NDArray[np.floating]) -> NDArray[np.float32]:
    """(n, 3) normals of hit faces, turned against the directions the rays came along."""
    normal = tracer.normals[face]
    return normal * np.where(dot(normal, direction) > 0, np.float32(-1), np.float32(1))[:, None]


def find_patches(
    tracer: Tracer,
    grids: tuple[PatchGrid, ...],
    parts: NDArray[np.int32],
    face: NDArray[np.int32],
    point: NDArray[np.float32],
    direction: NDArray[np.floating],
) -> NDArray[np.int32]:
    """(n,) patch of each hit, tried grid by grid; UNKNOWN or ESCAPED where there is none."""
    normal = facing_normals(tracer, face, direction.astype(np.float32, copy=False))
    # Few rays escape or miss the first grid: looked up there all alike, only the rest need sorting out.
    result = np.where(face < 0, np.int32(ESCAPED), grids[0].lookup(point, normal, parts[face]))
    for grid in grids[1:]:
        open_ = np.flatnonzero(result == UNKNOWN)
        result[open_] = grid.lookup(point[open_], normal[open_], parts[face[open_]])
    return result


def _targets(
    tracer: Tracer,
    grids: tuple[PatchGrid, ...],
    parts: NDArray[np.int32],
    rays: GatherRays,
    point: NDArray[np.float32],
) -> NDArray[np.int32]:
    face, point, direction = rays.face.ravel(), point.reshape(-1, 3), rays.direction.reshape(-1, 3)
    target = np.empty(len(face), np.int32)

    def work(block: slice) -> None:
        target[block] = find_patches(tracer, grids, parts, face[block], point[block], direction[block])

    over_blocks(len(face), BLOCK, work)
    return target.reshape(rays.face.shape)


def _unseen_patches(
    tracer: Tracer,
    surface: Surface,
    parts: NDArray[np.int32],
    rays: GatherRays,
    hit_point: NDArray[np.float32],
    target: NDArray[np.int32],
    limit: int,
) -> tuple[PatchGrid, Origins, NDArray[np.int32]]:
    """Coarse patches where rays ended on surfaces that no photo sees; the ``limit`` most often hit."""
    row, column = np.nonzero(target == UNKNOWN)
    face = rays.face[row, column]
    point = hit_point[row, column]
    normal = facing_normals(tracer, face, rays.direction[row, column].astype(np.float32))
    none = np.zeros(0, np.uint64), np.zeros(0, np.int8)
    keys = cell_keys(point, normal, parts[face], surface.grid.origin, surface.grid.scale, KeyIndex(none[0]), none[1])
    groups = group_equal(keys)
    count = groups.count
    kept = np.sort(np.argsort(-count, kind="stable")[:limit])
    # Such patches are large, and what rays of the others met of them is the part that matters.
    step = np.arange(ORIGINS_PER_PATCH) * count[kept, None] // ORIGINS_PER_PATCH
    at = groups.order[groups.start[kept, None] + step]
    number = np.arange(len(kept), dtype=np.int32) + np.int32(len(surface.part))
    grid = PatchGrid(surface.grid.origin, surface.grid.scale, *none, groups.keys[kept], number)
    return grid, Origins(point[at], normal[at]), parts[face[at[:, 0]]]


def build_transport(
    tracer: Tracer,
    surface: Surface,
    parts: NDArray[np.int32],
    n_rays: int,
    rng: np.random.Generator,
    progress: Progress,
) -> Transport:
    """Trace the gather rays of all patches and name the patch that each one hits."""
    rays, point = gather(tracer, surface.origins, n_rays, rng, progress)
    target = _targets(tracer, (surface.grid,), parts, rays, point)
    unseen_grid, unseen_origins, unseen_part = _unseen_patches(
        tracer, surface, parts, rays, point, target, limit=len(surface.part) // 2
    )
    row, column = np.nonzero(target == UNKNOWN)
    target[row, column] = find_patches(
        tracer, (unseen_grid,), parts, rays.face[row, column], point[row, column], rays.direction[row, column]
    )
    grids = (surface.grid, unseen_grid)
    unseen_rays, point = gather(tracer, unseen_origins, max(16, n_rays // UNSEEN_RAYS_SHARE), rng, progress)
    unseen_target = _targets(tracer, grids, parts, unseen_rays, point)
    return Transport(
        len(surface.part),
        surface.origins,
        unseen_origins,
        rays,
        unseen_rays,
        target,
        unseen_target,
        np.concatenate([surface.part, unseen_part]),
        grids,
        np.zeros(len(surface.part) + len(unseen_part)),
    )
