"""Costs of a gloss, averaged over regions that may be of one material, equation (25)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .region_likeness import RegionLikeness


@dataclass(frozen=True)
class RegionCosts:
    """Costs of k regions at every level of roughness.

    Attributes:
        like: which of the regions may be of one material.
        rough: (k,) cost of the rough dielectric.
        plastic, metal: (k, levels) costs relative to ``rough``.
        error: (k, levels) standard error of the difference between ``plastic`` and the rough dielectric.
        metal_error: (k, levels) of the difference between ``metal`` and the best dielectric.
        colour: (k, levels, 3) specular colour of the metal.
    """

    like: RegionLikeness
    rough: NDArray[np.float64]
    plastic: NDArray[np.float64]
    metal: NDArray[np.float64]
    error: NDArray[np.float64]
    metal_error: NDArray[np.float64]
    colour: NDArray[np.float64]

    @cached_property
    def pooled(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Plastic and metal costs (k, levels) of every region averaged with those of its like, and the standard error
        (k, levels) of the former."""
        near, weight = self.like.pool
        return (
            np.einsum("kn,knl->kl", weight, self.plastic[near]),
            np.einsum("kn,knl->kl", weight, self.metal[near]),
            np.sqrt(np.einsum("kn,knl->kl", weight**2, self.error[near] ** 2)),
        )
