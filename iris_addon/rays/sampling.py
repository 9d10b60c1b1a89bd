"""Sampling patterns: low-discrepancy points, directions drawn from them, and the origins of rays on patches."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Integer, Real, inlined

# R2 sequence (Roberts 2018): additive recurrence with the plastic number.
_PLASTIC = 1.32471795724474602596
_R2 = np.array([1 / _PLASTIC, 1 / _PLASTIC**2])


def dot(a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.floating]:
    """(n,) dot products of vectors (n, 3)."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def r2_sequence(n_rows: int, n_columns: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """(n_rows, n_columns, 2) points in [0, 1)²: one R2 sequence, under a random shift per row."""
    base = ((np.arange(1, n_columns + 1)[:, None] * _R2) % 1.0).astype(np.float32)
    points = base[None] + rng.random((n_rows, 1, 2), np.float32)
    points -= points >= 1
    return points


Vector = tuple[Real, Real, Real]


@inlined
def vector(values: NDArray[np.floating], i: Integer) -> Vector:
    """Row ``i`` of (n, 3)."""
    return values[i, 0], values[i, 1], values[i, 2]


@inlined
def grazing(cosine: Real) -> Real:
    """Schlick's S of one cosine to the normal, (1 − c)^5."""
    x = 1.0 - min(max(cosine, 0.0), 1.0)
    return x * x * x * x * x


@inlined
def tangent_frame(nx: Real, ny: Real, nz: Real) -> tuple[Vector, Vector]:
    """Two unit vectors that complete a unit normal to a basis (Duff et al. 2017)."""
    sign = 1.0 if nz >= 0 else -1.0
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    return (1 + sign * nx * nx * a, sign * b, -sign * nx), (b, sign + ny * ny * a, -ny)


@inlined
def cosine_direction(nx: Real, ny: Real, nz: Real, u: Real, v: Real) -> Vector:
    """Cosine-distributed unit direction about a normal from a point (u, v) of the unit square."""
    t, b = tangent_frame(nx, ny, nz)
    radius, angle = math.sqrt(u), np.float32(2 * np.pi * v)
    x, y, z = radius * math.cos(angle), radius * math.sin(angle), math.sqrt(max(1 - u, 1e-6))
    return x * t[0] + y * b[0] + z * nx, x * t[1] + y * b[1] + z * ny, x * t[2] + y * b[2] + z * nz


@inlined
def ggx_direction(n: Vector, o: Vector, alpha: Real, u: Real, v: Real) -> tuple[Real, Real, Real, Real]:
    """Direction reflected off a visible GGX normal (Heitz 2018, "Sampling the GGX Distribution of Visible Normals").

    Args:
        n: unit, on the side of ``o``.
        o: unit, from the surface to the eye.
        alpha: GGX width (roughness squared).
        u, v: a point of the unit square.

    Returns:
        The incident direction, unit, and the half vector's cosine with it. A direction below the surface has a weight
        G2/G1 of zero.
    """
    t, b = tangent_frame(n[0], n[1], n[2])
    vx, vy = o[0] * t[0] + o[1] * t[1] + o[2] * t[2], o[0] * b[0] + o[1] * b[1] + o[2] * b[2]
    vz = o[0] * n[0] + o[1] * n[1] + o[2] * n[2]
    # The view direction on the unit hemisphere of normals, stretched; t1 and t2 span the disc it sees.
    sx, sy = alpha * vx, alpha * vy
    length = math.sqrt(sx * sx + sy * sy + vz * vz)
    sx, sy, sz = sx / length, sy / length, vz / length
    across = sx * sx + sy * sy
    t1x, t1y = 1.0, 0.0
    if across > 1e-9:
        inverse = 1 / math.sqrt(across)
        t1x, t1y = -sy * inverse, sx * inverse
    t2x, t2y, t2z = -sz * t1y, sz * t1x, sx * t1y - sy * t1x
    radius, angle = math.sqrt(u), np.float32(2 * np.pi * v)
    p1, p2 = radius * math.cos(angle), radius * math.sin(angle)
    s = 0.5 * (1 + sz)
    p2 = (1 - s) * math.sqrt(max(1 - p1 * p1, 0.0)) + s * p2
    p3 = math.sqrt(max(1 - p1 * p1 - p2 * p2, 0.0))
    hx, hy = alpha * (t1x * p1 + t2x * p2 + sx * p3), alpha * (t1y * p1 + t2y * p2 + sy * p3)
    hz = max(t2z * p2 + sz * p3, 1e-6)
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    cosine = (vx * hx + vy * hy + vz * hz) / length
    twice = 2 * cosine / length
    x, y, z = twice * hx - vx, twice * hy - vy, twice * hz - vz
    return (
        x * t[0] + y * b[0] + z * n[0],
        x * t[1] + y * b[1] + z * n[1],
        x * t[2] + y * b[2] + z * n[2],
        min(max(cosine, 0.0), 1.0),
    )


@dataclass(frozen=True)
class Origins:
    """Points on patches from which rays start: ``k`` per patch, picked among the pixels that show it.

    Attributes:
        position: (P, k, 3) float32 metres.
        normal: (P, k, 3) float32 unit, on the visible side.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]

    def flat(self, rows: slice) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
        """The points of some patches for kernels: positions and normals, (rows · k, 3) each, and k."""
        return self.position[rows].reshape(-1, 3), self.normal[rows].reshape(-1, 3), self.position.shape[1]
