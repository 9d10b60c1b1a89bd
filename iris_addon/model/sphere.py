"""Functions of direction: real spherical harmonics up to order 2, equirectangular pictures, and even lattices.

The first two are bases of light from outside the mesh. Pictures are as Cycles reads them: +z on top, row 0 of an array
above.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def sh_basis(directions: NDArray[np.floating], n: int = 9) -> NDArray[np.float64]:
    """(..., n) values of the first ``n`` in {1, 4, 9} orthonormal real harmonics at unit ``directions`` (..., 3).

    Order (l, m) = (0,0), (1,-1), (1,0), (1,1), (2,-2), ... and signs as in Ramamoorthi & Hanrahan 2001 (no
    Condon-Shortley phase): the band-1 functions are +y, +z, +x.
    """
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    functions = [
        np.full_like(x, 0.28209479177387814),
        0.4886025119029199 * y,
        0.4886025119029199 * z,
        0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        1.0925484305920792 * y * z,
        0.31539156525252005 * (3 * z * z - 1),
        1.0925484305920792 * x * z,
        0.5462742152960396 * (x * x - y * y),
    ]
    return np.stack(functions[:n], -1)


def sh_radiance(sh: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.float64]:
    """(..., 3) radiance at unit ``directions`` (..., 3) of the expansion ``sh`` (n, 3), clamped at zero."""
    return np.maximum(sh_basis(directions, len(sh)) @ sh, 0.0)


# ---- Equirectangular pictures ---------------------------------------------------------------------------------------


def equirect_directions(width: int, height: int) -> NDArray[np.float64]:
    """(height, width, 3) unit directions of the centres of the texels."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    azimuth, polar = -2 * np.pi * (u - 0.5), np.pi * v
    x, y = np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar)
    return np.stack([x, y, np.cos(polar)], -1).astype(np.float64)


def equirect_texels(directions: NDArray[np.floating], width: int, height: int) -> NDArray[np.int64]:
    """(n,) row-major texels that ``directions`` (n, 3), of any length, point to."""
    x, y, z = np.asarray(directions, np.float64).T
    u = 0.5 - np.arctan2(y, x) / (2 * np.pi)
    v = np.arctan2(np.hypot(x, y), z) / np.pi
    column = np.floor(u * width).astype(np.int64) % width
    row = np.clip(np.floor(v * height).astype(np.int64), 0, height - 1)
    return row * width + column


def even_directions(count: int) -> NDArray[np.float64]:
    """(count, 3) unit vectors spread evenly over the sphere, from +z down: a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z * z)
    return np.asarray(np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], -1), np.float64)


def dodecahedron() -> NDArray[np.float64]:
    """(12, 3) unit normals of a dodecahedron's faces: evenly spread directions."""
    golden = (1 + 5**0.5) / 2
    corners = [(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)]
    points = np.array([np.roll(c, k) for c in corners for k in range(3)])
    return points / np.linalg.norm(points[0])
