"""Texels from what many photos show of them: a texture that explains each photo at the photo's own sharpness.

A photo shows a texel through its pixels, which are wider than the texel or narrower. Their mean over photos is blurred
once by the pixels of each photo, once more where far photos count beside near ones, and a third time when it is read
between texels. The texture T is instead what makes the photos as they are: with M and W the means and weights of what
photos of about one sharpness show, and B the blur of their pixels over linearly read texels,

    min over T of  sum over sharpness l of  W_l (B_l T - M_l)^2

which a few steps of steepest descent (Landweber 1951) approach. Near photos alone determine fine detail, all photos the
rest. Ending early regularises: what no photo resolves stays as it is in the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Integer, kernel
from ..base.parallel import BLOCK, over_blocks, over_shares
from ..lighting.balance import MAX_ALBEDO
from .bake import CHANNEL_MIN_SHARE, DIM_ALBEDO, OUTLIER_DISTANCE, TexelAlbedo
from .texel_points import TexelPoints

BLURS = (0.6, 1.2, 2.4, 4.8)
"""Pixels' sides in texels, one of each kind of photos; each stands for those nearest to it."""
SHARPENING_STEPS = 5
"""Steps of the descent."""
SHARPER = 2.0
"""Power of a photo's sharpness by which it counts more in the mean that outliers are told by."""
STEP_LENGTH = 1.6
"""Of the descent, relative to that which is safe for any photos twice over."""
CONTRADICTED = 4.0
"""Weight of bounds above what a channel shows, over that of what it shows, from which on it is unknown."""
REACH = 3
"""Rows and columns of texels over which a pixel reaches, at most."""


TEXEL_SAMPLE = np.dtype(
    [
        ("row", np.int32),
        ("value", np.float16, 3),
        ("at_least", np.bool_, 3),
        ("weight", np.float16, 3),
        ("blur", np.float16),
        ("light_error", np.float16),
    ]
)
"""What a photo shows of one texel: its index among all texels; base colour, linear Rec.709, whether each channel clips
and its value is a lower bound, and the statistical weight of each; side of what was averaged, in texels; standard
deviation of the log irradiance that the value was divided by."""


def fuse_samples(photos: Sequence[NDArray], points: TexelPoints, size: int) -> TexelAlbedo:
    """The texture that explains the ``photos``, at the texels that one of them shows.

    Args:
        photos: tables of :data:`TEXEL_SAMPLE`, the rows of each ascending; they may lie on disk.
        points: all T texels.
        size: side of the atlas in texels.
    """
    n = len(points.texel)
    mean, total = np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32)
    shown, weight = np.zeros((len(BLURS), n, 3), np.float32), np.zeros((len(BLURS), n, 3), np.float32)
    edges = np.sqrt(np.multiply(BLURS[1:], BLURS[:-1])).astype(np.float32)

    def add_up(rows: slice) -> None:
        reference, above = np.zeros((rows.stop - rows.start, 6), np.float32), np.zeros_like(total[rows])
        sums = shown[:, rows], weight[:, rows], total[rows]
        for photo in photos:
            _add_reference(*_of_rows(photo, rows), rows.start, reference)
        for photo in photos:
            _add_by_blur(*_of_rows(photo, rows), rows.start, reference, edges, *sums)
        with np.errstate(invalid="ignore"):
            found = shown[:, rows].sum(0) / weight[:, rows].sum(0)
        for photo in photos:
            _add_above(*_of_rows(photo, rows), rows.start, found, above)
        told = above <= CONTRADICTED * total[rows]
        weight[:, rows] *= told
        total[rows] *= told

    over_shares(n, add_up)
    with np.errstate(invalid="ignore", divide="ignore"):
        shown = np.where(weight > 0, shown / weight, 0)
        mean = (shown * weight).sum(0) / weight.sum(0)
    norm = total.max(1)
    seen = np.flatnonzero(norm > 0)
    mean[total <= CHANNEL_MIN_SHARE * norm[:, None]] = np.nan
    grid = _Grid.of(points, ~np.isnan(mean).any(1), size)
    sharpened = sharpen(mean, shown, weight, grid)
    return TexelAlbedo(points.texel[seen], sharpened[seen], norm[seen])


def _of_rows(photo: NDArray, rows: slice) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray]:
    """Row, value, whether it is a bound, weight and blur of the samples of the texels ``rows``."""
    some = photo[slice(*np.searchsorted(photo["row"], [rows.start, rows.stop]))]
    value, weight, blur = (some[name].astype(np.float32) for name in ("value", "weight", "blur"))
    return some["row"].copy(), value, some["at_least"].copy(), weight, blur


