"""Linear colour spaces as their primaries: the engine's own, Rec.709, and ACEScg, in which films are composited."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""CIE XYZ to the cone responses in which white is adapted (Lam 1985), as ACES does."""


@dataclass(frozen=True)
class ColorSpace:
    """A linear colour space.

    Attributes:
        red, green, blue, white: CIE 1931 (x, y) of its primaries and of (1, 1, 1).
    """

    red: tuple[float, float]
    green: tuple[float, float]
    blue: tuple[float, float]
    white: tuple[float, float]

    @property
    def chromaticities(self) -> tuple[float, ...]:
        """The eight numbers of the attribute of that name in an EXR."""
        return (*self.red, *self.green, *self.blue, *self.white)

    @property
    def to_xyz(self) -> NDArray[np.float64]:
        """(3, 3) from RGB to CIE XYZ with Y of white 1 (SMPTE RP 177-1993)."""
        primaries = np.stack([_xyz(self.red), _xyz(self.green), _xyz(self.blue)], axis=1)
        return primaries * np.linalg.solve(primaries, _xyz(self.white))

    def matrix_to(self, other: ColorSpace) -> NDArray[np.float64]:
        """(3, 3) from this space to ``other``; white stays white."""
        ours, theirs = BRADFORD @ _xyz(self.white), BRADFORD @ _xyz(other.white)
        adapted = np.linalg.solve(BRADFORD, (theirs / ours)[:, None] * BRADFORD)
        return np.linalg.solve(other.to_xyz, adapted @ self.to_xyz)


def _xyz(xy: tuple[float, float]) -> NDArray[np.float64]:
    x, y = xy
    return np.array([x / y, 1.0, (1 - x - y) / y])


REC709 = ColorSpace((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.3127, 0.3290))
"""ITU-R BT.709, white D65."""
ACESCG = ColorSpace((0.713, 0.293), (0.165, 0.830), (0.128, 0.044), (0.32168, 0.33767))
"""S-2014-004, primaries AP1 and the white of ACES, near D60."""
