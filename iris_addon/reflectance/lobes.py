"""Specular radiance toward the cameras, by cached reflected rays.

FIPT's split (Wu et al. 2023, eq. 6): ``L_r = kd Ld + ks Ls0(σ) + Ls1(σ)`` with F0 = 1 - F1, F1 = (1 - h·ωi)^5. The
two lobes are integrals of incoming radiance over the visible GGX normals; their rays are traced once per roughness,
and what they hit is kept, so that a new guess of the lamps costs one look-up.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..parallel import BLOCK, over_blocks, over_random_blocks
from ..surface.samples import PixelSamples
from ..transport.diffuse import schlick
from ..transport.sampling import dot, ggx_directions, r2_sequence
from ..transport.tracer import Tracer
from ..transport.transport import Transport, find_patches, radiance_table
from .ggx import ray_alpha
from .specular_weights import visible_normal_weights


@dataclass(frozen=True)
class LobeRays:
    """Reflected rays of n points at one roughness each.

    Attributes:
        target: (n, S) int32 patch hit, UNKNOWN or ESCAPED.
        face: (n, S) int32 face hit, -1 where escaped.
        weight0, weight1: (n, S) float16, G1 F0 and G1 F1.
        schlick: (n, S) float16, S of the angle at which each ray arrives.
    """

    target: NDArray[np.int32]
    face: NDArray[np.int32]
    weight0: NDArray[np.float16]
    weight1: NDArray[np.float16]
    schlick: NDArray[np.float16]

    def radiance(
        self,
        patch_radiance: NDArray[np.floating],
        kappa: NDArray[np.floating],
        face_emission: NDArray[np.floating],
        unknown: NDArray[np.floating],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """``Ls0`` and ``Ls1``, (n, 3) each.

        Args:
            patch_radiance: (N, 3) reflected radiance of every patch, and ``kappa`` (N,) of its diffuse lobe.
            face_emission: (F, 3).
            unknown: (3,) for hits without a patch.
        """
        table, emits = radiance_table(patch_radiance, unknown), face_emission.any(1)
        n, samples = self.target.shape
        ls0, ls1 = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)

        def work(rows: slice) -> None:
            target, face = self.target[rows], self.face[rows]
            own = np.where(target >= 0, kappa[target], 0.0)
            spread = (1 + own * self.schlick[rows]).astype(np.float32)
            incoming = table[target] * spread[..., None]
            on_lamp = (face >= 0) & emits[face]
            incoming[on_lamp] = face_emission[face[on_lamp]]
            for result, weight in ((ls0, self.weight0), (ls1, self.weight1)):
                result[rows] = np.einsum("ns,nsc->nc", weight[rows].astype(np.float32), incoming) / samples

        over_blocks(n, BLOCK // samples, work)
        return ls0, ls1


def trace_lobes(
    tracer: Tracer,
    transport: Transport,
    parts: NDArray[np.int32],
    samples: PixelSamples,
    rows: NDArray[np.integer],
    roughness: NDArray[np.floating],
    n_rays: int,
    rng: np.random.Generator,
) -> LobeRays:
    """Reflected rays of some pixels, on the calling thread alone.

    Args:
        rows: (n,) the pixels among ``samples``.
        roughness: (n,) Principled roughness.
    """
    u = r2_sequence(len(rows), n_rays, rng).reshape(-1, 2)
    normals = np.repeat(samples.normal[rows], n_rays, 0)
    alpha = np.repeat(ray_alpha(roughness), n_rays)
    direction, half_cosine = ggx_directions(normals, np.repeat(samples.direction[rows], n_rays, 0), alpha, u)
    weight0, weight1, above = visible_normal_weights(normals, direction, half_cosine, alpha)
    origin = np.repeat(samples.position[rows], n_rays, 0) + tracer.epsilon * normals
    hits = tracer.closest(origin, np.where(above[:, None], direction, normals))
    point = origin + direction * np.where(hits.face >= 0, hits.distance, 0)[:, None]
    target = find_patches(tracer, transport.grids, parts, hits.face, point, direction)
    arrival = schlick(np.abs(dot(tracer.normals[hits.face], direction)))
    shape = (len(rows), n_rays)
    return LobeRays(
        target.reshape(shape),
        hits.face.reshape(shape),
        weight0.reshape(shape).astype(np.float16),
        weight1.reshape(shape).astype(np.float16),
        arrival.reshape(shape).astype(np.float16),
    )


def lobe_cache(
    tracer: Tracer,
    transport: Transport,
    parts: NDArray[np.int32],
    samples: PixelSamples,
    rows: NDArray[np.integer],
    roughness: NDArray[np.floating],
    n_rays: int,
    rng: np.random.Generator,
) -> LobeRays:
    """:func:`trace_lobes` on all cores, for rays that are looked at more than once."""
    shape = (len(rows), n_rays)
    indices = np.empty(shape, np.int32), np.empty(shape, np.int32)
    weights = np.empty(shape, np.float16), np.empty(shape, np.float16), np.empty(shape, np.float16)
    cache = LobeRays(*indices, *weights)

    def work(block: slice, rng: np.random.Generator) -> None:
        piece = trace_lobes(tracer, transport, parts, samples, rows[block], roughness[block], n_rays, rng)
        for field in fields(LobeRays):
            getattr(cache, field.name)[block] = getattr(piece, field.name)

    over_random_blocks(len(rows), BLOCK // n_rays, work, rng)
    return cache
