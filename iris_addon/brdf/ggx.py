"""GGX reflectance: Fresnel and masking terms, visible normals, and directional albedo under uniform light.

The model is that of FIPT (Wu et al. 2023, eq. 5) and IRIS: base colour a, roughness σ (GGX α = σ²), metallic m,

    kd = a (1 − m),   ks = a m + 0.04 (1 − m),   F = ks F0 + F1,   F0 = 1 − F1

    a'(ωo) = kd + ks ∫ F0 D G + ∫ F1 D G        (integrals over ωi with the cosine and 1 / (4 n·ωi n·ωo) inside)

F1 is Schlick's (1 − h·ωi)^5 there. Here it is what makes F that of a dielectric of IOR 1.5 (:func:`grazing_fresnel`):
renderers reflect that, and Schlick's curve is a fifth below it at 60 degrees.

The two integrals depend on σ and n·ωo alone and are tabulated on first use. Single scattering only: at high roughness
F0 + F1 integrate to less than 1, the energy of further bounces between microfacets is lost, as in the model itself.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import BLOCK, over_blocks

FloatArray = NDArray[np.floating]

IOR = 1.5
DIELECTRIC_F0 = ((IOR - 1) / (IOR + 1)) ** 2
MIN_ROUGHNESS = 0.03  # below, α² underflows towards a perfect mirror, whose integrals no longer change
MIN_TRACED_ROUGHNESS = 0.05
"""Lobes of smaller roughness are traced with this one."""
N_ROUGHNESS, N_COSINE, N_SAMPLES = 48, 64, 1024
"""Size of the table of integrals, and samples of each."""


def grazing_fresnel(cosine: FloatArray) -> FloatArray:
    """F1: 0.04 F0 + F1 is what a dielectric of IOR 1.5 reflects (Fresnel's equations, unpolarised).

    Args:
        cosine: (...) between the half vector and the incident direction, in [0, 1].

    Returns:
        (...) 0 head-on to 1 at grazing.
    """
    inside = np.sqrt(1 - (1 - cosine**2) / IOR**2)
    across = ((cosine - IOR * inside) / (cosine + IOR * inside)) ** 2
    along = ((IOR * cosine - inside) / (IOR * cosine + inside)) ** 2
    return (0.5 * (across + along) - DIELECTRIC_F0) / (1 - DIELECTRIC_F0)


def ray_alpha(roughness: FloatArray) -> NDArray[np.float32]:
    """GGX width of the lobes that are traced, σ²; MIN_TRACED_ROUGHNESS at least."""
    return (np.maximum(roughness, MIN_TRACED_ROUGHNESS) ** 2).astype(np.float32)


def smith_g1(cosine: FloatArray, alpha: FloatArray | float) -> FloatArray:
    """Smith's masking term of GGX for one direction at angle ``cosine`` to the normal, in [0, 1]."""
    return 2 * cosine / (cosine + np.sqrt(alpha**2 + (1 - alpha**2) * cosine**2))


def visible_normals(alpha: float, cosine: FloatArray, u: FloatArray) -> FloatArray:
    """Half vectors drawn from the visible normals of GGX (Heitz 2018, listing 1).

    Args:
        cosine: (C,) n·ωo of outgoing directions in the xz plane.
        u: (S, 2) points of the unit square.

    Returns:
        (C, S, 3) unit half vectors, z along the normal.
    """
    sine = np.sqrt(1 - cosine**2)
    view = np.stack([alpha * sine, np.zeros_like(cosine), cosine], -1)  # stretched to the hemisphere configuration
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    tangent = np.tile([0.0, 1.0, 0.0], (len(cosine), 1))
    bitangent = np.cross(view, tangent)

    radius, phi = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    t1 = np.broadcast_to(radius * np.cos(phi), (len(cosine), len(u)))
    s = 0.5 * (1 + view[:, 2:3])
    t2 = (1 - s) * np.sqrt(1 - t1**2) + s * radius * np.sin(phi)
    t3 = np.sqrt(np.maximum(0, 1 - t1**2 - t2**2))

    half = t1[..., None] * tangent[:, None] + t2[..., None] * bitangent[:, None] + t3[..., None] * view[:, None]
    half *= [alpha, alpha, 1.0]
    return half / np.linalg.norm(half, axis=-1, keepdims=True)


def _integrals(roughness: float, cosine: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """∫ F0 D G and ∫ F1 D G, (C,) each. Sampling visible normals leaves G1(ωi) as the whole weight, which is ≤ 1."""
    alpha = roughness**2
    half = visible_normals(alpha, cosine, u)
    outgoing = np.stack([np.sqrt(1 - cosine**2), np.zeros_like(cosine), cosine], -1)
    h_dot_o = np.clip(np.einsum("csk,ck->cs", half, outgoing), 0, 1)
    incoming_z = 2 * h_dot_o * half[..., 2] - cosine[:, None]
    weight = np.where(incoming_z > 0, smith_g1(np.maximum(incoming_z, 0), alpha), 0.0)
    f1 = grazing_fresnel(h_dot_o)
    return np.mean(weight * (1 - f1), 1), np.mean(weight * f1, 1)


@lru_cache(maxsize=1)
def _table() -> FloatArray:
    """(2, N_ROUGHNESS, N_COSINE) both integrals over uniform grids of roughness and cosine."""
    # The R2 sequence (Roberts 2018) covers the square more evenly than random points.
    u = (0.5 + np.arange(1, N_SAMPLES + 1)[:, None] * [0.7548776662466927, 0.5698402909980532]) % 1.0
    cosine = np.linspace(0, 1, N_COSINE)
    cosine[0] = 1e-3  # the integrals have a limit at grazing view, the formulas are 0 / 0 there
    roughness = np.linspace(MIN_ROUGHNESS, 1, N_ROUGHNESS)
    table = np.empty((2, N_ROUGHNESS, N_COSINE))

    def work(rows: slice) -> None:
        for row in range(rows.start, rows.stop):
            table[:, row] = _integrals(roughness[row], cosine, u)

    over_blocks(N_ROUGHNESS, 1, work)
    return table


def specular_integrals(roughness: FloatArray, cos_theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """∫ F0 D G and ∫ F1 D G for arrays of one shape (...), interpolated in the table.

    Args:
        roughness: Principled roughness; clamped to [0.03, 1].
        cos_theta: n·ωo; clamped to [0, 1].
    """
    roughness, cos_theta = (np.asarray(x, np.float64) for x in (roughness, cos_theta))
    integrals, table = np.empty((2, roughness.size)), _table()
    sigma, cosine = roughness.ravel(), cos_theta.ravel()
    over_blocks(roughness.size, BLOCK, lambda rows: _look_up(table, sigma[rows], cosine[rows], integrals[:, rows]))
    f0, f1 = integrals.reshape(2, *roughness.shape)
    return f0, f1


def _look_up(table: FloatArray, roughness: FloatArray, cosine: FloatArray, integrals: FloatArray) -> None:
    """Bilinear look-ups into ``integrals`` (2, n)."""
    row = (np.clip(roughness, MIN_ROUGHNESS, 1) - MIN_ROUGHNESS) / (1 - MIN_ROUGHNESS) * (N_ROUGHNESS - 1)
    column = np.clip(cosine, 0, 1) * (N_COSINE - 1)
    i = np.minimum(row.astype(np.int64), N_ROUGHNESS - 2)
    j = np.minimum(column.astype(np.int64), N_COSINE - 2)
    s, t, at = row - i, column - j, i * N_COSINE + j
    for values, result in zip(table.reshape(2, -1), integrals, strict=True):
        near, far = ((1 - t) * values.take(first) + t * values.take(first + 1) for first in (at, at + N_COSINE))
        result[:] = (1 - s) * near + s * far


@lru_cache(maxsize=1)
def _mean_left() -> FloatArray:
    """(N_ROUGHNESS,) share of diffuse light that a dielectric layer lets out, mean over cosine-weighted directions."""
    cosine = (np.arange(256) + 0.5) / 256
    roughness = np.linspace(MIN_ROUGHNESS, 1, N_ROUGHNESS)
    f0, f1 = specular_integrals(*np.broadcast_arrays(roughness[:, None], cosine))
    return (2 * cosine * (1 - DIELECTRIC_F0 * f0 - f1)).mean(1)


def layered_factor(roughness: FloatArray, cos_theta: FloatArray) -> FloatArray:
    """Share of the diffuse light that a dielectric layer lets out towards a viewer, over its mean.

    The layer takes off the light that it reflects itself, 0.04 ∫ F0 D G + ∫ F1 D G, as Blender's Principled BSDF
    does. The albedo below it is that of the light let out on average.

    Args:
        roughness, cos_theta: as in :func:`specular_integrals`; of shapes that broadcast.
    """
    roughness, cos_theta = np.broadcast_arrays(roughness, cos_theta)
    f0, f1 = specular_integrals(roughness, cos_theta)
    mean = np.interp(roughness, np.linspace(MIN_ROUGHNESS, 1, N_ROUGHNESS), _mean_left())
    return (1 - DIELECTRIC_F0 * f0 - f1) / mean


def directional_albedo(
    base_color: FloatArray, roughness: FloatArray, metallic: FloatArray, cos_theta: FloatArray
) -> FloatArray:
    """a'(ωo), the share of uniform incoming light that leaves towards the viewer.

    Args:
        base_color: (..., 3) scene-linear.
        roughness: (...) Principled roughness.
        metallic: (...) in [0, 1].
        cos_theta: (...) cosine between the normal and the direction to the viewer.

    Returns:
        (..., 3) scene-linear.
    """
    roughness, metallic, cos_theta = (np.asarray(x, dtype=np.float64) for x in (roughness, metallic, cos_theta))
    f0, f1 = (x[..., None] for x in specular_integrals(roughness, cos_theta))
    m = metallic[..., None]
    return base_color * (1 - m) + (base_color * m + DIELECTRIC_F0 * (1 - m)) * f0 + f1
