"""Texels of an atlas: which one a surface point falls into, which face each shows, values for those nobody saw."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from .lattice import NEIGHBOURS
from .rasterise import covered_texels


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
    point = interpolate_uv(uv, face, barycentric)
    column = np.clip((point[:, 0] * size).astype(np.int64), 0, size - 1)
    row = np.clip(((1 - point[:, 1]) * size).astype(np.int64), 0, size - 1)
    return row * size + column


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


def fill_texels(values: NDArray[np.floating], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Values for all texels: the known ones stay, gutters repeat the chart beside them, holes blend from around.

    One step of dilation keeps neighbouring charts from bleeding into each other through a gutter of two texels; the
    rest is pull-push (Gortler et al. 1996, section 3.4.1): averages of known texels at ever coarser levels, pushed
    back down to where nothing finer is known.

    Args:
        values: (N, N, C) or (N, N).
        known: (N, N).

    Returns:
        Array like ``values``, float32; unchanged zeros where nothing at all is known.
    """
    image = np.where(known[..., None], np.atleast_3d(values), 0).astype(np.float32)
    weight = known.astype(np.float32)
    _dilate(image, weight)
    levels = [(image, weight)]
    while levels[-1][1].shape[0] > 1 and not (levels[-1][1] > 0).all():
        levels.append(_coarser(*levels[-1]))
    for (fine, mask), (coarse, _) in zip(levels[-2::-1], levels[:0:-1], strict=True):
        _push(fine, mask, coarse)
    return image.reshape(values.shape)


def extend_texels(
    texel: NDArray[np.int64],
    values: NDArray[np.float32],
    known: NDArray[np.bool_],
    label: NDArray[np.integer],
    size: int,
    rounds: int,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """``values`` (T, C) of some texels with those not ``known`` (T,) as the mean of the known ones of their ``label``
    (T,) among the eight around them, so many rounds on; and which are known then.

    Args:
        texel: (T,) flat index of each in the atlas of side ``size``.
    """
    row, column = np.divmod(texel, size)
    image = np.zeros((size, size, values.shape[1]), np.float32)
    labels = np.zeros((size, size), label.dtype)
    told = np.zeros((size, size), bool)
    image[row, column], labels[row, column], told[row, column] = values, label, known
    for _ in range(rounds):
        asked = np.flatnonzero(~told[row, column])
        mean, found = _means_around(image, told, row[asked], column[asked], labels)
        reached = asked[found]
        image[row[reached], column[reached]] = mean[found]
        told[row[reached], column[reached]] = True
    return image[row, column], told[row, column]


def _dilate(image: NDArray[np.float32], weight: NDArray[np.float32]) -> None:
    """Give unknown texels beside known ones the mean of their known neighbours, in place."""
    known = weight > 0
    beside = np.asarray(binary_dilation(known, np.ones((3, 3), bool)), bool)
    row, column = np.nonzero(beside & ~known)
    image[row, column] = _means_around(image, known, row, column)[0]
    weight[row, column] = 1


def _means_around(
    image: NDArray[np.float32],
    known: NDArray[np.bool_],
    row: NDArray[np.integer],
    column: NDArray[np.integer],
    label: NDArray[np.integer] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(k, C) mean of the known ones, with ``label`` those of the same, among the eight texels around each of some, and
    where there is any."""
    last = len(known) - 1
    total = np.zeros((len(row), image.shape[-1]), np.float32)
    count = np.zeros((len(row), 1), np.float32)
    for down, across in NEIGHBOURS:
        inside = (row + down >= 0) & (row + down <= last) & (column + across >= 0) & (column + across <= last)
        at = np.clip(row + down, 0, last), np.clip(column + across, 0, last)
        good = inside & known[at]
        if label is not None:
            good &= label[at] == label[row, column]
        total += np.where(good[:, None], image[at], 0)
        count += good[:, None]
    return total / np.maximum(count, 1), count[:, 0] > 0


def _coarser(
    image: NDArray[np.float32], weight: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Half the resolution: means of the known texels of each 2 x 2 block, and how sure they are (0 to 1)."""
    if len(weight) % 2:
        image, weight = np.pad(image, ((0, 1), (0, 1), (0, 0))), np.pad(weight, ((0, 1), (0, 1)))
    quarters = [(slice(i, None, 2), slice(j, None, 2)) for i in (0, 1) for j in (0, 1)]
    total = sum(weight[q] for q in quarters)
    mean = sum(image[q] * weight[q][..., None] for q in quarters) / np.maximum(total, 1e-12)[..., None]
    return mean, np.minimum(total, 1)


def _push(fine: NDArray[np.float32], weight: NDArray[np.float32], coarse: NDArray[np.float32]) -> None:
    """Bilinear values of ``coarse`` into the texels of ``fine`` that know nothing, in place."""
    row, column = np.nonzero(weight == 0)
    last = len(coarse) - 1
    # Centre of a fine texel in units of coarse ones: (row + 0.5) / 2 - 0.5, a quarter off its own block's centre.
    near = row // 2, column // 2
    far = (
        np.clip(near[0] + np.where(row % 2, 1, -1), 0, last),
        np.clip(near[1] + np.where(column % 2, 1, -1), 0, last),
    )
    fine[row, column] = (
        9 * coarse[near[0], near[1]]
        + 3 * coarse[near[0], far[1]]
        + 3 * coarse[far[0], near[1]]
        + coarse[far[0], far[1]]
    ) / 16
