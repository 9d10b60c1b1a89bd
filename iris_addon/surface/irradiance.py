"""Irradiance at patches, averaged over neighbours and interpolated at pixels: shading is smooth where albedo is not."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ..base.compiled import kernel
from ..base.parallel import BLOCK, over_blocks
from .patches import Surface
from .primary_rays import PixelSamples

NEIGHBOURS = 10
"""Nearest patches of each that are averaged over, itself included."""
NORMAL_WEIGHT = 4.0
"""Patch sizes per unit of normal: a patch that faces 15 degrees away counts as one patch size away."""
PLANE_WEIGHT = 5.0
"""Patch sizes per patch size off the plane of a point: what lies parallel to it, like the pane behind a window's frame,
receives other light."""
INTERPOLATION_WIDTH, DENOISING_WIDTH = 0.75, 1.0
"""Standard deviation of the Gaussian that interpolates at pixels, and of the one that denoises patches, patch sizes."""
INTERPOLATION_EDGE, DENOISING_EDGE = 0.3, 0.2
"""Difference of log irradiance that is one standard deviation of either Gaussian; it keeps edges of light sharp."""


@dataclass(frozen=True)
class IrradianceField:
    """Neighbourhoods of the P patches in position and orientation; irradiance ignores regions.

    Attributes:
        position: (P, 3) float32 metres.
        normal: (P, 3) float32 unit.
        neighbours: (P, K) int32 nearest patches of each, the patch itself first.
        size: (P,) float32 edge length of each patch, metres.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    neighbours: NDArray[np.int32]
    size: NDArray[np.float32]

    @staticmethod
    def build(surface: Surface) -> IrradianceField:
        """The field of the seen patches."""
        size = np.maximum(surface.footprint * np.float32(surface.pixels_per_patch), 1e-4)
        return IrradianceField.of(surface.position, surface.normal, size)

    @staticmethod
    def of(position: NDArray[np.float32], normal: NDArray[np.float32], size: NDArray[np.float32]) -> IrradianceField:
        """The field of patches at ``position`` (P, 3) metres, of unit ``normal`` (P, 3) and ``size`` (P,) metres."""
        # The search tree needs one metric, but patch sizes vary from block to block: their geometric mean serves.
        unit = float(np.exp(np.mean(np.log(size))))
        features = np.concatenate([position / unit, NORMAL_WEIGHT * normal], 1)
        k = min(NEIGHBOURS, len(features))
        _, index = cKDTree(features).query(features, k=k, workers=-1)
        return IrradianceField(position, normal, np.asarray(index, np.int32).reshape(len(features), k), size)

    def kernel(
        self, width: float, rows: NDArray[np.int64] | None = None, group: NDArray[np.integer] | None = None
    ) -> csr_matrix:
        """(n, P) matrix that averages patch values over neighbours with a Gaussian of ``width`` patch sizes.

        It is linear in the values and smooths edges of light; :meth:`denoise` keeps these.

        Args:
            rows: (n,) the patches to average at, by default all.
            group: (P,) label of every patch; averages are then over neighbours of the same label.
        """
        rows = np.arange(len(self.position)) if rows is None else rows
        weight = self._weights(self.position[rows], self.normal[rows], rows, width, group=group)
        ends = np.arange(0, weight.size + 1, weight.shape[1])
        return csr_matrix((weight.ravel(), self.neighbours[rows].ravel(), ends), (len(rows), len(self.position)))

    def denoise(
        self, values: NDArray[np.floating], irradiance: NDArray[np.floating] | None = None
    ) -> NDArray[np.float32]:
        """Values (P, C) averaged over the neighbours of each patch that receive similar light.

        Args:
            irradiance: (P, 3) that decides what is similar; by default ``values`` are irradiance themselves.
        """
        lit = _log_level(values if irradiance is None else irradiance)
        table = np.ascontiguousarray(values, np.float32)
        mean = np.empty_like(table)

        def work(block: slice) -> None:
            rows = np.arange(block.start, block.stop)
            weight = self._weights(
                self.position[block], self.normal[block], rows, DENOISING_WIDTH, lit=lit, edge=DENOISING_EDGE
            )
            _average(weight, self.neighbours, rows, table, mean[block])

        over_blocks(len(table), BLOCK // NEIGHBOURS, work)
        return mean

    def spread(self, irradiance: NDArray[np.floating]) -> NDArray[np.float32]:
        """(P,) standard deviation of log ``irradiance`` (P, 3) over the neighbours of each patch: large in corners,
        beside mouldings and close to lamps."""
        lit, around = _log_level(irradiance), self.kernel(DENOISING_WIDTH)
        mean = around @ lit
        return np.sqrt(np.maximum(around @ lit**2 - mean**2, 0.0))

    def at_samples(
        self, samples: PixelSamples, patch: NDArray[np.int32], values: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """(n, C) patch values (P, C) interpolated at pixels; ``patch`` (n,) is the patch of each pixel."""
        return self.at_points(samples.position, samples.normal, patch, values)

    def at_points(
        self,
        position: NDArray[np.float32],
        normal: NDArray[np.float32],
        patch: NDArray[np.int32],
        values: NDArray[np.floating],
    ) -> NDArray[np.float32]:
        """The same at points (n, 3) whose normals (n, 3) are those of the visible side."""
        table, lit = np.ascontiguousarray(values, np.float32), _log_level(values)
        result = np.empty((len(patch), table.shape[1]), np.float32)

        def work(block: slice) -> None:
            at, rows = (position[block], normal[block]), patch[block]
            weight = self._weights(*at, rows, INTERPOLATION_WIDTH, lit=lit, edge=INTERPOLATION_EDGE)
            _average(weight, self.neighbours, rows, table, result[block])

        over_blocks(len(patch), BLOCK // NEIGHBOURS, work)
        return result

    def _weights(
        self,
        position: NDArray[np.float32],
        normal: NDArray[np.float32],
        patch: NDArray[np.integer],
        width: float,
        lit: NDArray[np.float32] | None = None,
        edge: float = 1.0,
        group: NDArray[np.integer] | None = None,
    ) -> NDArray[np.float32]:
        """(n, K) normalised kernel weights of the neighbours of each point's patch.

        Args:
            position, normal: (n, 3) of the points, metres and unit.
            patch: (n,) patch of each point.
            width: standard deviation in place, patch sizes.
            lit: (P,) log irradiance; ``edge`` is the standard deviation in it.
            group: (P,) label of every patch; neighbours of another label than the point's patch have no weight.
        """
        n = len(patch)
        weight = np.empty((n, self.neighbours.shape[1]), np.float32)
        lit = np.zeros(0, np.float32) if lit is None else lit
        label = np.zeros(0, np.int64) if group is None else group.astype(np.int64)
        rest = self.neighbours, self.position, self.normal, self.size, width, lit, edge, label

        def work(rows: slice) -> None:
            _weigh(position[rows], normal[rows], patch[rows], *rest, weight[rows])

        over_blocks(n, BLOCK // NEIGHBOURS, work)
        return weight


@kernel
def _weigh(
    position: NDArray[np.float32],
    normal: NDArray[np.float32],
    patch: NDArray[np.integer],
    neighbours: NDArray[np.int32],
    centre: NDArray[np.float32],
    facing: NDArray[np.float32],
    size: NDArray[np.float32],
    width: float,
    lit: NDArray[np.float32],
    edge: float,
    label: NDArray[np.int64],
    weight: NDArray[np.float32],
) -> None:
    """Gaussian in the distance along the plane of a point, in that off the plane, in the difference of the normals and
    in the difference of log irradiance."""
    for i in range(len(patch)):
        own, least = patch[i], np.inf
        reach = (size[own] * width) ** 2
        for k in range(neighbours.shape[1]):
            neighbour = neighbours[own, k]
            distance = height = tilt = 0.0
            for c in range(3):
                offset, bend = centre[neighbour, c] - position[i, c], facing[neighbour, c] - normal[i, c]
                distance += offset * offset
                tilt += bend * bend
                height += offset * normal[i, c]
            height *= PLANE_WEIGHT
            square = (distance + height * height) / reach + tilt * (NORMAL_WEIGHT / width) ** 2
            if len(lit):
                square += ((lit[neighbour] - lit[own]) / edge) ** 2
            if len(label) and label[neighbour] != label[own]:
                square = np.inf
            weight[i, k] = square
            least = min(least, square)
        total = 0.0
        for k in range(neighbours.shape[1]):
            weight[i, k] = math.exp(-0.5 * (weight[i, k] - least))
            total += weight[i, k]
        for k in range(neighbours.shape[1]):
            weight[i, k] /= total


@kernel
def _average(
    weight: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    patch: NDArray[np.integer],
    values: NDArray[np.float32],
    mean: NDArray[np.float32],
) -> None:
    """Write into ``mean`` (n, C) the values (P, C) of the neighbours of each point's patch, weighted (n, K)."""
    for i in range(len(patch)):
        for c in range(values.shape[1]):
            mean[i, c] = 0.0
        for k in range(weight.shape[1]):
            neighbour, w = neighbours[patch[i], k], weight[i, k]
            for c in range(values.shape[1]):
                mean[i, c] += w * values[neighbour, c]


def _log_level(irradiance: NDArray[np.floating]) -> NDArray[np.float32]:
    """(P,) logarithm of the mean over channels."""
    return np.log(np.maximum(irradiance.mean(1), 1e-9)).astype(np.float32)
