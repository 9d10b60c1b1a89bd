"""Weights and density of reflected rays drawn from visible GGX normals, split by the Fresnel terms F0 and F1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..transport.sampling import dot
from .ggx import grazing_fresnel, smith_g1


def visible_normal_weights(
    normal: NDArray[np.floating],
    incident: NDArray[np.floating],
    half_cosine: NDArray[np.floating],
    alpha: NDArray[np.floating],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """``G1 F0`` and ``G1 F1`` of each direction, and whether it points above the surface at all.

    Args:
        normal, incident: (n, 3) unit.
        half_cosine: (n,) cosine between the half vector and the incident direction.
        alpha: (n,) GGX width.
    """
    cosine = dot(incident, normal)
    above = cosine > 1e-3
    g1 = np.where(above, smith_g1(np.maximum(cosine, 1e-3), alpha), 0.0)
    fresnel = grazing_fresnel(half_cosine)
    return (g1 * (1 - fresnel)).astype(np.float32), (g1 * fresnel).astype(np.float32), above


def visible_normal_density(
    normal: NDArray[np.floating],
    outgoing: NDArray[np.floating],
    incident: NDArray[np.floating],
    alpha: NDArray[np.floating],
) -> NDArray[np.float64]:
    """(n,) probability per steradian of ``incident`` among directions reflected off visible normals, D G1 / (4 n·ωo)
    (Heitz 2018, eq. 17).

    Args:
        normal, outgoing, incident: (n, 3) unit, ``outgoing`` above the surface.
        alpha: (n,) GGX width.
    """
    half = (outgoing + incident).astype(np.float64)
    half /= np.maximum(np.sqrt(dot(half, half)), 1e-9)[:, None]
    square = alpha.astype(np.float64) ** 2
    cosine = dot(half, normal)
    across = np.cross(half, normal)
    # Of sharp lobes 1 − cos² is all that matters, and lost where cos is rounded.
    d = square / (np.pi * (square * cosine**2 + dot(across, across)) ** 2)
    facing = np.maximum(dot(outgoing, normal), 1e-3)
    return (cosine > 0) * d * smith_g1(facing, alpha) / (4 * facing)
