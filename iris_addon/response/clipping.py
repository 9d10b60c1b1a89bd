"""Which observations clip, also in photos with noise, blur or JPEG.

These take single pixels of a clipped surface off white, and push single pixels of a bright one onto it. What clips then
passes for a measurement, and the radiance at which photos clip gives way (experiments 0091 and 0139). So display values
within the reach of noise below white are no measurements; those that noise alone explains clip, and the others do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .observations import Observations

NOISE_LEVELS, NOISE_PIXELS, NOISE_QUANTILE = (0.7, 0.94), 9, 0.1
"""Display values, pixels and quantile of the spread of observations that tell noise: the smoothest tenth has neither
texture nor shading in it."""
MIN_NOISE_TOLD = 100
"""Such observations below which nothing is told: the halo of a lamp alone is no noise."""
CODE = 1 / 255
"""Spread that shading and rounding leave in the smoothest observations of photos without noise."""
REACH = 9.0
"""Reach of noise below white over its standard deviation: near edges, where JPEG keeps it all, it is three times as
large."""
DROP_QUANTILE, MIN_PIXELS = 0.75, 4
"""Quantile of how far noise takes pixels below white, and pixels of the observations that tell."""
FLAT_SPREAD = 0.04
"""Largest standard deviation of display values within an observation that still counts as one value."""
CERTAIN_SHARE = 0.9
"""Share of clipped pixels from which a noisy observation has clipped for certain."""


@dataclass(frozen=True)
class Clipping:
    """What clips of M observations.

    Attributes:
        share: (M, 3) share of the pixels that are clipped, as far as noise lets that be told.
        measured: (M,) bool, no pixel clips in any channel, nor may noise have cut any value off.
    """

    share: NDArray[np.floating]
    measured: NDArray[np.bool_]

    @staticmethod
    def of(o: Observations) -> Clipping:
        """What clips of all observations of a capture; without noise, what has clipped pixels."""
        noise = photo_noise(o)
        if noise == 0:
            return Clipping(o.saturated, (o.saturated == 0).all(1))
        in_reach = (o.z > 1 - REACH * noise) & (o.saturated < CERTAIN_SHARE)
        share = np.where(in_reach & (o.z > 1 - drop_below_white(o)), 1.0, o.saturated)
        return Clipping(share, ~(in_reach | (o.saturated > 0)).any(1))


def photo_noise(o: Observations) -> float:
    """Standard deviation of display values by the noise of photos; 0 where they have none."""
    low, high = NOISE_LEVELS
    unclipped = (o.saturated.max(1) == 0) & (o.count >= NOISE_PIXELS)
    spread = o.spread[(o.z > low) & (o.z < high) & unclipped[:, None]]
    if len(spread) < MIN_NOISE_TOLD:
        return 0.0
    smooth = float(np.quantile(spread, NOISE_QUANTILE))
    return max(smooth**2 - CODE**2, 0.0) ** 0.5


def drop_below_white(o: Observations) -> float:
    """Display values by which noise, blur and JPEG take pixels of clipped surfaces below white, most of them less; 0
    where no photo tells.

    Told by the observations of which most pixels clip. The spread of darker ones is that of another part of the photo,
    and differs more between rooms.
    """
    # Pixels on edges have next to no weight: what an observation shows of others is more than half a pixel.
    some_do_not = o.saturated <= 1 - 0.5 / np.maximum(o.count, 1)[:, None]
    mostly = (o.saturated >= 0.5) & some_do_not & (o.spread < FLAT_SPREAD) & (o.count >= MIN_PIXELS)[:, None]
    drop = (1 - o.z[mostly]) / (1 - o.saturated[mostly])
    return float(np.quantile(drop, DROP_QUANTILE)) if len(drop) else 0.0
