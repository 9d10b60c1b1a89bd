"""Diffuse lobes: even over angles (Lambert), brighter at grazing angles (Burley), or darker there (under varnish).

Burley's lobe ("Physically Based Shading at Disney", 2012, section 5.3) is used by many renderers, and rough paint or
plaster is closer to it than to Lambert's:

    f = a / π · (1 + k S(cos θi)) (1 + k S(cos θo)),    S(c) = (1 − c)^5,    k = 2 σ cos²θd − 1/2

with θd the angle between light and half vector. Here cos²θd is replaced by its mean, so that f is the product of a
factor of the light and one of the view, within 2 % of the exact lobe under uniform light. A surface whose
albedo is divided by the wrong lobe comes out up to 25 % too bright where it was seen at a grazing angle, and a closed
room of such surfaces has the wrong balance of direct and indirect light.

Under varnish a surface is darker at grazing angles, because the dielectric layer takes the light that it reflects
towards a viewer off the light from below (:func:`iris_addon.brdf.ggx.layered_factor`). This holds for real varnish and
for Blender's Principled BSDF, but not for models that add their lobes. The factor has a mean of 1 over all directions;
it applies to cameras, and is left out between patches.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model.recovered import DiffuseLobe

MEAN_COS2 = 0.57
"""Mean of cos²θd over the hemisphere."""
MEAN_SCHLICK = 1 / 21
"""Mean of S over the cosine-weighted hemisphere."""


def schlick(cosine: NDArray[np.floating]) -> NDArray[np.floating]:
    """S, (1 − c)^5, of cosines to the normal, any shape."""
    x = 1.0 - np.clip(cosine, 0.0, 1.0)
    square = x * x  # three products: numpy takes the logarithm for powers beyond the square
    return square * square * x


def cosine_of_schlick(s: NDArray[np.floating]) -> NDArray[np.floating]:
    """The cosines to the normal that have the S of :func:`schlick`, any shape."""
    return 1.0 - np.power(s, 0.2)


def grazing_gain(lobe: DiffuseLobe, roughness: NDArray[np.floating]) -> NDArray[np.float64]:
    """κ of each Principled roughness: light and view factors are 1 + κ S. Only Burley's is not 0."""
    roughness = np.asarray(roughness, np.float64)
    return 2.0 * MEAN_COS2 * roughness - 0.5 if lobe == "burley" else np.zeros_like(roughness)


def burley_roughness(kappa: NDArray[np.floating]) -> NDArray[np.floating]:
    """The roughness whose grazing gain is ``kappa`` under Burley's lobe."""
    return (kappa + 0.5) / (2.0 * MEAN_COS2)


def under_lobe(factors: NDArray[np.floating], kappa: NDArray[np.floating]) -> NDArray[np.float32]:
    """(N, E) form factors onto surfaces with κ (N,), from ``factors`` (N, E, 2): plain, and weighted by S."""
    return (factors[..., 0] + kappa[:, None] * factors[..., 1]).astype(np.float32)


def albedo_gain(
    lobe: DiffuseLobe, roughness: NDArray[np.floating], cosine: NDArray[np.floating]
) -> NDArray[np.float64]:
    """(n,) albedo of a diffuse lobe towards a viewer at ``cosine`` (n,) under uniform light, over that of Lambert's."""
    kappa = grazing_gain(lobe, roughness)
    return (1 + kappa * schlick(cosine)) * (1 + kappa * MEAN_SCHLICK)
