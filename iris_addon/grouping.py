"""Rows that belong together: equal keys brought side by side, and sums, means and medians over them.

torch sorts integers by their digits, on all cores, in a fifth of the time numpy's comparisons take.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

Key = TypeVar("Key", bound=np.integer)


@dataclass(frozen=True)
class Groups(Generic[Key]):
    """The n rows of equal keys.

    Attributes:
        keys: (m,) the distinct keys, ascending.
        group: (n,) int32 group of each row.
        order: (n,) int64 rows by group, and in a group as they came.
        start: (m,) int64 where each group begins in ``order``.
        count: (m,) int64 rows of each group.
    """

    keys: NDArray[Key]
    group: NDArray[np.int32]
    order: NDArray[np.int64]
    start: NDArray[np.int64]
    count: NDArray[np.int64]


def group_equal(keys: NDArray[Key]) -> Groups[Key]:
    """Groups of equal ``keys`` (n,), of 64 bits each."""
    order = stable_order(keys)
    ordered = keys[order]
    starts = np.empty(len(keys), bool)
    starts[:1] = True
    np.not_equal(ordered[1:], ordered[:-1], out=starts[1:])
    start = np.flatnonzero(starts)
    group = np.empty(len(keys), np.int32)
    group[order] = np.cumsum(starts, dtype=np.int32) - np.int32(1)
    return Groups(ordered[start], group, order, start, np.diff(start, append=len(keys)))


def stable_order(keys: NDArray[np.integer]) -> NDArray[np.int64]:
    """(n,) indices that sort integers of 64 bits; equal ones stay as they came."""
    # torch has no order for unsigned ones; with the top bit flipped signed ones have theirs.
    signed = (keys ^ np.uint64(1 << 63)).view(np.int64) if keys.dtype == np.uint64 else keys
    return torch.argsort(torch.from_numpy(np.ascontiguousarray(signed)), stable=True).numpy()


def order_in_groups(values: NDArray[np.floating], group: NDArray[np.integer]) -> NDArray[np.int64]:
    """(n,) indices that sort by ``group`` (not negative) and in a group by ``values``, to the precision of float32.

    One sort of 64-bit keys, in a third of the time of two: the bits of floats are in the order of the floats once the
    sign bit of the positive ones and all bits of the negative ones are flipped.
    """
    bits = values.astype(np.float32).view(np.int32)
    ordered = bits.view(np.uint32) ^ ((bits >> 31).view(np.uint32) | np.uint32(1 << 31))
    return stable_order(group.astype(np.int64) << np.int64(32) | ordered)


def group_sums(values: NDArray[np.floating], group: NDArray[np.integer], n_groups: int) -> NDArray[np.float64]:
    """(n_groups, C) sum of ``values`` (n, C) per group."""
    columns = [np.bincount(group, values[:, c], n_groups) for c in range(values.shape[1])]
    return np.stack(columns, -1).astype(np.float64, copy=False)


def group_means(values: NDArray[np.floating], group: NDArray[np.integer], n_groups: int) -> NDArray[np.float64]:
    """(n_groups, C) mean of ``values`` (n, C) per group; zero where a group is empty."""
    count = np.maximum(np.bincount(group, minlength=n_groups), 1)
    return group_sums(values, group, n_groups) / count[:, None]


def group_medians(values: NDArray[np.floating], group: NDArray[np.integer], n_groups: int) -> NDArray[np.float64]:
    """(n_groups, C) median of ``values`` (n, C) per group; zero where a group is empty."""
    count = np.bincount(group, minlength=n_groups)
    some = count > 0
    start, count = (np.cumsum(count) - count)[some], count[some]
    medians = np.zeros((n_groups, values.shape[1]))
    for channel, column in enumerate(values.T):
        ordered = column[order_in_groups(column, group)]
        medians[some, channel] = (ordered[start + (count - 1) // 2] + ordered[start + count // 2]) / 2
    return medians
