"""What each part of a room costs at every gloss, and what parts that may be one material cost together.

The legs of a chair are one wood, and each is seen too badly to tell how it shines. Parts lend each other their costs,
not their observations: what differs between them is the error of their light, and gloss would have to explain it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

WELL_OBSERVED = 2000
"""Observations that parts lend to one at most."""
NEAR = 1.0
"""Metres over which parts of like albedo are taken for pieces of one material."""
LIKE = 0.05
"""Difference in log albedo at which they no longer are."""
LIKE_KIN = 0.1
"""The same for pieces of what the capture says is one part, however far apart: small ones are off by as much."""
NEIGHBOURS = 24


@dataclass(frozen=True)
class PartCosts:
    """Costs of k parts at every level, and what tells which of them are one material.

    Attributes:
        ids: (k,) part ids.
        rough: (k,) cost of the rough dielectric.
        plastic, metal: (k, levels) relative to that.
        error: (k, levels) standard error of how much ``plastic`` lies below the rough dielectric.
        colour: (k, levels, 3) specular colour of the metal.
        count: (k,) observations.
        centre: (k, 3) metres.
        log_albedo: (k, 3).
        given: (k,) what of the capture's own parts each is a piece of.
    """

    ids: NDArray[np.integer]
    rough: NDArray[np.float64]
    plastic: NDArray[np.float64]
    metal: NDArray[np.float64]
    error: NDArray[np.float64]
    colour: NDArray[np.float64]
    count: NDArray[np.float64]
    centre: NDArray[np.float64]
    log_albedo: NDArray[np.float64]
    given: NDArray[np.integer]

    def pooled(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Plastic and metal costs of every part averaged with those of near parts of like albedo and of its kin, pieces
        of the same part of the capture; the error of such an average, and the observations behind it."""
        near, first = self._candidates()
        own = near == np.arange(len(near))[:, None]
        kin = self.given[near] == self.given[:, None]
        distance = np.linalg.norm(self.centre[near] - self.centre[:, None], axis=-1) / NEAR
        unlike = np.abs(self.log_albedo[near] - self.log_albedo[:, None]).max(-1)
        apart = np.where(kin, (unlike / LIKE_KIN) ** 2, distance**2 + (unlike / LIKE) ** 2)
        say = np.where(first & ~own, self.count[near] * np.exp(-0.5 * apart), 0.0)
        # However many they are, a part that was well observed itself is not outvoted.
        say *= np.minimum(1.0, WELL_OBSERVED / np.maximum(say.sum(1, keepdims=True), 1e-9))
        say += (first & own) * self.count[:, None]
        total = say.sum(1)
        say /= total[:, None]
        return (
            np.einsum("kn,knl->kl", say, self.plastic[near]),
            np.einsum("kn,knl->kl", say, self.metal[near]),
            np.sqrt(np.einsum("kn,knl->kl", say**2, self.error[near] ** 2)),
            total,
        )

    def _candidates(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """(k, m) parts that may be of one material with each: the nearest, itself among them, and the best observed of
        its kin; and where in a row a part is listed first."""
        n = len(self.ids)
        near = cKDTree(self.centre).query(self.centre, k=min(NEIGHBOURS, n))[1].reshape(n, -1)
        best = np.lexsort((-self.count, self.given))
        rank = np.arange(n) - np.searchsorted(self.given[best], self.given[best])
        most = min(NEIGHBOURS, int(rank.max()) + 1)  # one where the capture brings no parts
        listed = rank < most
        kin = np.full((int(self.given.max()) + 1, most), -1)
        kin[self.given[best[listed]], rank[listed]] = best[listed]
        kin = kin[self.given]
        other = (kin >= 0) & ~(kin[:, :, None] == near[:, None]).any(-1)
        return np.concatenate([near, kin], 1), np.concatenate([np.ones(near.shape, bool), other], 1)
