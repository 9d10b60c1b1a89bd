"""Texels of an atlas: which one a surface point falls into, and which face each shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from ..parallel import filled
from .rasterise import covered_texels


@dataclass(frozen=True)
class Atlas:
    """Where the faces of a mesh and the pixels of photos lie on its textures of N by N texels.

    Attributes:
        uv: (F, 3, 2) per corner.
        face: (N, N) int32 face under each texel's centre; beside a chart one of its own, since filters reach there;
            -1 elsewhere.
        texel: (n,) int64 flat index of the texel under each pixel.
    """

    uv: NDArray[np.floating]
    face: NDArray[np.int32]
    texel: NDArray[np.int64]

    @staticmethod
    def of(uv: NDArray[np.floating], size: int, face: NDArray[np.integer], barycentric: NDArray[np.floating]) -> Atlas:
        """Of texture coordinates ``uv`` (F, 3, 2), ``size`` squared texels, and pixels that show points as those of
        :func:`texel_index`."""
        shown, _ = rasterise_atlas(uv, size)
        texel = texel_index(uv, face, barycentric, size)
        # A sliver may hold no texel's centre, but pixels show it.
        beyond = shown.ravel()[texel] < 0
        shown.ravel()[texel[beyond]] = face[beyond]
        beside = np.asarray(maximum_filter(shown, 3))
        return Atlas(uv, np.where(shown < 0, beside, shown), texel)

    @property
    def size(self) -> int:
        """N."""
        return len(self.face)


def interpolate_uv(
    uv: NDArray[np.floating], face: NDArray[np.integer], barycentric: NDArray[np.floating]
) -> NDArray[np.floating]:
    """(n, 2) UV of surface points: ``uv`` (F, 3, 2), weights (n, 2) of corners 1 and 2."""
    u, v = barycentric[:, :1], barycentric[:, 1:]
    corners = uv[face]
    return corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v


def texel_index(
    uv: NDArray[np.floating], face: NDArray[np.integer], barycentric: NDArray[np.floating], size: int
) -> NDArray[np.int64]:
    """(n,) row * size + column of the texel under each surface point; row 0 is the top of the image (v = 1).

    Args:
        uv: (F, 3, 2) per corner.
        face: (n,) face of each point.
        barycentric: (n, 2) weights of corners 1 and 2.
    """

    def texel(rows: slice) -> NDArray[np.int64]:
        point = interpolate_uv(uv, face[rows], barycentric[rows])
        column = np.clip((point[:, 0] * size).astype(np.int64), 0, size - 1)
        row = np.clip(((1 - point[:, 1]) * size).astype(np.int64), 0, size - 1)
        return row * size + column

    return filled(np.empty(len(face), np.int64), texel)


def rasterise_atlas(uv: NDArray[np.floating], size: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """What each texel centre shows.

    Args:
        uv: (F, 3, 2) per corner, charts without overlap.

    Returns:
        (size, size) int32 face, -1 outside all charts, and (size, size, 2) float32 weights of its corners 1 and 2.
    """
    covered = covered_texels(uv, size)
    face = np.full(size * size, -1, np.int32)
    barycentric = np.zeros((size * size, 2), np.float32)
    face[covered.texel] = covered.face
    barycentric[covered.texel] = covered.barycentric
    return face.reshape(size, size), barycentric.reshape(size, size, 2)
