"""Weights of reflected rays drawn from visible GGX normals, split by the Fresnel terms F0 and F1."""

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
