"""The cached light transport between patches: where every gather ray ends, traced once and never again.

Rows 0 ... P-1 are the patches that photos see; rows P ... N-1 are surfaces that no photo sees but that light bounces
off, found because gather rays ended there. Their radiance is not observed and follows from transport.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from ..base.compiled import Integer, Real, inlined, kernel
from ..base.errors import BadInput
from ..base.group_by import group_equal
from ..base.parallel import BLOCK, filled, over_blocks
from ..base.progress import Progress
from ..brdf.diffuse import burley_roughness, grazing_gain
from ..rays.sampling import Origins, dot
from ..rays.tracer import Tracer
from ..surface.patches import ORIGINS_PER_PATCH, PatchGrid, Surface, cell_keys, cells
from .gather import ESCAPED, UNKNOWN, GatherRays, facing_normals, find_patches, gather

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
        grid: from surface points to all N patches.
        device: where torch sums over rays.
        kappa: (N,) grazing gain of the diffuse lobe of each patch, see :mod:`iris_addon.brdf.diffuse`.
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
    region: NDArray[np.int32]
    grid: PatchGrid
    kappa: NDArray[np.float64]
    moments: LightMoments | None = None
    device: str = "cpu"

    @property
    def n_patches(self) -> int:
        """All patches, seen and unseen."""
        return self.n_seen + len(self.unseen_target)

    def with_lobes(self, kappa: NDArray[np.floating], moments: LightMoments | None = None) -> Transport:
        """The same rays between patches of other diffuse lobes: grazing gains (N,), and the moments of their light."""
        return replace(self, kappa=kappa, moments=moments)

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
            start, end = (s[rows].astype(np.float32) for s in (rays.schlick_start, rays.schlick_end))
            direction = rays.direction[rows].astype(np.float32)
            _lobe_weights(self.lobes, own[rows], target[rows], start, end, direction, weight[rows])

        over_blocks(len(target), BLOCK // target.shape[1], work)
        return weight

    @cached_property
    def lobes(self) -> NDArray[np.float32]:
        """(N + 2, 2, 4) as of :meth:`LightMoments.lobes`, for :func:`sent_back`; those of light from all sides where
        there are no moments, and the last two for UNKNOWN and ESCAPED."""
        lobes = np.zeros((self.n_patches + 2, 2, 4), np.float32)
        lobes[:, 0, 0] = 1
        lobes[: self.n_patches, 1, 0] = self.kappa
        if self.moments is not None:
            lobes[: self.n_seen] = self.moments.lobes(burley_roughness(self.kappa[: self.n_seen]))
        return lobes


@inlined
def sent_back(lobes: NDArray[np.float32], target: Integer, schlick: Real, dx: Real, dy: Real, dz: Real) -> Real:
    """What a patch sends back along a ray that meets it over what its radiance counts as; 1 for no patch.

    Args:
        lobes: :attr:`Transport.lobes`.
        target: patch met, UNKNOWN or ESCAPED.
        schlick: S of the angle at which the ray arrives.
        dx, dy, dz: unit direction of the ray.
    """
    value = lobes[target, 0, 0] + schlick * lobes[target, 1, 0]
    value -= (lobes[target, 0, 1] + schlick * lobes[target, 1, 1]) * dx
    value -= (lobes[target, 0, 2] + schlick * lobes[target, 1, 2]) * dy
    return value - (lobes[target, 0, 3] + schlick * lobes[target, 1, 3]) * dz


@kernel
def _lobe_weights(
    lobes: NDArray[np.float32],
    own: NDArray[np.floating],
    target: NDArray[np.int32],
    start: NDArray[np.float32],
    end: NDArray[np.float32],
    direction: NDArray[np.float32],
    weight: NDArray[np.float32],
) -> None:
    for p in range(target.shape[0]):
        for r in range(target.shape[1]):
            x, y, z = direction[p, r, 0], direction[p, r, 1], direction[p, r, 2]
            weight[p, r] = (1 + own[p] * start[p, r]) * sent_back(lobes, target[p, r], end[p, r], x, y, z)


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


def targets_of(
    tracer: Tracer,
    grid: PatchGrid,
    regions: NDArray[np.int32],
    rays: GatherRays,
    point: NDArray[np.float32],
) -> NDArray[np.int32]:
    """(n, R) patch that each ray meets at ``point`` (n, R, 3), UNKNOWN or ESCAPED."""
    face, point, direction = rays.face.ravel(), point.reshape(-1, 3), rays.direction.reshape(-1, 3)

    def target(block: slice) -> NDArray[np.int32]:
        along = direction[block].astype(np.float32)
        return find_patches(tracer, grid, regions, face[block], point[block], along)

    return filled(np.empty(len(face), np.int32), target).reshape(rays.face.shape)


def _unseen_patches(
    tracer: Tracer,
    surface: Surface,
    regions: NDArray[np.int32],
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
    no_blocks = np.zeros(0, np.uint64), np.zeros(0, np.int8)
    keys = cell_keys(cells(surface.grid.origin, surface.grid.scale, *no_blocks), point, normal, regions[face])
    groups = group_equal(keys)
    count = groups.count
    kept = np.sort(np.argsort(-count, kind="stable")[:limit])
    # Such patches are large, and what rays of the others met of them is the region that matters.
    step = np.arange(ORIGINS_PER_PATCH) * count[kept, None] // ORIGINS_PER_PATCH
    at = groups.order[groups.start[kept, None] + step]
    number = np.arange(len(kept), dtype=np.int32) + np.int32(len(surface.region))
    grid = PatchGrid(
        origin=surface.grid.origin,
        scale=surface.grid.scale,
        block_keys=no_blocks[0],
        block_levels=no_blocks[1],
        cell_keys=groups.keys[kept],
        cell_patches=number,
    )
    return grid, Origins(point[at], normal[at]), regions[face[at[:, 0]]]


def build_transport(
    tracer: Tracer,
    surface: Surface,
    regions: NDArray[np.int32],
    n_rays: int,
    rng: np.random.Generator,
    progress: Progress,
) -> Transport:
    """Trace the gather rays of all patches and name the patch that each one hits."""
    rays, point = gather(tracer, surface.origins, n_rays, rng, progress)
    target = targets_of(tracer, surface.grid, regions, rays, point)
    unseen_grid, unseen_origins, unseen_region = _unseen_patches(
        tracer, surface, regions, rays, point, target, limit=len(surface.region) // 2
    )
    row, column = np.nonzero(target == UNKNOWN)
    along = rays.direction[row, column].astype(np.float32)
    grid = surface.grid.joined(unseen_grid)
    target[row, column] = find_patches(tracer, grid, regions, rays.face[row, column], point[row, column], along)
    unseen_rays, point = gather(tracer, unseen_origins, max(16, n_rays // UNSEEN_RAYS_SHARE), rng, progress)
    unseen_target = targets_of(tracer, grid, regions, unseen_rays, point)
    return Transport(
        n_seen=len(surface.region),
        origins=surface.origins,
        unseen_origins=unseen_origins,
        rays=rays,
        unseen_rays=unseen_rays,
        target=target,
        unseen_target=unseen_target,
        region=np.concatenate([surface.region, unseen_region]),
        grid=grid,
        kappa=np.zeros(len(surface.region) + len(unseen_region)),
    )


# ---- Burley's lobe towards any direction, from a few sums over the light of a patch ---------------------------------
#
# A factor of the light times one of the view, with a mean for the angle between the two
# (:mod:`iris_addon.brdf.diffuse`), serves where light comes from all sides. Beside a window it does not: a rough
# wall is brighter seen from where its light comes from than seen against it, so that what stands beside the window gets
# more of it back. The exact lobe is linear in the direction of light, cos²θd being (1 + l·v) / 2: a few sums over the
# light of a patch serve all directions.


@dataclass(frozen=True)
class LightMoments:
    """Means over the light that reaches each seen patch, weighted by what it adds to irradiance.

    Attributes:
        direction: (P, 3) mean of l, the unit vector towards the light.
        grazing: (P,) mean of S, Schlick's (1 - cos θi)^5.
        grazing_direction: (P, 3) mean of S l.
    """

    direction: NDArray[np.float32]
    grazing: NDArray[np.float32]
    grazing_direction: NDArray[np.float32]

    def view_factor(
        self,
        patch: NDArray[np.integer],
        roughness: NDArray[np.floating],
        schlick: NDArray[np.floating],
        toward: NDArray[np.floating],
    ) -> NDArray[np.float32]:
        """What Burley's lobe sends in a direction over albedo times irradiance / pi, (..., n).

        The irradiance is that of the patch under its lobe, ``1 + κ S``. The product of both S is small; in it the mean
        angle stays.

        Args:
            patch: (n,) patch seen.
            roughness: (..., n) or (..., 1).
            schlick: (n,) S of the direction.
            toward: (n, 3) unit vectors away from the patch.
        """
        grazing, k = self.grazing[patch], roughness - 0.5
        kappa = grazing_gain("burley", roughness)
        light = 1 + k * grazing + roughness * dot(self.grazing_direction[patch], toward)
        view = k + roughness * dot(self.direction[patch], toward) + kappa**2 * grazing
        return ((light + schlick * view) / (1 + kappa * grazing)).astype(np.float32)

    def lobes(self, roughness: NDArray[np.floating]) -> NDArray[np.float32]:
        """(P, 2, 4) lobe of every patch of ``roughness`` (P,): :meth:`view_factor` is (1, S) M (1, v), v being the unit
        vector away from the patch."""
        patch = np.arange(len(self.grazing))

        def factor(schlick: float, axis: int | None = None) -> NDArray[np.float32]:
            toward = np.zeros((len(patch), 3), np.float32)
            if axis is not None:
                toward[:, axis] = 1
            return self.view_factor(patch, roughness, np.full(len(patch), schlick, np.float32), toward)

        # It is linear in v, and in S: eight values tell all.
        values = np.stack([np.stack([factor(s), *(factor(s, axis) for axis in range(3))]) for s in (0.0, 1.0)])
        values[:, 1:] -= values[:, :1]
        values[1] -= values[0]
        return np.moveaxis(values, 2, 0)


# ---- What a solve computes on ---------------------------------------------------------------------------------------


def choose_device(wanted: Literal["auto", "cpu", "cuda"]) -> str:
    """The torch device to use: a GPU where there is one, unless told otherwise.

    Raises:
        BadInput: a GPU was asked for and torch finds none.
    """
    available = torch.cuda.is_available()
    if wanted == "cuda" and not available:
        raise BadInput("torch finds no CUDA device", "use --device auto, or install the CUDA build of torch")
    return "cuda" if wanted != "cpu" and available else "cpu"
