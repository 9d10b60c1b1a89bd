"""Values for the texels of an atlas that no photo shows, from those around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from ..base.compiled import kernel
from ..base.parallel import BLOCK, over_blocks


def fill_texels(values: NDArray[np.floating], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Values for all texels: known ones stay, gutters repeat the chart beside them, holes are blended in.

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
    """Extend known texels over unknown ones of the same label, one texel per round.

    Args:
        texel: (T,) flat index of each in an atlas of side ``size``.
        values: (T, C) of each.
        known: (T,) bool; the others take the mean of the known ones among the eight texels around them.
        label: (T,) that a texel shares with those it takes values from.

    Returns:
        Values (T, C), and which of them are known (T,).
    """
    row, column = np.divmod(texel, size)
    image = np.zeros((size, size, values.shape[1]), np.float32)
    labels = np.zeros((size, size), label.dtype)
    filled = np.zeros((size, size), bool)
    image[row, column], labels[row, column], filled[row, column] = values, label, known
    for _ in range(rounds):
        unknown = np.flatnonzero(~filled[row, column])
        mean, found = _means_around(image, filled, row[unknown], column[unknown], labels)
        reached = unknown[found]
        image[row[reached], column[reached]] = mean[found]
        filled[row[reached], column[reached]] = True
    return image[row, column], filled[row, column]


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
    """(k, C) mean of the ``known`` (N, N) texels of ``image`` (N, N, C) among the eight around each of k, and whether
    there is any (k,); with ``label`` (N, N) only of those of the same label."""
    mean, found = np.empty((len(row), image.shape[-1]), np.float32), np.empty(len(row), bool)
    labels = np.zeros((0, 0), np.int32) if label is None else label
    over_blocks(len(row), BLOCK, lambda at: _add_around(image, known, row[at], column[at], labels, mean[at], found[at]))
    return mean, found


@kernel
def _add_around(
    image: NDArray[np.float32],
    known: NDArray[np.bool_],
    row: NDArray[np.integer],
    column: NDArray[np.integer],
    label: NDArray[np.integer],
    mean: NDArray[np.float32],
    found: NDArray[np.bool_],
) -> None:
    last = len(known) - 1
    for k in range(len(row)):
        i, j, count = row[k], column[k], 0
        for c in range(image.shape[2]):
            mean[k, c] = 0.0
        for y in range(max(i - 1, 0), min(i + 1, last) + 1):
            for x in range(max(j - 1, 0), min(j + 1, last) + 1):
                if (y != i or x != j) and known[y, x] and (len(label) == 0 or label[y, x] == label[i, j]):
                    count += 1
                    for c in range(image.shape[2]):
                        mean[k, c] += image[y, x, c]
        found[k] = count > 0
        for c in range(image.shape[2]):
            mean[k, c] /= max(count, 1)


def _coarser(
    image: NDArray[np.float32], weight: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Image and weight at half the resolution: means of the known texels of each 2 x 2 block, and their weight, 0 to
    1."""
    if len(weight) % 2:
        image, weight = np.pad(image, ((0, 1), (0, 1), (0, 0))), np.pad(weight, ((0, 1), (0, 1)))
    quarters = [(slice(i, None, 2), slice(j, None, 2)) for i in (0, 1) for j in (0, 1)]
    total = sum(weight[q] for q in quarters)
    mean = sum(image[q] * weight[q][..., None] for q in quarters) / np.maximum(total, 1e-12)[..., None]
    return mean, np.minimum(total, 1)


def _push(fine: NDArray[np.float32], weight: NDArray[np.float32], coarse: NDArray[np.float32]) -> None:
    """Write bilinear values of ``coarse`` into the texels of ``fine`` that have no weight, in place."""
    over_blocks(
        len(fine), max(1, BLOCK // len(fine)), lambda rows: _push_rows(rows.start, fine[rows], weight[rows], coarse)
    )


@kernel
def _push_rows(first: int, fine: NDArray[np.float32], weight: NDArray[np.float32], coarse: NDArray[np.float32]) -> None:
    # Centre of a fine texel in units of coarse ones: (row + 0.5) / 2 - 0.5, a quarter off its own block's centre.
    last = len(coarse) - 1
    for k in range(fine.shape[0]):
        i, near = first + k, (first + k) // 2
        far = min(max(near + (1 if i % 2 else -1), 0), last)
        for j in range(fine.shape[1]):
            if weight[k, j] == 0:
                beside = j // 2
                across = min(max(beside + (1 if j % 2 else -1), 0), last)
                for c in range(fine.shape[2]):
                    fine[k, j, c] = (
                        9 * coarse[near, beside, c]
                        + 3 * (coarse[near, across, c] + coarse[far, beside, c])
                        + coarse[far, across, c]
                    ) / 16