@kernel
def _add_reference(
    row: NDArray[np.int32],
    value: NDArray[np.float32],
    at_least: NDArray[np.bool_],
    weight: NDArray[np.float32],
    blur: NDArray[np.float32],
    begin: Integer,
    sums: NDArray[np.float32],
) -> None:
    """Add weighted values and weights to ``sums`` (T, 6); sharp photos count for more."""
    for i in range(len(row)):
        sharper = 1 / max(blur[i], np.float32(0.5)) ** np.float32(SHARPER)
        for c in range(3):
            if weight[i, c] > 0 and not at_least[i, c]:
                sums[row[i] - begin, c] += sharper * weight[i, c] * value[i, c]
                sums[row[i] - begin, 3 + c] += sharper * weight[i, c]


@kernel
def _add_by_blur(
    row: NDArray[np.int32],
    value: NDArray[np.float32],
    at_least: NDArray[np.bool_],
    weight: NDArray[np.float32],
    blur: NDArray[np.float32],
    begin: Integer,
    reference: NDArray[np.float32],
    edges: NDArray[np.float32],
    shown: NDArray[np.float32],
    weights: NDArray[np.float32],
    total: NDArray[np.float32],
) -> None:
    """Add samples to the sums of their kind (L, T, 3), with less weight the further they are from the reference."""
    for i in range(len(row)):
        t, level = row[i] - begin, 0
        while level < len(edges) and blur[i] > edges[level]:
            level += 1
        off, bright, known = 0.0, 0.0, 0
        for c in range(3):
            if weight[i, c] > 0 and not at_least[i, c]:
                mean = reference[t, c] / reference[t, 3 + c]
                off += abs(value[i, c] - mean)
                bright += mean
                known += 1
        if known == 0:
            continue
        w = 1 / (1 + (off / ((bright + known * DIM_ALBEDO) * OUTLIER_DISTANCE)) ** 2)
        for c in range(3):
            if weight[i, c] > 0 and not at_least[i, c]:
                shown[level, t, c] += w * weight[i, c] * value[i, c]
                weights[level, t, c] += w * weight[i, c]
                total[t, c] += weight[i, c]


@kernel
def _add_above(
    row: NDArray[np.int32],
    value: NDArray[np.float32],
    at_least: NDArray[np.bool_],
    weight: NDArray[np.float32],
    blur: NDArray[np.float32],
    begin: Integer,
    found: NDArray[np.float32],
    above: NDArray[np.float32],
) -> None:
    """Add to ``above`` (T, 3) the weight of bounds that lie above what the other photos show, ``found`` (T, 3), NaN
    where they show nothing."""
    for i in range(len(row)):
        t = row[i] - begin
        for c in range(3):
            limit = found[t, c] + OUTLIER_DISTANCE * (found[t, c] + DIM_ALBEDO)
            if weight[i, c] > 0 and at_least[i, c] and value[i, c] > limit:
                above[t, c] += weight[i, c]


# ---- sharpening ----------------------------------------------------------------------------------------------------


class _Grid(NamedTuple):
    """Which texels lie beside each other, on the atlas and on the surface.

    Attributes:
        at: (N, N) int32 index of each texel of the atlas, -1 for none.
        texel: (T,) int64 flat index in the atlas.
        beside: (T,) uint64, one bit for each texel within REACH rows and columns: whether it lies there in the room
            and is known.
    """

    at: NDArray[np.int32]
    texel: NDArray[np.int64]
    beside: NDArray[np.uint64]

    @staticmethod
    def of(points: TexelPoints, known: NDArray[np.bool_], size: int) -> _Grid:
        """The grid of an atlas of side ``size``, of whose T texels some are ``known`` (T,)."""
        at = np.full(size * size, -1, np.int32)
        at[points.texel] = np.arange(len(points.texel), dtype=np.int32)
        at, beside = at.reshape(size, size), np.zeros(len(points.texel), np.uint64)
        surface = at, points.texel, points.position, points.size, known
        over_blocks(len(beside), BLOCK, lambda rows: _mark_beside(rows.start, *surface, beside[rows]))
        return _Grid(at, points.texel, beside)


@kernel
def _mark_beside(
    begin: Integer,
    at: NDArray[np.int32],
    texel: NDArray[np.int64],
    position: NDArray[np.float32],
    size: NDArray[np.float32],
    known: NDArray[np.bool_],
    beside: NDArray[np.uint64],
) -> None:
    side = len(at)
    for k in range(len(beside)):
        own, bit = begin + k, np.uint64(1)
        i, j = texel[own] // side, texel[own] % side
        for down in range(-REACH, REACH + 1):
            for across in range(-REACH, REACH + 1):
                row, column = i + down, j + across
                near = at[row, column] if 0 <= row < side and 0 <= column < side else -1
                if near >= 0 and known[near]:
                    distance = 0.0
                    for axis in range(3):
                        distance += (position[near, axis] - position[own, axis]) ** 2
                    if distance <= 4 * (down * down + across * across) * size[own] ** 2:
                        beside[k] |= bit
                bit = np.uint64(bit << np.uint64(1))


