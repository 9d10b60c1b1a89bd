"""Light transport between patches, ``G`` of equation (1): where each gather ray ends, traced once.

Rows 0 ... P-1 are the patches that photos see. Rows P ... N-1 are surfaces that no photo sees but that gather rays
meet; their radiance is not observed and follows from transport. :func:`build_transport` traces,
:meth:`Transport.gather_radiance` is a bake under any radiance, and :class:`LightMoments` gives Burley's diffuse lobe
towards any direction.
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
"""Rays of a seen patch per ray of an unseen one, whose radiance is not observed and matters less."""


@dataclass(frozen=True)
class Transport:
    """Gather rays of all N patches.

    Attributes:
        n_seen: number P of patches that photos see.
        origins, unseen_origins: points on seen and unseen patches from which their rays start.
        rays, unseen_rays: of seen and of unseen patches.
        target, unseen_target: (P, R) and (N - P, R') int32 patch hit, UNKNOWN or ESCAPED.
        region: (N,) region of each patch.
        grid: finds the patch of a surface point among all N.
        kappa: (N,) grazing gain of the diffuse lobe of each patch, see :mod:`iris_addon.brdf.diffuse`; 0 is Lambert's.
        moments: where the light of the seen patches comes from, for the exact lobe of Burley; None for the lobe under
            light from all sides.
        device: of torch, on which rays are summed.
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
        """Number N of patches, seen and unseen."""
        return self.n_seen + len(self.unseen_target)

    def with_lobes(self, kappa: NDArray[np.floating], moments: LightMoments | None = None) -> Transport:
        """The same rays between patches of other diffuse lobes: grazing gains (N,), and the moments of their light."""
        return replace(self, kappa=kappa, moments=moments)

    def escaped(self) -> NDArray[np.float64]:
        """(N,) share of each patch's rays that leave the mesh."""
        return np.concatenate([(self.target == ESCAPED).mean(1), (self.unseen_target == ESCAPED).mean(1)])

    def unseen(self) -> float:
        """Share of the rays of seen patches that end on surfaces that no photo shows."""
        return float(((self.target >= self.n_seen) | (self.target == UNKNOWN)).mean()) if self.target.size else 0.0

    def gather_radiance(
        self, radiance: NDArray[np.floating], unknown: NDArray[np.floating], emitter_faces: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """``G L`` of equation (7): mean radiance over each patch's rays, weighted by the diffuse lobes at both ends.

        Args:
            radiance: (N, 3) of each patch, scene-linear Rec.709, without the view factor of its lobe.
            unknown: (3,) of surfaces without a patch.
            emitter_faces: (F,) bool, faces whose light is in form factors; rays that end there carry nothing.

        Returns:
            (N, 3) irradiance / pi, without emitters and without light from outside.
        """
        # Rolled by two: ESCAPED and UNKNOWN index from the end, which torch does not allow.
        table = torch.from_numpy(np.roll(radiance_table(radiance, unknown), 2, axis=0)).to(self.device)
        dark = np.append(emitter_faces, False)
        seen = _mean_of_targets(table, self.rays, self.target, dark, self._lobe_weights[0])
        unseen = _mean_of_targets(table, self.unseen_rays, self.unseen_target, dark, self._lobe_weights[1])
        return np.concatenate([seen, unseen])

    @cached_property
    def _lobe_weights(self) -> tuple[NDArray[np.float32] | None, NDArray[np.float32] | None]:
        """Weights (n, R) of the rays of seen and of unseen patches; None where all patches are Lambertian."""
        if not self.kappa.any():
            return None, None
        return (
            self._both_lobes(self.rays, self.target, self.kappa[: self.n_seen]),
            self._both_lobes(self.unseen_rays, self.unseen_target, self.kappa[self.n_seen :]),
        )

    def _both_lobes(self, rays: GatherRays, target: NDArray[np.int32], own: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n, R) the factor 1 + κ S where a ray starts, κ being ``own`` (n,), times that of the lobe where it ends."""
        weight = np.empty(target.shape, np.float32)

        def work(rows: slice) -> None:
            start, end = (s[rows].astype(np.float32) for s in (rays.schlick_start, rays.schlick_end))
            direction = rays.direction[rows].astype(np.float32)
            _lobe_weights(self.lobes, own[rows], target[rows], start, end, direction, weight[rows])

        over_blocks(len(target), BLOCK // target.shape[1], work)
        return weight

    @cached_property
    def lobes(self) -> NDArray[np.float32]:
        """(N + 2, 2, 4) lobes of :meth:`LightMoments.lobes`, for :func:`sent_back`: those under light from all sides
        where there are no moments, and the last two for ESCAPED and UNKNOWN."""
        lobes = np.zeros((self.n_patches + 2, 2, 4), np.float32)
        lobes[:, 0, 0] = 1
        lobes[: self.n_patches, 1, 0] = self.kappa
        if self.moments is not None:
            lobes[: self.n_seen] = self.moments.lobes(burley_roughness(self.kappa[: self.n_seen]))
        return lobes


@inlined
def sent_back(lobes: NDArray[np.float32], target: Integer, schlick: Real, dx: Real, dy: Real, dz: Real) -> Real:
    """Radiance that a patch sends back along a ray that meets it, over the radiance of the patch; 1 for no patch.

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
    """(n, 3) mean over the rays (n, R) of the radiance ``table`` (N + 2, 3), rolled by two.

    Args:
        target: (n, R) patch met.
        dark: (F + 1,) bool, faces whose rays carry nothing; the last entry is for rays that meet no face.
        weight: (n, R) of each ray, None for 1.
    """
    index = np.empty(target.shape, np.int32)

    def work(rows: slice) -> None:
        np.add(target[rows], 2, out=index[rows])
        np.putmask(index[rows], dark.take(rays.face[rows]), ESCAPED + 2)

    over_blocks(len(target), BLOCK // target.shape[1], work)
    at = torch.from_numpy(index).to(table.device)
    weights = None if weight is None else torch.from_numpy(weight).to(table.device)
    # On the CPU the mode "mean" takes seven times as long.
    total = torch.nn.functional.embedding_bag(at, table, mode="sum", per_sample_weights=weights)
    return (total / target.shape[1]).cpu().numpy()


def radiance_table(radiance: NDArray[np.floating], unknown: NDArray[np.floating]) -> NDArray[np.float32]:
    """(N + 2, 3) radiance of the patches (N, 3) and, last, of ESCAPED, which is 0, and UNKNOWN (3,), which index from
    the end."""
    return np.concatenate([radiance, np.zeros((1, 3)), np.asarray(unknown)[None]]).astype(np.float32)


def table_rows(target: NDArray[np.int32], face: NDArray[np.int32], dark_faces: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Row of :func:`radiance_table` for each ray; those that end on ``dark_faces`` (F,) carry nothing."""
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
    """Coarse patches where rays ended on surfaces that no photo sees, the ``limit`` most often hit.

    Returns:
        Their grid, the points their rays start from, and the region (n,) of each.
    """
    row, column = np.nonzero(target == UNKNOWN)
    face = rays.face[row, column]
    point = hit_point[row, column]
    normal = facing_normals(tracer, face, rays.direction[row, column].astype(np.float32))
    no_blocks = np.zeros(0, np.uint64), np.zeros(0, np.int8)
    keys = cell_keys(cells(surface.grid.origin, surface.grid.scale, *no_blocks), point, normal, regions[face])
    groups = group_equal(keys)
    count = groups.count
    kept = np.sort(np.argsort(-count, kind="stable")[:limit])
    # Such patches are large: rays start from the points that rays of other patches met.
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
    """Trace ``n_rays`` gather rays from each patch and find the patch that each one meets; all patches Lambertian.

    Args:
        regions: (F,) region of each face.
    """
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


# ---- Burley's lobe under the light of each patch -------------------------------------------------------------------


@dataclass(frozen=True)
class LightMoments:
    """Means over the light that reaches each of P seen patches, weighted by what it adds to irradiance.

    The separable lobe (9) replaces the angle between light and view by its mean, which is good where light comes from
    all sides. Beside a window a rough wall is brighter seen from the direction of its light than seen against it. The
    exact lobe is linear in the direction of light, since cos²θd = (1 + l·v) / 2, so that these means give it in every
    direction, equation (10).

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
        """(..., n) radiance that Burley's lobe sends in a direction, over albedo times irradiance / pi: equation (10).

        The irradiance is that of the patch under its lobe, 1 + κ S. In the small product of both S the mean angle is
        kept.

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

        # The factor is linear in v and in S: eight values determine it.
        values = np.stack([np.stack([factor(s), *(factor(s, axis) for axis in range(3))]) for s in (0.0, 1.0)])
        values[:, 1:] -= values[:, :1]
        values[1] -= values[0]
        return np.moveaxis(values, 2, 0)


def choose_device(wanted: Literal["auto", "cpu", "cuda"]) -> str:
    """The torch device to use: with "auto" a GPU where there is one.

    Raises:
        BadInput: a GPU is requested and torch finds none.
    """
    available = torch.cuda.is_available()
    if wanted == "cuda" and not available:
        raise BadInput("torch finds no CUDA device", "use --device auto, or install the CUDA build of torch")
    return "cuda" if wanted != "cpu" and available else "cpu"
