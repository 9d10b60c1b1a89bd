"""The profile of a lamp: how its radiance falls, or rises, with the angle to the normal of its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PROFILE_DEGREES = np.linspace(0.0, 75.0, 6)
"""Angles to the normal at which a profile is known; between them it is linear in the angle, beyond them constant."""
EVEN_PROFILE = np.ones(len(PROFILE_DEGREES))
"""The profile of a lamp that shines alike in all directions."""


@dataclass(frozen=True)
class LampProfile:
    """Radiance by angle, alike all around the normal and on both sides of a surface.

    Attributes:
        values: (6,) radiance at PROFILE_DEGREES over that of an even lamp of the same flux.
    """

    values: NDArray[np.float64]

    @staticmethod
    def of(relative: NDArray[np.floating]) -> LampProfile:
        """The profile in proportion to ``relative`` (6,), which sends as much light as an even lamp."""
        values = np.asarray(relative, np.float64)
        return LampProfile(values / float(FLUX_SHARES @ values))

    def at(self, cosine: NDArray[np.floating]) -> NDArray[np.float64]:
        """(...) radiance at cosines (...) of the angle to the normal, of either sign, over that of an even lamp."""
        return np.interp(degrees_off_normal(cosine), PROFILE_DEGREES, self.values)

    @property
    def beam_angle(self) -> float:
        """Degrees across the beam, 120 of an even lamp: twice the largest angle with half of the greatest intensity.

        Intensity is radiance times the cosine.
        """
        degrees = np.linspace(0.0, 90.0, 901)
        intensity = np.cos(np.radians(degrees)) * np.interp(degrees, PROFILE_DEGREES, self.values)
        return 2.0 * float(degrees[intensity >= 0.5 * intensity.max()][-1])


def degrees_off_normal(cosine: NDArray[np.floating]) -> NDArray[np.floating]:
    """Angle (...) between 0 and 90 degrees to the nearer normal, from a cosine (...) of either sign."""
    return np.degrees(np.arccos(np.minimum(np.abs(cosine), 1.0)))


def profile_basis(cosine: NDArray[np.floating]) -> NDArray[np.float64]:
    """(..., 6) weight of each of PROFILE_DEGREES at cosines (...); they add up to one."""
    degrees = np.minimum(degrees_off_normal(cosine), PROFILE_DEGREES[-1])
    place = degrees[..., None] / (PROFILE_DEGREES[1] - PROFILE_DEGREES[0])
    return np.clip(1 - np.abs(place - np.arange(len(PROFILE_DEGREES))), 0.0, 1.0)


def _flux_shares() -> NDArray[np.float64]:
    """(6,) share of the flux of an even lamp that each of PROFILE_DEGREES stands for; they add up to one."""
    cosine = np.cos(np.radians((np.arange(9000) + 0.5) / 100))
    density = cosine * np.sqrt(1 - cosine**2)
    return density @ profile_basis(cosine) / density.sum()


FLUX_SHARES = _flux_shares()