def sharpen(
    mean: NDArray[np.float32],
    shown: NDArray[np.float32],
    weight: NDArray[np.float32],
    grid: _Grid,
    steps: int = SHARPENING_STEPS,
) -> NDArray[np.float32]:
    """(T, 3) the texture after some steps of descent from ``mean`` (T, 3), NaN where that is.

    Args:
        shown, weight: (L, T, 3) what photos of each kind show, and its weight.
    """
    texture = mean.copy()
    everywhere = np.arange(len(mean))
    kinds = [(at, pixel_kernel(b)) for at, b in zip(map(_shown_by, weight), BLURS, strict=True)]
    norm = np.zeros_like(mean)
    for of_kind, (at, kernel_) in zip(weight, kinds, strict=True):
        if len(at):
            norm += _blurred(of_kind, kernel_, grid, everywhere)
    for _ in range(steps):
        change = np.zeros_like(texture)
        for values, of_kind, (at, kernel_) in zip(shown, weight, kinds, strict=True):
            if len(at):
                error = np.zeros_like(texture)
                error[at] = np.nan_to_num(of_kind[at] * (values[at] - _blurred(texture, kernel_, grid, at)))
                change += _blurred(error, kernel_, grid, everywhere)
        texture = np.clip(texture + STEP_LENGTH * change / np.maximum(norm, 1e-12), 0.0, MAX_ALBEDO)
    return texture


def _shown_by(weight: NDArray[np.float32]) -> NDArray[np.int64]:
    """Texels that photos of a kind with the ``weight`` (T, 3) show."""
    return np.flatnonzero((weight > 0).any(1))


def pixel_kernel(blur: float) -> NDArray[np.float32]:
    """(REACH + 1,) weights of the texels 0, 1, 2 ... away from a pixel's centre along one axis: the mean over its side,
    ``blur`` texels, of texels that are read by linear interpolation."""
    x = (np.arange(1000) + 0.5) / 1000 * blur - blur / 2
    weights = np.array([np.maximum(1 - np.abs(x - d), 0).mean() for d in range(REACH + 1)])
    return (weights / (weights[0] + 2 * weights[1:].sum())).astype(np.float32)


def _blurred(
    values: NDArray[np.float32], weights: NDArray[np.float32], grid: _Grid, at: NDArray[np.int64]
) -> NDArray[np.float32]:
    """(k, 3) ``values`` (T, 3) as pixels of one kind show them, at the texels ``at`` (k,)."""
    result = np.empty((len(at), 3), np.float32)
    reach = int(np.flatnonzero(weights > 0).max())
    over_blocks(len(at), BLOCK, lambda rows: _blur(at[rows], values, weights, reach, *grid, result[rows]))
    return result


@kernel
def _blur(
    rows: NDArray[np.int64],
    values: NDArray[np.float32],
    weights: NDArray[np.float32],
    reach: Integer,
    at: NDArray[np.int32],
    texel: NDArray[np.int64],
    beside: NDArray[np.uint64],
    result: NDArray[np.float32],
) -> None:
    """Texels beside another chart, or beside unknown ones, are taken to go on as they are."""
    side, inner = len(at), np.uint64(0)
    for down in range(-reach, reach + 1):
        for across in range(-reach, reach + 1):
            inner |= np.uint64(1) << np.uint64((down + REACH) * (2 * REACH + 1) + across + REACH)
    for k in range(len(rows)):
        own = rows[k]
        i, j = texel[own] // side, texel[own] % side
        a = b = c = total = np.float32(0)
        if beside[own] & inner == inner:  # the usual case: whole rows, which lie side by side in memory
            for down in range(-reach, reach + 1):
                first = at[i + down, j - reach]
                for across in range(2 * reach + 1):
                    w = weights[abs(down)] * weights[abs(across - reach)]
                    a += w * values[first + across, 0]
                    b += w * values[first + across, 1]
                    c += w * values[first + across, 2]
            total = np.float32(1)  # which the weights sum to
        else:
            for down in range(-reach, reach + 1):
                for across in range(-reach, reach + 1):
                    bit = np.uint64((down + REACH) * (2 * REACH + 1) + across + REACH)
                    if (beside[own] >> bit) & np.uint64(1):
                        near = at[i + down, j + across]
                        w = weights[abs(down)] * weights[abs(across)]
                        a += w * values[near, 0]
                        b += w * values[near, 1]
                        c += w * values[near, 2]
                        total += w
        if total > 0:
            result[k, 0], result[k, 1], result[k, 2] = a / total, b / total, c / total
        else:
            result[k, 0], result[k, 1], result[k, 2] = values[own, 0], values[own, 1], values[own, 2]
