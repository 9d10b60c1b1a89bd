"""Specular radiance toward the cameras, by cached reflected rays.

FIPT's split (Wu et al. 2023, eq. 6): ``L_r = kd Ld + ks Ls0(σ) + Ls1(σ)`` with F0 = 1 - F1, F1 = (1 - h·ωi)^5. The
two lobes are integrals of incoming radiance over the visible GGX normals; their rays are traced once per roughness,
and what they hit is kept, so that a new guess of the lamps costs one look-up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..surface.samples import PixelSamples
from ..transport.diffuse import schlick
from ..transport.sampling import ggx_directions, r2_sequence
from ..transport.tracer import Tracer
from ..transport.transport import ESCAPED, Transport, find_patches, radiance_table, table_rows
from .specular_weights import visible_normal_weights

POINTS_AT_ONCE = 1 << 15


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
        rows = table_rows(self.target, len(patch_radiance), self.target == ESCAPED)
        lit = face_emission.any(1)
        own = np.where(self.target >= 0, kappa[self.target], 0.0)
        spread = (1 + own * self.schlick).astype(np.float32)
        incoming = radiance_table(patch_radiance, unknown)[rows] * spread[..., None]
        on_lamp = (self.face >= 0) & lit[self.face]
        incoming[on_lamp] = face_emission[self.face[on_lamp]]
        w0, w1 = self.weight0.astype(np.float32), self.weight1.astype(np.float32)
        samples = self.target.shape[1]
        return np.einsum("ns,nsc->nc", w0, incoming) / samples, np.einsum("ns,nsc->nc", w1, incoming) / samples


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
    """Reflected rays of some pixels.

    Args:
        rows: (n,) the pixels among ``samples``.
        roughness: (n,) Principled roughness.
    """
    n = len(rows)
    target = np.empty((n, n_rays), np.int32)
    face = np.empty((n, n_rays), np.int32)
    weight0 = np.empty((n, n_rays), np.float16)
    weight1 = np.empty((n, n_rays), np.float16)
    arrival = np.empty((n, n_rays), np.float16)
    for start in range(0, n, POINTS_AT_ONCE):
        block = slice(start, min(start + POINTS_AT_ONCE, n))
        at = rows[block]
        u = r2_sequence(len(at), n_rays, rng).reshape(-1, 2)
        normals = np.repeat(samples.normal[at], n_rays, 0)
        alpha = np.repeat(np.maximum(roughness[block], 0.05) ** 2, n_rays).astype(np.float32)
        direction, half_cosine = ggx_directions(normals, np.repeat(samples.direction[at], n_rays, 0), alpha, u)
        w0, w1, above = visible_normal_weights(normals, direction, half_cosine, alpha)
        origin = np.repeat(samples.position[at], n_rays, 0) + tracer.epsilon * normals
        hits = tracer.closest(origin, np.where(above[:, None], direction, normals))
        point = origin + direction * np.where(hits.face >= 0, hits.distance, 0)[:, None]
        patch = find_patches(tracer, transport.grids, parts, hits.face, point, direction)
        shape = (len(at), n_rays)
        target[block] = patch.reshape(shape)
        face[block] = hits.face.reshape(shape)
        weight0[block] = w0.reshape(shape)
        weight1[block] = w1.reshape(shape)
        cosine = np.abs((tracer.normals[hits.face] * direction).sum(1))
        arrival[block] = schlick(cosine).reshape(shape)
    return LobeRays(target, face, weight0, weight1, arrival)
