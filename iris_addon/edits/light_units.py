"""Light in the units of boxes and meters: lumens, lux, candela per square metre, and colour temperature.

The radiance of a solve has an arbitrary unit, because photos show ratios. One known quantity fixes its scale for all
others: ``lumens = scale · flux``, ``lux = scale · illuminance``, ``cd/m² = scale · luminance``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model.response import LUMINANCE, Response
from ..model.sphere import equirect_directions

XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
"""Linear Rec.709 to CIE XYZ (IEC 61966-2-1)."""
PLANCK_FROM, PLANCK_TO = 1667.0, 25000.0
"""Range of the cubic approximation of the Planckian locus, kelvin."""
LUMENS_PER_WATT = 177.83
"""At which Cycles takes the candela of photometric files for watts: the white of D65."""
METERED_VALUE = 118 / 255
"""Display value at which a camera shows the luminance that it is set for: 18 % of white in sRGB (ISO 12232)."""
METERED_STOPS = 0.5
"""Standard error of a luminance by aperture, time and ISO: the constant of meters is 10.6 to 13.4 by ISO 2720, and ISO
12232, which rounds a camera's ISO to a third of a stop, comes to 15.4 for a lens of usual transmission."""
PLANCK_DISTANCE = 0.02
"""Largest distance from the Planckian locus in CIE 1960 (u, v) at which a colour has a colour temperature; the CIE
allows 0.05."""


def flux(radiance: ArrayLike, area: float) -> float:
    """Luminous flux that ``area`` square metres of Lambertian surface with ``radiance`` (3,) emit from one side.

    In the unit of the radiance times square metre: π · area · luminance.
    """
    return float(np.pi * area * (LUMINANCE @ np.asarray(radiance, float)))


def illuminance(panorama: NDArray[np.floating], normal: ArrayLike) -> float:
    """What a meter that faces along the unit ``normal`` (3,) reads, in the unit of the luminance times steradian.

    Args:
        panorama: (H, W, 3) linear Rec.709 radiance that arrives at its place, equirectangular with +z on top.
    """
    height, width = panorama.shape[:2]
    cosine = np.maximum(equirect_directions(width, height) @ np.asarray(normal, float), 0.0)
    edges = np.cos(np.linspace(0.0, np.pi, height + 1))
    solid_angle = (edges[:-1] - edges[1:])[:, None] * (2 * np.pi / width)
    return float((panorama @ LUMINANCE * cosine * solid_angle).sum())


def metered_scale(photos: Sequence[tuple[Response, NDArray[np.floating], float]]) -> tuple[float, float]:
    """Luminance per unit of a solve's radiance by the settings of its photos.

    Args:
        photos: of each the response, the (3,) exposure, and the luminance that its aperture, time and ISO are meant
            for, cd/m²; at least one.

    Returns:
        cd/m² per unit, the geometric mean of the photos, and its standard error in stops.
    """
    stops = []
    for response, exposure, luminance in photos:
        gray = response.invert(np.full(3, METERED_VALUE)) / exposure
        stops.append(np.log2(luminance / float(LUMINANCE @ gray)))
    return float(2.0 ** np.mean(stops)), float(np.hypot(METERED_STOPS, np.std(stops)))


def area_light_energy(area: float) -> float:
    """Power of Blender's area light of ``area`` square metres whose radiance is 1 in the scene's unit: π · area watts.

    Lumens do not follow from it: the efficacy of light depends on its spectrum, of which three channels are known.
    """
    return float(np.pi * area)


def kelvin(color: ArrayLike) -> float | None:
    """Correlated colour temperature of linear Rec.709 ``color`` (3,) by McCamy's formula (1992).

    Returns:
        None for a colour that no black body has: black, saturated, or outside of 1667 to 25000 K.
    """
    x, y, z = XYZ @ np.asarray(color, float)
    total = x + y + z
    if total <= 0:
        return None
    x, y = x / total, y / total
    n = (x - 0.3320) / (0.1858 - y)
    temperature = 449.0 * n**3 + 3525.0 * n**2 + 6823.3 * n + 5520.33
    if not PLANCK_FROM <= temperature <= PLANCK_TO:
        return None
    apart = np.subtract(_uv(x, y), _uv(*planckian(temperature)))
    return float(temperature) if np.hypot(*apart) <= PLANCK_DISTANCE else None


def planckian(temperature: float) -> tuple[float, float]:
    """CIE (x, y) of a black body at 1667 to 25000 kelvin, by the cubic splines of Kim et al. (US patent 7024034)."""
    t = 1000.0 / temperature
    if temperature <= 4000.0:
        x = -0.2661239 * t**3 - 0.2343589 * t**2 + 0.8776956 * t + 0.179910
    else:
        x = -3.0258469 * t**3 + 2.1070379 * t**2 + 0.2226347 * t + 0.240390
    if temperature <= 2222.0:
        y = -1.1063814 * x**3 - 1.34811020 * x**2 + 2.18555832 * x - 0.20219683
    elif temperature <= 4000.0:
        y = -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867
    else:
        y = 3.0817580 * x**3 - 5.87338670 * x**2 + 3.75112997 * x - 0.37001483
    return x, y


def _uv(x: float, y: float) -> tuple[float, float]:
    return 4 * x / (-2 * x + 12 * y + 3), 6 * y / (-2 * x + 12 * y + 3)
