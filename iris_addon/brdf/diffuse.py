"""How a diffuse surface spreads light over angles: evenly (Lambert), or with more at grazing ones (Burley), or less.

Burley's lobe ("Physically Based Shading at Disney", 2012, section 5.3) is that of many renderers, and rough paint or
plaster comes nearer to it than to Lambert:

    f = a / π · (1 + k S(cos θi)) (1 + k S(cos θo)),    S(c) = (1 − c)^5,    k = 2 σ cos²θd − 1/2

with θd the angle between light and half vector. Here cos²θd is replaced by its mean, so that f is a product of a factor
of the light and one of the view; against the exact lobe in uniform light that is off by less than 2 %. A surface whose
albedo is divided by the wrong lobe comes out up to 25 % too bright where it was seen at a grazing angle, and a closed
room of such surfaces has the wrong balance of direct and indirect light.

Under varnish it sends less there: what the dielectric layer reflects towards a viewer it takes off the light from
below (:func:`iris_addon.brdf.ggx.layered_factor`). Real varnish does, and so does Blender's Principled BSDF;
models that add their lobes do not. Only cameras see it: over all directions the factor has the mean 1, and between
patches it is left out.
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


def grazing_gain(lobe: DiffuseLobe, roughness: NDArray[np.floating]) -> NDArray[np.float64]:
    """κ of each Principled roughness: light and view factors are 1 + κ S. Only Burley's is not 0."""
    roughness = np.asarray(roughness, np.float64)
    return 2.0 * MEAN_COS2 * roughness - 0.5 if lobe == "burley" else np.zeros_like(roughness)


def burley_roughness(kappa: NDArray[np.floating]) -> NDArray[np.floating]:
    """The roughness of which ``kappa`` is Burley's grazing gain."""
    return (kappa + 0.5) / (2.0 * MEAN_COS2)


def under_lobe(factors: NDArray[np.floating], kappa: NDArray[np.floating]) -> NDArray[np.float32]:
    """(N, E) form factors as surfaces with κ (N,) weight them, from (N, E, 2): plain shares, and shares times S."""
    return (factors[..., 0] + kappa[:, None] * factors[..., 1]).astype(np.float32)


def albedo_gain(
    lobe: DiffuseLobe, roughness: NDArray[np.floating], cosine: NDArray[np.floating]
) -> NDArray[np.float64]:
    """(n,) albedo of a diffuse lobe towards a viewer at ``cosine`` (n,) under uniform light, over that of Lambert's."""
    kappa = grazing_gain(lobe, roughness)
    return (1 + kappa * schlick(cosine)) * (1 + kappa * MEAN_SCHLICK)
