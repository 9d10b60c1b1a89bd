"""Which diffuse lobe the surfaces of a room have, from how their brightness changes with the angle of view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..response.observations import Observations
from ..response.radiance import Linearised
from ..transport.diffuse import DiffuseLobe, grazing_gain

GAIN_NEEDED = 0.02
"""Relative fall of the disagreement between views that Burley's lobe must bring over Lambert's."""
ROBUST_LOG = 0.1
MIN_PIXELS = 2
MIN_RADIANCE = 1e-3


@dataclass(frozen=True)
class DiffuseChoice:
    """The lobe of every diffuse surface, and the relative fall of the disagreement that Burley's brings."""

    lobe: DiffuseLobe
    gain: float

    def under(self, layer: bool) -> DiffuseChoice:
        """The same room with or without a dielectric layer that takes its light off what is below; Burley's lobe is of
        models that have none."""
        return self if self.lobe == "burley" else DiffuseChoice("layered" if layer else "lambert", self.gain)


def choose_diffuse(observations: Observations, linear: Linearised, schlick: NDArray[np.floating]) -> DiffuseChoice:
    """The lobe under which the views of each patch agree.

    Args:
        schlick: (M,) S of the direction each observation was made from.
    """
    o = observations
    usable = linear.told & (linear.radiance.min(1) > MIN_RADIANCE) & (o.count >= MIN_PIXELS)
    weight = np.where(usable, np.sqrt(np.minimum(o.count, 25.0)), 0.0)
    if not weight.any():
        return DiffuseChoice("lambert", 0.0)
    brightness = np.log(np.maximum(linear.radiance, MIN_RADIANCE)).mean(1)
    rough = float(grazing_gain("burley", np.array(1.0)))
    lambert = _disagreement(brightness, o.patch, weight)
    burley = _disagreement(brightness - np.log1p(rough * schlick), o.patch, weight)
    gain = 1 - burley / max(lambert, 1e-9)
    return DiffuseChoice("burley" if gain > GAIN_NEEDED else "lambert", gain)


def _disagreement(brightness: NDArray[np.floating], patch: NDArray[np.integer], weight: NDArray[np.floating]) -> float:
    """Robust mean deviation of log brightness (M,) from one value per patch."""
    n = int(patch.max()) + 1
    say, deviation = weight, np.zeros_like(brightness)
    for _ in range(3):
        mean = np.bincount(patch, say * brightness, n) / np.maximum(np.bincount(patch, say, n), 1e-9)
        deviation = (brightness - mean[patch]) / ROBUST_LOG
        say = weight / (1 + deviation**2)
    return float(weight @ np.log1p(deviation**2) / weight.sum())
