"""Irradiance between patches: shading is smooth where albedo is not, so patches carry it and pixels interpolate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ..parallel import BLOCK, over_blocks
from .build import Surface
from .samples import PixelSamples

NEIGHBOURS = 10
NORMAL_WEIGHT = 4.0
"""Patches that face 15 degrees away count as far as one patch size away."""
KERNEL, DENOISED = 0.75, 1.0
"""Standard deviation of the kernel that interpolates, and of the one that takes noise off, in patch sizes."""
PLANE_WEIGHT = 5.0
"""A patch a fifth of its size before or behind a point's plane counts as far as one patch size beside it: what lies
parallel, like the pane behind a window's frame, is lit otherwise."""
EDGE, POINT_EDGE = 0.2, 0.3
"""Difference of log irradiance at which a neighbour counts as lit otherwise: of patches, whose values are noisy, and in
the interpolation between them."""


@dataclass(frozen=True)
class IrradianceField:
    """Neighbourhoods of patches in position and orientation; parts do not matter to irradiance.

    Attributes:
        neighbours: (P, K) int32, the patch itself first.
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
        """Nearest patches of every patch, near in place and in orientation: (P, 3), (P, 3) unit and (P,) metres."""
        # One metric for the tree: patch sizes vary from block to block, so neighbours are compared in log-mean size.
        unit = float(np.exp(np.mean(np.log(size))))
        features = np.concatenate([position / unit, NORMAL_WEIGHT * normal], 1)
        k = min(NEIGHBOURS, len(features))
        _, index = cKDTree(features).query(features, k=k, workers=-1)
        return IrradianceField(position, normal, np.asarray(index, np.int32).reshape(len(features), k), size)

    def kernel(
        self, width: float, rows: NDArray[np.int64] | None = None, group: NDArray[np.integer] | None = None
    ) -> csr_matrix:
        """(n, P) matrix that averages patch values over neighbours with a Gaussian of ``width`` patch sizes.

        It takes sampling noise off and is linear in the values; :meth:`denoise` is what stops at the edges of light.

        Args:
            rows: (n,) the patches whose averages are asked for, by default all.
            group: (P,) label of every patch; averages are then over neighbours of the same label.
        """
        rows = np.arange(len(self.position)) if rows is None else rows
        near = self.neighbours[rows]
        weight = self._weights(self.position[rows], self.normal[rows], rows, width)
        if group is not None:
            weight = weight * (group[near] == group[rows][:, None])
            weight /= weight.sum(1, keepdims=True)
        ends = np.arange(0, near.size + 1, near.shape[1])
        return csr_matrix((weight.ravel(), near.ravel(), ends), (len(rows), len(self.position)))

    def denoise(
        self, values: NDArray[np.floating], irradiance: NDArray[np.floating] | None = None
    ) -> NDArray[np.float32]:
        """Values (P, C) averaged over those neighbours of a patch that are lit like it.

        Args:
            irradiance: (P, 3) by which that is told; by default the values are irradiance themselves.
        """
        lit = values if irradiance is None else irradiance
        rows = np.arange(len(self.position))
        weight = self._weights(self.position, self.normal, rows, DENOISED)
        weight = _lit_alike(weight, self.neighbours, rows, _log_level(lit), EDGE)
        return np.einsum("pk,pkc->pc", weight, values.astype(np.float32)[self.neighbours])

    def at_samples(
        self, samples: PixelSamples, patch: NDArray[np.int32], values: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """(n, C) patch values (P, C) interpolated at pixels; ``patch`` (n,) is the patch each pixel lies on."""
        table, level = values.astype(np.float32), _log_level(values)
        result = np.empty((len(patch), table.shape[1]), np.float32)

        def work(rows: slice) -> None:
            weight = self._weights(samples.position[rows], samples.normal[rows], patch[rows], KERNEL)
            weight = _lit_alike(weight, self.neighbours[patch[rows]], patch[rows], level, POINT_EDGE)
            result[rows] = np.einsum("pk,pkc->pc", weight, table[self.neighbours[patch[rows]]])

        over_blocks(len(patch), BLOCK // NEIGHBOURS, work)
        return result

    def _weights(
        self, position: NDArray[np.float32], normal: NDArray[np.float32], patch: NDArray[np.integer], width: float
    ) -> NDArray[np.float32]:
        """(n, K) normalised kernel weights of the neighbours of each point's patch."""
        near = self.neighbours[patch]
        offset = self.position[near] - position[:, None]
        turn = self.normal[near] - normal[:, None]
        reach = self.size[patch][:, None] * np.float32(width)
        distance, angle = (np.einsum("nkc,nkc->nk", d, d) for d in (offset, turn))
        height = np.einsum("nkc,nc->nk", offset, normal) * np.float32(PLANE_WEIGHT)
        square = (distance + height**2) / reach**2 + angle * np.float32((NORMAL_WEIGHT / width) ** 2)
        weight = np.exp(-0.5 * np.minimum(square - square.min(1, keepdims=True), 60.0))
        return weight / weight.sum(1, keepdims=True)


def _log_level(irradiance: NDArray[np.floating]) -> NDArray[np.float32]:
    """(P,) logarithm of the mean over channels."""
    return np.log(np.maximum(irradiance.mean(1), 1e-9)).astype(np.float32)


def _lit_alike(
    weight: NDArray[np.float32],
    near: NDArray[np.int32],
    patch: NDArray[np.integer],
    level: NDArray[np.float32],
    edge: float,
) -> NDArray[np.float32]:
    """Weights (n, K) of the neighbours ``near`` of patches (n,), less where their log irradiance (P,) differs."""
    square = ((level[near] - level[patch][:, None]) / np.float32(edge)) ** 2
    weight = weight * np.exp(-0.5 * np.minimum(square, 60.0))
    return weight / weight.sum(1, keepdims=True)
