"""Weights and density of reflected rays drawn from visible GGX normals, split by the Fresnel terms F0 and F1."""

from __future__ import annotations

import math

from ..base.compiled import Real, inlined
from ..rays.sampling import Vector
from .ggx import DIELECTRIC_F0, IOR

HORIZON = 1e-3
"""Cosine to the normal below which a direction counts as below the surface."""


@inlined
def masking(cosine: Real, alpha: Real) -> Real:
    """Smith's G1 of GGX for one direction, as :func:`iris_addon.brdf.ggx.smith_g1` has it for many."""
    square = alpha * alpha
    return 2 * cosine / (cosine + math.sqrt(square + (1 - square) * cosine * cosine))


@inlined
def visible_normal_weights(cosine: Real, half_cosine: Real, alpha: Real) -> tuple[Real, Real]:
    """``G1 F0`` and ``G1 F1`` of an incident direction; zero below the surface.

    Args:
        cosine: between the normal and the incident direction.
        half_cosine: between the half vector and the incident direction.
        alpha: GGX width.
    """
    if cosine <= HORIZON:
        return 0.0, 0.0
    inside = math.sqrt(1 - (1 - half_cosine * half_cosine) / IOR**2)
    across = (half_cosine - IOR * inside) / (half_cosine + IOR * inside)
    along = (IOR * half_cosine - inside) / (IOR * half_cosine + inside)
    fresnel = (0.5 * (across * across + along * along) - DIELECTRIC_F0) / (1 - DIELECTRIC_F0)
    g1 = masking(cosine, alpha)
    return g1 * (1 - fresnel), g1 * fresnel


@inlined
def visible_normal_density(n: Vector, o: Vector, i: Vector, alpha: Real) -> Real:
    """Probability per steradian of the direction ``i`` among those reflected off visible normals, D G1 / (4 n·o)
    (Heitz 2018, eq. 17).

    Args:
        n, o, i: normal, directions to the eye and to the light, unit; ``o`` above the surface.
        alpha: GGX width.
    """
    hx, hy, hz = o[0] + i[0], o[1] + i[1], o[2] + i[2]
    length = max(math.sqrt(hx * hx + hy * hy + hz * hz), 1e-9)
    hx, hy, hz = hx / length, hy / length, hz / length
    cosine = hx * n[0] + hy * n[1] + hz * n[2]
    if cosine <= 0:
        return 0.0
    # In sharp lobes only 1 − cos² matters, and rounding of cos would lose it.
    cx, cy, cz = hy * n[2] - hz * n[1], hz * n[0] - hx * n[2], hx * n[1] - hy * n[0]
    square = alpha * alpha
    spread = square * cosine * cosine + cx * cx + cy * cy + cz * cz
    facing = max(o[0] * n[0] + o[1] * n[1] + o[2] * n[2], 1e-3)
    return square / (math.pi * spread * spread) * masking(facing, alpha) / (4 * facing)
