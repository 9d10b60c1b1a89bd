"""Light that reaches patches by way of a glossy surface: gather rays go on where they hit one.

A floor that mirrors a window sends the window's light to the opposite wall; the mean radiance that cameras saw on that
floor does not tell it. Each gather ray that ends on a glossy dielectric or metal is continued by one reflected ray,
traced once the materials are known. The few that meet a lamp each stand for all of its light; what they carry is spread
over the patches around, else single patches would be too bright by half and their albedo dotted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..parallel import BLOCK, over_each, over_random_blocks
from ..surface.field import IrradianceField
from ..transport.diffuse import schlick
from ..transport.gather import GatherRays, Origins, emitter_of_face
from ..transport.sampling import dot, ggx_directions
from ..transport.sparse_rays import SparseRays
from ..transport.tracer import Tracer
from ..transport.transport import Transport, facing_normals, find_patches
from .ggx import ray_alpha
from .specular_weights import visible_normal_weights

SPREAD = 2.0
"""Width of the kernel, in patch sizes, that spreads bounced light over the neighbours of a patch."""
PASSES, MOST_PASSES = 4, 64
"""How often it is used: on as many patches as one of the paths to a lamp is to stand for."""


@dataclass(frozen=True)
class GlossyBounce:
    """Reflected continuations of gather rays.

    Attributes:
        paths: from the patch that gathers to what is met after the bounce, weighted by the specular reflectance there
            over the number of the patch's rays.
        kernel: (P, P) averages over the neighbours of every seen patch.
    """

    paths: SparseRays
    kernel: csr_matrix

    def gather_radiance(
        self, radiance: NDArray[np.floating], unknown: NDArray[np.floating], emitter_faces: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """(N, 3) irradiance / pi that the bounces carry from other patches; emitters are counted elsewhere."""
        arrived = self.paths.gather_radiance(radiance, unknown, emitter_faces)
        return self._spread(arrived, np.full(arrived.shape[1], PASSES))

    def form_factors(self, emitters: Sequence[NDArray[np.integer]], n_faces: int) -> NDArray[np.float32]:
        """(N, E) share of each emitter's radiance that the bounces carry, mean over channels."""
        hit, n_rows = emitter_of_face(emitters, n_faces)[self.paths.face], self.paths.n_rows
        on = hit >= 0
        flat = self.paths.row[on].astype(np.int64) * len(emitters) + hit[on]
        total = np.bincount(flat, self.paths.weight[on].mean(1), n_rows * len(emitters))
        met = np.bincount(hit[on], minlength=len(emitters))
        passes = np.clip(n_rows / np.maximum(met, 1), PASSES, MOST_PASSES).astype(np.int64)
        return self._spread(total.reshape(n_rows, len(emitters)), np.where(met > 0, passes, 0))

    def _spread(self, arrived: NDArray[np.number], passes: NDArray[np.integer]) -> NDArray[np.float32]:
        """What arrives at patches (N, C) averaged over the neighbours of the seen ones, ``passes`` (C,) times."""
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
    parts: NDArray[np.int32],
    roughness: NDArray[np.floating],
    specular_color: NDArray[np.floating],
    glossy: NDArray[np.bool_],
    rng: np.random.Generator,
) -> GlossyBounce:
    """Continue every gather ray that ends on a glossy part.

    Args:
        field: neighbourhoods of the seen patches.
        parts: (F,) part per face.
        roughness: (n_parts,) Principled roughness.
        specular_color: (n_parts, 3) reflectance at normal incidence: 0.04, or a metal's colour.
        glossy: (n_parts,) bool, parts on which paths go on.
    """

    on_glossy = np.append(glossy[parts], False)  # the last for rays that hit nothing

    def continued(start: int, origins: Origins, rays: GatherRays) -> SparseRays:
        row, column = np.nonzero(on_glossy[rays.face])
        kappa = transport.kappa[start : start + len(rays.face)]
        n = len(row)
        weight, target, face = np.empty((n, 3), np.float32), np.empty(n, np.int32), np.empty(n, np.int32)

        def work(block: slice, rng: np.random.Generator) -> None:
            at = row[block], column[block]
            weight[block], target[block], face[block] = _continue_rays(
                tracer, transport, parts, roughness, specular_color, origins, rays, kappa, *at, rng
            )

        over_random_blocks(n, BLOCK, work, rng)
        return SparseRays(transport.n_patches, (row + start).astype(np.int32), weight, target, face)

    seen = continued(0, transport.origins, transport.rays)
    unseen = continued(transport.n_seen, transport.unseen_origins, transport.unseen_rays)
    return GlossyBounce(SparseRays.joined([seen, unseen]), field.kernel(SPREAD))


def _continue_rays(
    tracer: Tracer,
    transport: Transport,
    parts: NDArray[np.int32],
    roughness: NDArray[np.floating],
    specular_color: NDArray[np.floating],
    origins: Origins,
    rays: GatherRays,
    kappa: NDArray[np.floating],
    row: NDArray[np.integer],
    column: NDArray[np.integer],
    rng: np.random.Generator,
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]:
    direction = rays.direction[row, column].astype(np.float32)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    face = rays.face[row, column]
    point_on_patch = column % origins.position.shape[1]
    start = origins.position[row, point_on_patch]
    normal = facing_normals(tracer, face, direction)
    point = start + direction * rays.distance[row, column][:, None] + 4 * tracer.epsilon * normal
    part = parts[face]
    alpha = ray_alpha(roughness[part])
    reflected, half_cosine = ggx_directions(normal, -direction, alpha, rng.random((len(row), 2), np.float32))
    weight0, weight1, above = visible_normal_weights(normal, reflected, half_cosine, alpha)
    hits = tracer.closest(point, np.where(above[:, None], reflected, normal))
    end = point + reflected * np.where(hits.face >= 0, hits.distance, 0)[:, None]
    target = find_patches(tracer, transport.grids, parts, hits.face, end, reflected)
    weight = specular_color[part] * weight0[:, None] + weight1[:, None]
    # The diffuse lobes at both ends of the path.
    leaving = 1 + kappa[row] * rays.schlick_start[row, column]
    arriving = schlick(np.abs(dot(tracer.normals[hits.face], reflected)))
    weight *= (leaving * transport.sent_back(target, arriving, reflected))[:, None]
    return (weight / rays.face.shape[1]).astype(np.float32), target, hits.face
