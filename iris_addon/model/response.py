"""The camera response as a table: display value z = f(x) of relative exposure x in [0, 1].

f is monotone with f(0) = 0 and f(1) = 1; exposures above 1 saturate. Photos are stored as floor(255 z), so the best
estimate of z behind a byte b is (b + 0.5) / 255.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]


N_SAMPLES = 1024
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of scene-linear Rec.709."""
SATURATED = 254.5 / 255
"""Display values at or above this are clipped: floor(255 z) = 255 only for z = 1."""


@dataclass(frozen=True)
class Response:
    """A monotone response per channel.

    Attributes:
        samples: (3, 1024) float64, f at x = linspace(0, 1, 1024) for R, G, B.
        family: its origin ("power-spline", "identity", "gamma", "file").
        coefficients: parameters of the family, then the exponent where the curve was raised; for the record.
    """

    samples: NDArray[np.float64]
    family: str
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.samples.shape != (3, N_SAMPLES):
            raise ValueError(f"response samples have shape {self.samples.shape}, expected (3, {N_SAMPLES})")

    def apply(self, exposure: NDArray[np.floating]) -> NDArray[np.float64]:
        """Display value in [0, 1] of ``exposure`` (..., 3) = radiance x exposure factor; clips at 1."""
        return _at(self.samples, exposure)

    def invert(self, z: NDArray[np.floating]) -> NDArray[np.float64]:
        """Relative exposure in [0, 1] of display values ``z`` (..., 3) in [0, 1]."""
        x = np.linspace(0.0, 1.0, N_SAMPLES)
        # A flat stretch of the curve has no unique inverse; a vanishing slope makes np.interp pick its middle.
        ramp = np.linspace(0.0, 1e-9, N_SAMPLES)
        return np.stack([np.interp(z[..., c], self.samples[c] + ramp, x) for c in range(3)], -1)

    def raised(self, exponent: float) -> Response:
        """The response to exposures raised to ``exponent``: f(x^(1/exponent))."""
        x = np.linspace(0.0, 1.0, N_SAMPLES) ** (1.0 / exponent)
        samples = _at(self.samples, np.repeat(x[:, None], 3, 1)).T
        return Response(samples, self.family, (*self.coefficients, exponent))

    def slope(self, exposure: NDArray[np.floating]) -> NDArray[np.float64]:
        """f'(x) at relative exposures (..., 3)."""
        return _at(self.slopes, exposure)

    @property
    def slopes(self) -> NDArray[np.float64]:
        """(3, 1024) f'(x) where ``samples`` are."""
        return np.gradient(self.samples, 1 / (N_SAMPLES - 1), axis=1)


def _at(rows: NDArray[np.float64], x: NDArray[np.floating]) -> NDArray[np.float64]:
    """Rows (3, 1024), sampled evenly over [0, 1], at ``x`` (..., 3): np.interp, without its search for the interval."""
    position = np.clip(x, 0.0, 1.0).astype(np.float64) * (N_SAMPLES - 1)
    with np.errstate(invalid="ignore"):  # NaN gets an arbitrary index, and remains NaN by its position
        index = np.minimum(position.astype(np.int64), N_SAMPLES - 2)
    position -= index
    index += np.arange(3) * N_SAMPLES
    flat = rows.ravel()
    left = flat.take(index, mode="clip")
    index += 1
    return left + position * (flat.take(index, mode="clip") - left)


def srgb(linear: NDArray[np.floating]) -> NDArray[np.floating]:
    """Display values in [0, 1] of scene-linear colours by the sRGB transfer curve (IEC 61966-2-1)."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def linear_of_srgb(display: NDArray[np.floating]) -> NDArray[np.floating]:
    """Inverse of :func:`srgb`."""
    z = np.clip(display, 0.0, 1.0)
    return np.where(z <= 0.04045, z / 12.92, ((z + 0.055) / 1.055) ** 2.4)


def identity() -> Response:
    """The response of HDR input."""
    return Response(np.tile(np.linspace(0.0, 1.0, N_SAMPLES), (3, 1)), "identity")


def gamma(exponent: float = 1 / 2.2) -> Response:
    """z = x ** exponent for all channels."""
    return Response(np.tile(np.linspace(0.0, 1.0, N_SAMPLES) ** exponent, (3, 1)), "gamma", (exponent,))


MIDDLE_GREY = 0.18
"""Reflectance of the photographic grey card."""


def grey_exposure(radiance: FloatArray) -> float:
    """The exposure that puts the median luminance of ``radiance`` (..., 3) at middle grey, 0.18."""
    return MIDDLE_GREY / max(float(np.median(radiance @ LUMINANCE)), 1e-12)
