"""Glossy bounces: light that reaches patches by way of a glossy surface.

A floor that mirrors a window sends the window's light to the opposite wall, which the mean radiance that cameras saw on
the floor does not contain. Each gather ray that ends on a glossy surface is therefore continued by one reflected ray
once the materials are known, off a visible GGX normal (Heitz 2018). The few paths that meet a lamp each stand for all
of its light, so that what they carry is averaged over neighbouring patches: without that, single patches would be too
bright by half and their albedo speckled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..base.compiled import kernel
from ..base.group_by import entries_of
from ..base.parallel import BLOCK, over_each, over_random_blocks
from ..brdf.ggx import ray_alpha
from ..brdf.ggx_sampling import visible_normal_weights
from ..rays.sampling import Origins, ggx_direction, grazing, vector
from ..rays.tracer import Tracer
from ..surface.irradiance import IrradianceField
from ..surface.patches import Lookup
from .aimed_rays import SparseRays
from .form_factors import emitter_of_face
from .gather import GatherRays, find_patch
from .transport import Transport, sent_back

SPREAD_WIDTH = 2.0
"""Standard deviation, in patch sizes, of the kernel that averages bounced light over the neighbours of a patch."""
SPREAD_PASSES, SPREAD_MAX_PASSES = 4, 64
"""Times that the kernel is applied, fewest and most; between them, patches per path that meets the lamp."""


@dataclass(frozen=True)
class GlossyBounce:
    """Reflected continuations of gather rays.

    Attributes:
        paths: from the patch that gathers to the patch met after the bounce, weighted by the specular reflectance at
            the bounce over the number of the patch's rays.
        kernel: (P, P) averages over the neighbours of each seen patch.
    """

    paths: SparseRays
    kernel: csr_matrix

    def gather_radiance(
        self, radiance: NDArray[np.floating], unknown: NDArray[np.floating], emitter_faces: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """(N, 3) irradiance / pi that bounces carry from other patches; light of emitters is in :meth:`form_factors`.

        Args:
            radiance: (N, 3) of the patches.
            unknown: (3,) of surfaces without a patch.
            emitter_faces: (F,) bool.
        """
        arrived = self.paths.gather_radiance(radiance, unknown, emitter_faces)
        return self._spread(arrived, np.full(arrived.shape[1], SPREAD_PASSES))

    def form_factors(self, emitters: Sequence[NDArray[np.integer]], n_faces: int) -> NDArray[np.float32]:
        """(N, E) irradiance / pi that bounces carry per radiance of each emitter, mean over channels."""
        hit, n_rows = emitter_of_face(emitters, n_faces)[self.paths.face], self.paths.n_rows
        on = hit >= 0
        flat = self.paths.row[on].astype(np.int64) * len(emitters) + hit[on]
        total = np.bincount(flat, self.paths.weight[on].mean(1), n_rows * len(emitters))
        met = np.bincount(hit[on], minlength=len(emitters))
        passes = np.clip(n_rows / np.maximum(met, 1), SPREAD_PASSES, SPREAD_MAX_PASSES).astype(np.int64)
        return self._spread(total.reshape(n_rows, len(emitters)), np.where(met > 0, passes, 0))

    def _spread(self, arrived: NDArray[np.number], passes: NDArray[np.integer]) -> NDArray[np.float32]:
        """What arrives at patches (N, C), averaged over the neighbours of each seen patch, ``passes`` (C,) times."""
        spread = arrived.astype(np.float32)
        n_seen = len(self.kernel.indptr) - 1

        def one(column: int) -> None:
            values = np.ascontiguousarray(spread[:n_seen, column])
            for _ in range(passes[column]):
                values = self.kernel @ values
            spread[:n_seen, column] = values

        over_each(range(len(passes)), one)
        return spread


def trace_glossy_bounce(
    tracer: Tracer,
    transport: Transport,
    field: IrradianceField,
    regions: NDArray[np.int32],
    roughness: NDArray[np.floating],
    specular_color: NDArray[np.floating],
    glossy: NDArray[np.bool_],
    rng: np.random.Generator,
) -> GlossyBounce:
    """Continue every gather ray that ends on a glossy region.

    Args:
        field: neighbourhoods of the seen patches.
        regions: (F,) region of each face.
        roughness: (n_regions,) Principled roughness.
        specular_color: (n_regions, 3) reflectance at normal incidence, linear Rec.709: 0.04, or a metal's colour.
        glossy: (n_regions,) bool, regions off which rays are continued.
    """
    on_glossy = np.append(glossy[regions], False)  # the last entry is for rays that hit nothing
    mirrors = _Mirrors(
        tracer=tracer, transport=transport, regions=regions, roughness=roughness, specular_color=specular_color
    )

    def continued(start: int, origins: Origins, rays: GatherRays) -> SparseRays:
        row, column = entries_of(rays.face, on_glossy)
        kappa = transport.kappa[start : start + len(rays.face)]
        n = len(row)
        weight, target, face = np.empty((n, 3), np.float32), np.empty(n, np.int32), np.empty(n, np.int32)

        def work(block: slice, rng: np.random.Generator) -> None:
            at = row[block], column[block]
            weight[block], target[block], face[block] = mirrors.continue_rays(origins, rays, kappa, *at, rng)

        over_random_blocks(n, BLOCK, work, rng)
        return SparseRays(
            n_rows=transport.n_patches, row=(row + start).astype(np.int32), weight=weight, target=target, face=face
        )

    seen = continued(0, transport.origins, transport.rays)
    unseen = continued(transport.n_seen, transport.unseen_origins, transport.unseen_rays)
    return GlossyBounce(SparseRays.joined([seen, unseen]), field.kernel(SPREAD_WIDTH))


@kernel
def _reflect(
    point: NDArray[np.float32],
    direction: NDArray[np.float32],
    distance: NDArray[np.float32],
    normals: NDArray[np.float32],
    face: NDArray[np.int32],
    alpha: NDArray[np.float32],
    colour: NDArray[np.floating],
    u: NDArray[np.float32],
    epsilon: float,
    along: NDArray[np.float32],
    weight: NDArray[np.float32],
) -> None:
    """Move ``point`` (n, 3) to where its ray ends, just off the surface, and reflect the ray there.

    Directions below the surface get no weight (n, 3) and are replaced by its normal.
    """
    for i in range(len(face)):
        d, n = vector(direction, i), vector(normals, face[i])
        length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])  # stored in half precision
        d = d[0] / length, d[1] / length, d[2] / length
        if n[0] * d[0] + n[1] * d[1] + n[2] * d[2] > 0:
            n = -n[0], -n[1], -n[2]
        x, y, z, half = ggx_direction(n, (-d[0], -d[1], -d[2]), alpha[i], u[i, 0], u[i, 1])
        w0, w1 = visible_normal_weights(x * n[0] + y * n[1] + z * n[2], half, alpha[i])
        along[i, 0], along[i, 1], along[i, 2] = (x, y, z) if w0 + w1 > 0 else n
        for c in range(3):
            point[i, c] += d[c] * distance[i] + 4 * epsilon * n[c]
            weight[i, c] = colour[i, c] * w0 + w1


@kernel
def _arrive(
    start: NDArray[np.float32],
    along: NDArray[np.float32],
    face: NDArray[np.int32],
    distance: NDArray[np.float32],
    grid: Lookup,
    normals: NDArray[np.float32],
    regions: NDArray[np.int32],
    lobes: NDArray[np.float32],
    leaving: NDArray[np.floating],
    n_rays: int,
    weight: NDArray[np.float32],
    target: NDArray[np.int32],
) -> None:
    """Write the patch that each path meets, and multiply its weight by the diffuse lobes at both its ends."""
    for i in range(len(face)):
        f, reach = face[i], distance[i] if face[i] >= 0 else np.float32(0)
        dx, dy, dz = vector(along, i)
        x, y, z = start[i, 0] + reach * dx, start[i, 1] + reach * dy, start[i, 2] + reach * dz
        target[i] = find_patch(grid, normals, regions, f, x, y, z, dx, dy, dz)
        cosine = dx * normals[f, 0] + dy * normals[f, 1] + dz * normals[f, 2] if f >= 0 else 1.0
        factor = leaving[i] * sent_back(lobes, target[i], grazing(abs(cosine)), dx, dy, dz) / n_rays
        for c in range(3):
            weight[i, c] *= factor


@dataclass(frozen=True)
class _Mirrors:
    """The glossy surfaces that gather rays end on, and the room that they reflect.

    Attributes:
        regions: (F,) region of each face.
        roughness: (n_regions,) Principled roughness.
        specular_color: (n_regions, 3) reflectance at normal incidence, linear Rec.709.
    """

    tracer: Tracer
    transport: Transport
    regions: NDArray[np.int32]
    roughness: NDArray[np.floating]
    specular_color: NDArray[np.floating]

    def continue_rays(
        self,
        origins: Origins,
        rays: GatherRays,
        kappa: NDArray[np.floating],
        row: NDArray[np.integer],
        column: NDArray[np.integer],
        rng: np.random.Generator,
    ) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]:
        """Reflect the gather rays ``row``, ``column`` (n,) of ``rays`` (P, R) where they end.

        Args:
            kappa: (P,) grazing gain of the patches that the rays start from.

        Returns:
            Weight (n, 3) of the radiance met, and patch and face met (n,).
        """
        tracer, transport, regions = self.tracer, self.transport, self.regions
        n, region = len(row), regions[rays.face[row, column]]
        point = origins.position[row, column % origins.position.shape[1]]
        along, weight, target = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32), np.empty(n, np.int32)
        _reflect(
            point,
            rays.direction[row, column].astype(np.float32),
            rays.distance[row, column],
            tracer.normals,
            rays.face[row, column],
            ray_alpha(self.roughness[region]),
            self.specular_color[region],
            rng.random((n, 2), np.float32),
            tracer.epsilon,
            along,
            weight,
        )
        hits = tracer.closest(point, along)
        leaving = 1 + kappa[row] * rays.schlick_start[row, column]
        _arrive(
            point, along, hits.face, hits.distance, transport.grid.lookup, tracer.normals, regions,
            transport.lobes, leaving, rays.face.shape[1], weight, target,
        )  # fmt: skip
        return weight, target, hits.face
