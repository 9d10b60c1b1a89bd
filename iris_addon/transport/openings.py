"""Shadow rays aimed at the openings of the mesh: windows, doors, what a scan lacks.

Of the gather rays of a patch few leave a room by its window, and each then stands for a large part of the light of the
sky. Where gather rays of all patches cross the box around the mesh tells where it is open. Points there serve as lights
(portals): they are sampled with shadow rays, weighted against the gather rays by the balance heuristic (Veach 1997,
eq. 9.8), as :mod:`.aimed_rays` does with bright patches.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..rays.sampling import Origins
from ..rays.tracer import Tracer
from .gather import ESCAPED
from .transport import Transport

MAX_CELLS, RAYS_PER_CELL = 48, 32
"""Cells along a side of the box around the mesh, at most; and gather rays that leave by each where all leave by one
side. With few rays to a cell their number says more of chance than of an opening."""
MAX_RAYS = 4 * RAYS_PER_CELL * MAX_CELLS**2
"""Escaping rays that are looked at, about at most: of more, those of an even selection of patches."""
AIMED_RAYS = 32
"""Shadow rays from each patch to all openings together."""


class EscapingRays(NamedTuple):
    """k rays that leave the mesh.

    Attributes:
        row: (k,) patch that each starts from.
        direction: (k, 3) float32 unit.
        cosine: (k,) to the normal at its start.
        weight: (k,) irradiance / pi per radiance that it brings.
    """

    row: NDArray[np.int64]
    direction: NDArray[np.float32]
    cosine: NDArray[np.float32]
    weight: NDArray[np.float32]


@dataclass(frozen=True)
class Openings:
    """Where rays leave the box around the mesh.

    Attributes:
        tracer: the mesh.
        low, high: (3,) corners of the box, metres.
        cells: C along each side.
        chance: (6 C²,) that an aimed ray goes to each cell: those of the sides at low x, high x, low y ...
    """

    tracer: Tracer
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    cells: int
    chance: NDArray[np.float64]

    @staticmethod
    def of(tracer: Tracer, transport: Transport) -> Openings | None:
        """The openings that gather rays of seen patches leave by; None without any."""
        corners = tracer.corners.reshape(-1, 3)
        low, high = corners.min(0).astype(np.float64), corners.max(0).astype(np.float64)
        margin = 1e-3 * float(np.linalg.norm(high - low))
        escaped = int(np.count_nonzero(transport.target == ESCAPED))
        if not escaped:
            return None
        step = -(-escaped // MAX_RAYS)
        row, ray = np.nonzero(transport.target[::step] == ESCAPED)
        row *= step
        cells = int(np.clip(np.sqrt(len(row) / RAYS_PER_CELL), 1, MAX_CELLS))
        chance = np.ones(6 * cells**2)
        box = Openings(tracer=tracer, low=low - margin, high=high + margin, cells=cells, chance=chance)
        o = transport.origins
        start, along = o.position[row, ray % o.position.shape[1]], transport.rays.direction[row, ray]
        cell = box._exits(start, along.astype(np.float32))[0]
        left = np.bincount(cell, minlength=len(box.chance)).astype(np.float64)
        return replace(box, chance=left / left.sum())

    def gathered(
        self,
        target: NDArray[np.int32],
        directions: NDArray[np.floating],
        origins: Origins,
        rows: slice,
        aimed: int,
    ) -> EscapingRays:
        """Those of the gather rays of patches ``rows`` that escape, with what they lose to ``aimed`` ones taken off.

        Args:
            target, directions: (P, R) and (P, R, 3) of all gather rays.
        """
        row, ray = np.nonzero(target[rows] == ESCAPED)
        direction = directions[rows][row, ray].astype(np.float32)
        at = ray % origins.position.shape[1]
        start, normal = origins.position[rows][row, at], origins.normal[rows][row, at]
        cosine = np.einsum("kc,kc->k", normal, direction)
        return self._weighted(rows.start + row, start, direction, cosine, target.shape[1], aimed)

    def aimed(self, origins: Origins, rows: slice, gathered: int, aimed: int, rng: np.random.Generator) -> EscapingRays:
        """Those of ``aimed`` shadow rays from each of the patches ``rows`` to the openings that leave the mesh."""
        n, per_patch = rows.stop - rows.start, origins.position.shape[1]
        cumulative = np.cumsum(self.chance)
        strata = (np.arange(aimed) + rng.random((n, aimed))) * (cumulative[-1] / aimed)
        cell = np.minimum(np.searchsorted(cumulative, strata, side="right"), len(cumulative) - 1).ravel()
        points = self._points(cell, rng.random((len(cell), 2)))
        row, at = np.repeat(np.arange(n), aimed), np.tile(np.arange(aimed) % per_patch, n)
        start, normal = origins.position[rows][row, at], origins.normal[rows][row, at]
        along = points - start
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        along = along.astype(np.float32)
        cosine = np.einsum("kc,kc->k", normal, along)
        facing = np.flatnonzero(cosine > 0)
        origin = (start + self.tracer.epsilon * normal)[facing]
        clear = self.tracer.unoccluded(origin, along[facing], np.full(len(facing), np.inf))
        some = facing[clear]
        return self._weighted(rows.start + row[some], start[some], along[some], cosine[some], gathered, aimed)

    def _weighted(
        self,
        row: NDArray[np.int64],
        start: NDArray[np.floating],
        direction: NDArray[np.float32],
        cosine: NDArray[np.float32],
        gathered: int,
        aimed: int,
    ) -> EscapingRays:
        """Escaping rays with the weight of the balance heuristic: f / Σ n p, of both ways to sample their direction."""
        cell, distance, across = self._exits(start, direction)
        density = self.chance[cell] / self._cell_area()[cell // self.cells**2] * distance**2 / across
        lambert = np.maximum(cosine, 0) / np.pi
        weight = lambert / np.maximum(gathered * lambert + aimed * density, 1e-30)
        return EscapingRays(row, direction, cosine, weight.astype(np.float32))

    def _exits(
        self, start: NDArray[np.floating], direction: NDArray[np.floating]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """(k,) cell by which each ray leaves the box, the distance to it, and the cosine to the normal of its side."""
        along = np.where(np.abs(direction) < 1e-9, 1e-9, direction).astype(np.float64)
        reach = np.maximum((self.low - start) / along, (self.high - start) / along)
        axis = reach.argmin(1)
        k = np.arange(len(axis))
        distance, ahead = reach[k, axis], along[k, axis]
        place = (start + distance[:, None] * along - self.low) / (self.high - self.low)
        first, second = (axis + 1) % 3, (axis + 2) % 3
        i, j = (np.clip((place[k, each] * self.cells).astype(np.int64), 0, self.cells - 1) for each in (first, second))
        return ((2 * axis + (ahead > 0)) * self.cells + i) * self.cells + j, distance, np.maximum(np.abs(ahead), 1e-9)

    def _points(self, cell: NDArray[np.int64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, 3) points in cells (k,), at ``u`` (k, 2) in [0, 1) of each."""
        side, i, j = cell // self.cells**2, cell // self.cells % self.cells, cell % self.cells
        axis, k = side // 2, np.arange(len(cell))
        place = np.empty((len(cell), 3))
        place[k, axis] = side % 2
        place[k, (axis + 1) % 3], place[k, (axis + 2) % 3] = (i + u[:, 0]) / self.cells, (j + u[:, 1]) / self.cells
        return self.low + place * (self.high - self.low)

    def _cell_area(self) -> NDArray[np.float64]:
        """(6,) of a cell of each side of the box, square metres."""
        size = self.high - self.low
        area = np.array([size[1] * size[2], size[2] * size[0], size[0] * size[1]]) / self.cells**2
        return np.repeat(area, 2)
