"""Directions and points to shoot rays with, from well-spread low-discrepancy sequences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# R2 sequence (Roberts 2018): additive recurrence with the plastic number.
_PLASTIC = 1.32471795724474602596
_R2 = np.array([1 / _PLASTIC, 1 / _PLASTIC**2])


def dot(a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.floating]:
    """(n,) dot products of vectors (n, 3)."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def r2_sequence(n_rows: int, n_columns: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """(n_rows, n_columns, 2) points in [0, 1)²: the same R2 sequence per row under a random shift of its own."""
    base = ((np.arange(1, n_columns + 1)[:, None] * _R2) % 1.0).astype(np.float32)
    points = base[None] + rng.random((n_rows, 1, 2), np.float32)
    points -= points >= 1
    return points


def tangent_frame(normal: NDArray[np.floating]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Two unit vectors that complete each unit normal (n, 3) to a basis (Duff et al. 2017).

    They lie in memory coordinate by coordinate: to scale them is then one loop over all and not one over three each.
    """
    x, y, z = normal.astype(np.float32).T
    sign = np.where(z >= 0, np.float32(1), np.float32(-1))
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1 + sign * x**2 * a, sign * b, -sign * x]).T, np.stack([b, sign + y**2 * a, -y]).T


def cosine_directions(normal: NDArray[np.floating], u: NDArray[np.floating]) -> NDArray[np.float32]:
    """Cosine-distributed unit directions about normals (n, 3) from random numbers (n, 2)."""
    tangent, bitangent = tangent_frame(normal)
    radius, angle = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    z = np.sqrt(np.maximum(1 - u[:, 0], 1e-6))
    return (tangent * x[:, None] + bitangent * y[:, None] + normal * z[:, None]).astype(np.float32, copy=False)


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
    vx, vy, vz = dot(outgoing, tangent), dot(outgoing, bitangent), dot(outgoing, normal)
    # The view direction on the unit hemisphere of normals, stretched; t1 and t2 span the disc it sees.
    sx, sy = alpha * vx, alpha * vy
    length = np.sqrt(sx**2 + sy**2 + vz**2)
    sx, sy, sz = sx / length, sy / length, vz / length
    across = sx**2 + sy**2
    inverse = 1 / np.sqrt(np.maximum(across, 1e-12))
    slanted = across > 1e-9
    t1x, t1y = np.where(slanted, -sy * inverse, 1), np.where(slanted, sx * inverse, 0)
    t2x, t2y, t2z = -sz * t1y, sz * t1x, sx * t1y - sy * t1x
    radius, angle = np.sqrt(u[:, 0]), np.float32(2 * np.pi) * u[:, 1]
    p1, p2 = radius * np.cos(angle), radius * np.sin(angle)
    s = 0.5 * (1 + sz)
    p2 = (1 - s) * np.sqrt(np.maximum(1 - p1**2, 0)) + s * p2
    p3 = np.sqrt(np.maximum(1 - p1**2 - p2**2, 0))
    hx, hy = alpha * (t1x * p1 + t2x * p2 + sx * p3), alpha * (t1y * p1 + t2y * p2 + sy * p3)
    hz = np.maximum(t2z * p2 + sz * p3, 1e-6)
    length = np.sqrt(hx**2 + hy**2 + hz**2)
    cosine = (vx * hx + vy * hy + vz * hz) / length
    twice = 2 * cosine / length
    lx, ly, lz = twice * hx - vx, twice * hy - vy, twice * hz - vz
    world = tangent * lx[:, None] + bitangent * ly[:, None] + normal * lz[:, None]
    return world.astype(np.float32, copy=False), np.clip(cosine, 0, 1).astype(np.float32, copy=False)
