"""How likely regions are of one material, and what they tell of each other, equation (25).

The legs of a table and its top, the treads of a staircase, the fragments of a scanned sofa: each shows too little of a
highlight to decide alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..base.group_by import rank_in_group

POOL_MAX_OBSERVATIONS = 2000
"""Observations that all other regions together contribute to the pooled cost of a region, at most."""
POOL_MAX_EVIDENCE = 2.1
"""Evidence for highlights that other regions give, at most: eight to one, less than row "highlights" asks for. To
fragments of a scan the room gives more, SCAN_MAX_EVIDENCE."""
POOL_DISTANCE = 1.0
"""Standard deviation in metres of the weight by distance, for regions of like albedo."""
POOL_ALBEDO = 0.05
"""Standard deviation of the weight by difference in log albedo."""
POOL_ALBEDO_IN_FILE = 0.1
"""The same for regions of one object of the file, at any distance; the albedo of small regions is off by as much."""
POOL_NEIGHBOURS = 24
"""Nearest regions that are pooled, and best observed regions of the same object, at most."""
SCAN_REGIONS = 64
"""Best observed regions of a room that tell of the regions of a scan, wherever they are."""
SCAN_EVIDENCE = 2.0
"""Weight of what those of like albedo tell in the mean. With one, treads a flight away stay matte; with six, white
walls of a scan turn glossy."""
SCAN_MAX_EVIDENCE = 4.0
"""What they tell at most: what is matte for certain by its own photos stays so."""
SCAN_OBSERVATIONS = 1000
"""Observations with which one such region has the weight one; it grows with their square root."""
SCAN_POOLED, SCAN_POOL_MAX_OBSERVATIONS = 0.1, 50
"""Weight of their costs, and observations that they contribute at most: enough to tell which gloss a fragment has that
shows none itself."""


@dataclass(frozen=True)
class RegionLikeness:
    """What indicates which of k regions are of one material.

    Attributes:
        count: (k,) observations, of which each counts as far as its normal is known.
        centre: (k, 3) metres.
        log_albedo: (k, 3).
        in_file: (k,) object of the mesh file that each region lies in.
        texture: (k,) standard deviation of the log albedo within a region of a scan; 0 of modelled ones.
        scanned: (k,) bool, regions of a scan.
    """

    count: NDArray[np.float64]
    centre: NDArray[np.float64]
    log_albedo: NDArray[np.float64]
    in_file: NDArray[np.integer]
    texture: NDArray[np.float64]
    scanned: NDArray[np.bool_]

    @cached_property
    def pool(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Regions (k, m) whose costs are averaged for each region, itself among them, and their weights (k, m), which
        sum to 1."""
        near, alike, own = self._alike
        weight = self.count[near] * np.where(own, 0.0, alike)
        # A region that is well observed itself must not be outvoted by the others, however many they are.
        weight *= np.minimum(1.0, POOL_MAX_OBSERVATIONS / np.maximum(weight.sum(1, keepdims=True), 1e-9))
        weight += own * self.count[:, None]
        if self.scanned.any():
            best, alike = self._in_room
            far = SCAN_POOLED * self.count[best] * alike * self.scanned[:, None]
            far *= np.minimum(1.0, SCAN_POOL_MAX_OBSERVATIONS / np.maximum(far.sum(1, keepdims=True), 1e-9))
            near = np.concatenate([near, np.broadcast_to(best, far.shape)], 1)
            weight = np.concatenate([weight, far], 1)
        return near, weight / weight.sum(1, keepdims=True)

    def with_like(self, evidence: NDArray[np.floating]) -> NDArray[np.float64]:
        """(k, levels) the ``evidence`` (k, levels) of every region for highlights, and that of its like.

        That another region is glossy tells of this one no more than that both are of one material.
        """
        near, alike, own = self._alike
        of_like = np.einsum("kn,knl->kl", np.where(own, 0.0, alike), evidence[near])
        beside = np.clip(of_like, -POOL_MAX_EVIDENCE, POOL_MAX_EVIDENCE)
        if not self.scanned.any():
            return evidence + beside
        best, alike = self._in_room
        weight = alike * np.sqrt(self.count[best] / SCAN_OBSERVATIONS)
        mean = (weight @ evidence[best]) / (1.0 + weight.sum(1, keepdims=True))
        in_room = np.clip(SCAN_EVIDENCE * mean, -SCAN_MAX_EVIDENCE, SCAN_MAX_EVIDENCE)
        return evidence + beside + np.where(self.scanned[:, None], in_room, 0.0)

    @cached_property
    def _in_room(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The best observed regions (m,) of the room, those beside a region included, and how alike (k, m) each is in
        albedo, itself not at all.

        A scan leaves hundreds of fragments, most of which have no normal good enough for a highlight of their own and
        none beside them that has. In a model, where each object has its own, white walls would take the gloss of white
        woodwork.
        """
        best = np.argsort(-self.count, kind="stable")[:SCAN_REGIONS]
        unlike = np.abs(self.log_albedo[best] - self.log_albedo[:, None]).max(-1)
        alike = np.exp(-0.5 * unlike**2 / (POOL_ALBEDO**2 + self._texture_with(best)))
        alike[best, np.arange(len(best))] = 0.0
        return best, alike

    def _texture_with(self, other: NDArray[np.integer]) -> NDArray[np.float64]:
        """(k, m) mean variance of the log albedo within each region and those listed in ``other``, (m,) or (k, m)."""
        return 0.5 * (self.texture[other] ** 2 + self.texture[:, None] ** 2)

    @cached_property
    def _alike(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
        """Regions (k, m) that may be of one material with each region, how alike (k, m) they are, from 0 to 1, and
        which entry (k, m) is the region itself."""
        near, first = self._candidates()
        own = (near == np.arange(len(near))[:, None]) & first
        same_object = self.in_file[near] == self.in_file[:, None]
        distance = np.linalg.norm(self.centre[near] - self.centre[:, None], axis=-1) / POOL_DISTANCE
        unlike = np.abs(self.log_albedo[near] - self.log_albedo[:, None]).max(-1)
        # A scan ends a region at the edge of a tread; the next tread differs from it as the grain of each does.
        texture = self._texture_with(near)
        in_object, beside = (unlike**2 / (std**2 + texture) for std in (POOL_ALBEDO_IN_FILE, POOL_ALBEDO))
        apart = np.where(same_object, in_object, distance**2 + beside)
        return near, np.where(first, np.exp(-0.5 * apart), 0.0), own

    def _candidates(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Regions (k, m) that may be of one material with each region, and whether (k, m) an entry is the first of its
        region in the row.

        They are the nearest regions, itself included, and the best observed regions of the same object of the file.
        """
        n = len(self.count)
        near = cKDTree(self.centre).query(self.centre, k=min(POOL_NEIGHBOURS, n))[1].reshape(n, -1)
        best = np.lexsort((-self.count, self.in_file))
        rank = rank_in_group(self.in_file[best])
        most = min(POOL_NEIGHBOURS, int(rank.max()) + 1)  # one where the file names no objects
        listed = rank < most
        of_object = np.full((int(self.in_file.max()) + 1, most), -1)
        of_object[self.in_file[best[listed]], rank[listed]] = best[listed]
        same_object = of_object[self.in_file]
        other = (same_object >= 0) & ~(same_object[:, :, None] == near[:, None]).any(-1)
        return np.concatenate([near, same_object], 1), np.concatenate([np.ones(near.shape, bool), other], 1)
