"""What noise and compression leave of the photos: for the report, and a warning where results suffer from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..decide import MAX_FLATTENED, MAX_NOISE
from .clipping import NOISE_PIXELS, photo_noise
from .observations import Observations

FLAT_LEVELS = (0.2, 0.94)
"""Display values between which photos are neither so dark nor so bright that rounding and clipping make them flat."""
SAME_VALUE = 1e-4
"""Standard deviation of display values below which all pixels have one."""
MIN_TOLD = 100
"""Patches in photos below which a share of them says nothing."""


@dataclass(frozen=True)
class PhotoQuality:
    """Noise and compression of the photos of a capture.

    Attributes:
        noise: standard deviation of display values; 0 also where compression has taken it away.
        flattened: share of the evenly lit patches whose pixels all have one value in a photo: even without noise the
            light of a room changes by a code from one end of a patch to the other, in one channel at least.
    """

    noise: float
    flattened: float

    @staticmethod
    def of(o: Observations) -> PhotoQuality:
        """Of the photos that ``o`` are of, which hold display values."""
        low, high = FLAT_LEVELS
        told = (o.saturated.max(1) == 0) & (o.count >= NOISE_PIXELS) & (o.z.min(1) > low) & (o.z.max(1) < high)
        flat = o.spread[told].max(1) < SAME_VALUE
        return PhotoQuality(photo_noise(o), float(np.mean(flat)) if len(flat) >= MIN_TOLD else 0.0)

    def report(self) -> dict[str, float]:
        """For report.json."""
        return {"noise": round(self.noise, 4), "flattened": round(self.flattened, 3)}

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know."""
        found = []
        if self.noise > MAX_NOISE:
            found.append(
                f"the photos are very noisy, by {self.noise:.1%} of white, and materials and lamps suffer from it: take"
                " them with more light, a lower ISO and longer exposures from a tripod, and leave noise filters off"
            )
        if self.flattened > MAX_FLATTENED:
            found.append(
                f"the photos are compressed so strongly that {self.flattened:.0%} of their patches have lost all "
                "shading, and materials and lamps suffer from it: store them with less compression (JPEG of quality 85 "
                "or more), and take them with more light and a lower ISO, because compression spreads noise"
            )
        return tuple(found)
