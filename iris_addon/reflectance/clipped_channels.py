"""Colour of texels of which some channels were clipped in every photo.

The white of a rug in the sun is read in blue alone. What red and green it has is told by texels of its part that are as
blue and were seen whole, in the shade of a table; the mean colour of the part is that of the rug's red pattern too.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..emission.balance import MAX_ALBEDO
from ..grouping import group_equal, group_medians

STEPS = 3
"""Steps per octave of brightness, and of the balance between channels, by which texels count as alike."""
ENOUGH = 10
"""Texels seen whole that are asked for, to tell what others like them have."""
LEAST = 1e-3
LEVELS = 32
"""Steps of brightness; so many of the balance too, around even."""
ALL = 7
"""Bits of the three channels."""
KNOWN: tuple[Sequence[int], ...] = (*combinations(range(3), 1), *combinations(range(3), 2))


def complete_channels(
    value: NDArray[np.floating], part: NDArray[np.integer], part_mean: NDArray[np.floating]
) -> NDArray[np.float32]:
    """(T, 3) texels with the channels that were clipped in every photo as those of their part have them that look alike
    in the others, and where those are few as the part has them on the mean.

    Args:
        value: (T, 3) base colour, NaN where clipped; one channel at least is known.
        part: (T,) part of each texel.
        part_mean: (n_parts, 3) base colour.
    """
    known = np.isfinite(value)
    code = (known * np.array([1, 2, 4], np.uint8)).sum(1, dtype=np.uint8)
    clipped = np.flatnonzero(code != ALL)
    completed = value.astype(np.float32)
    completed[clipped] = _like_the_part(value[clipped], part_mean[part[clipped]])
    for channels in KNOWN:
        rows = np.flatnonzero(code == sum(1 << c for c in channels))
        lacking = np.zeros(len(part_mean), bool)
        lacking[part[rows]] = True
        whole = np.flatnonzero((code == ALL) & lacking[part])
        if len(whole):
            share, found = _share_of_like(value[rows], part[rows], value[whole], part[whole], channels)
            guess = value[rows][:, channels].sum(1, keepdims=True) * share
            guess = np.where(known[rows], value[rows], np.minimum(guess, MAX_ALBEDO))
            completed[rows[found]] = guess[found]
    return completed


def _like_the_part(value: NDArray[np.floating], colour: NDArray[np.floating]) -> NDArray[np.floating]:
    """(n, 3) texels completed by the ratio between the channels of ``colour`` (n, 3)."""
    known = np.isfinite(value)
    scale = np.where(known, value, 0.0).sum(1) / np.maximum((colour * known).sum(1), 1e-4)
    return np.where(known, value, np.clip(colour * scale[:, None], 0.0, MAX_ALBEDO))


def _share_of_like(
    value: NDArray[np.floating],
    part: NDArray[np.integer],
    whole: NDArray[np.floating],
    part_of_whole: NDArray[np.integer],
    channels: Sequence[int],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Median colour of the texels ``whole`` (w, 3) that look in the ``channels`` like each of ``value`` (n, 3) and are
    of its part, over their sum in the channels, (n, 3); and where there are enough of them, (n,)."""
    asked, look = group_equal(_look(value, part, channels)), _look(whole, part_of_whole, channels)
    at = np.minimum(np.searchsorted(asked.keys, look), len(asked.keys) - 1)
    alike = np.flatnonzero(asked.keys[at] == look)
    told, colour = at[alike], whole[alike]
    share = colour / np.maximum(colour[:, channels].sum(1, keepdims=True), LEAST)
    median = group_medians(share, told, len(asked.keys))
    enough = np.bincount(told, minlength=len(asked.keys)) >= ENOUGH
    return median[asked.group], enough[asked.group]


def _look(value: NDArray[np.floating], part: NDArray[np.integer], channels: Sequence[int]) -> NDArray[np.int64]:
    """(n,) number that texels of one part have in common which look alike in the ``channels``."""
    seen = np.log2(np.maximum(value[:, channels], LEAST)) * STEPS
    level = np.clip(np.rint(seen.mean(1)) + LEVELS - 1, 0, LEVELS - 1)
    balance = np.clip(np.rint(seen[:, -1] - seen[:, 0]) + LEVELS // 2, 0, LEVELS - 1)
    return (part.astype(np.int64) * LEVELS + level.astype(np.int64)) * LEVELS + balance.astype(np.int64)
