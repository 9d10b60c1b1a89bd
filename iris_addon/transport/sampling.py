"""Directions and points to shoot rays with, from well-spread low-discrepancy sequences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# R2 sequence (Roberts 2018): additive recurrence with the plastic number.
_PLASTIC = 1.32471795724474602596
_R2 = np.array([1 / _PLASTIC, 1 / _PLASTIC**2])


def r2_sequence(n_rows: int, n_columns: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """(n_rows, n_columns, 2) points in [0, 1)²: the same R2 sequence per row under a random shift of its own."""
    base = (np.arange(1, n_columns + 1)[:, None] * _R2) % 1.0
    shift = rng.random((n_rows, 1, 2))
    return ((base[None] + shift) % 1.0).astype(np.float32)


def tangent_frame(normal: NDArray[np.floating]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Two unit vectors that complete each unit normal (n, 3) to a basis (Duff et al. 2017)."""
    n = normal.astype(np.float32)
    sign = np.where(n[:, 2] >= 0, np.float32(1), np.float32(-1))
    a = -1.0 / (sign + n[:, 2])
    b = n[:, 0] * n[:, 1] * a
    tangent = np.stack([1 + sign * n[:, 0] ** 2 * a, sign * b, -sign * n[:, 0]], -1)
    bitangent = np.stack([b, sign + n[:, 1] ** 2 * a, -n[:, 1]], -1)
    return tangent, bitangent


def cosine_directions(normal: NDArray[np.floating], u: NDArray[np.floating]) -> NDArray[np.float32]:
    """Cosine-distributed unit directions about normals (n, 3) from random numbers (n, 2)."""
    tangent, bitangent = tangent_frame(normal)
    radius, angle = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    z = np.sqrt(np.maximum(1 - u[:, 0], 1e-6))
    return (tangent * x[:, None] + bitangent * y[:, None] + normal * z[:, None]).astype(np.float32)


def ggx_directions(
    normal: NDArray[np.floating], outgoing: NDArray[np.floating], alpha: NDArray[np.floating], u: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Directions reflected off visible GGX normals (Heitz 2018, "Sampling the GGX Distribution of Visible Normals").

    Args:
        normal: (n, 3) unit, on the side of ``outgoing``.
        outgoing: (n, 3) unit, from the surface to the eye.
        alpha: (n,) GGX width (roughness squared).
        u: (n, 2) random numbers.

    Returns:
        Incident directions (n, 3), unit, and the half vector's cosine with them, (n,). A direction below the surface
        has a weight G2/G1 of zero.
    """
    tangent, bitangent = tangent_frame(normal)
    v = np.stack([(outgoing * tangent).sum(1), (outgoing * bitangent).sum(1), (outgoing * normal).sum(1)], -1)
    stretched = v * np.stack([alpha, alpha, np.ones_like(alpha)], -1)
    stretched /= np.linalg.norm(stretched, axis=1, keepdims=True)
    t1, t2 = tangent_frame(stretched)
    radius, angle = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    # tangent_frame's axes are arbitrary about the view vector, so the warp needs its own: t1 perpendicular to z.
    lensq = stretched[:, 0] ** 2 + stretched[:, 1] ** 2
    inverse = 1 / np.sqrt(np.maximum(lensq, 1e-12))
    flat = np.stack([-stretched[:, 1] * inverse, stretched[:, 0] * inverse, np.zeros_like(inverse)], -1)
    t1 = np.where((lensq > 1e-9)[:, None], flat, t1)
    t2 = np.cross(stretched, t1)
    p1, p2 = radius * np.cos(angle), radius * np.sin(angle)
    s = 0.5 * (1 + stretched[:, 2])
    p2 = (1 - s) * np.sqrt(np.maximum(1 - p1**2, 0)) + s * p2
    half = t1 * p1[:, None] + t2 * p2[:, None] + stretched * np.sqrt(np.maximum(1 - p1**2 - p2**2, 0))[:, None]
    half = np.stack([half[:, 0] * alpha, half[:, 1] * alpha, np.maximum(half[:, 2], 1e-6)], -1)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    cosine = (v * half).sum(1)
    local = 2 * cosine[:, None] * half - v
    world = tangent * local[:, :1] + bitangent * local[:, 1:2] + normal * local[:, 2:]
    return world.astype(np.float32), np.clip(cosine, 0, 1).astype(np.float32)
