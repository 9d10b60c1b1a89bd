"""What each photo shows of each patch: one observation per patch and view.

An observation is the mean over the pixels of one view that fall on one patch. It is the unit of every later stage:
some 10^5 to 10^6 of them stand for all pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import group_equal, group_sums
from ..model.light_states import LightStates
from ..model.response import SATURATED

MIXED_WEIGHT = 1e-3
"""Weight of a pixel on an edge: any other that shows the place outweighs it."""


@dataclass(frozen=True)
class Observations:
    """Means over the pixels of one view on one patch, sorted by patch and then by view.

    Attributes:
        patch: (M,) int32.
        view: (M,) int16.
        count: (M,) float32 pixels.
        z: (M, 3) float32 mean display value in [0, 1] (HDR input: radiance).
        spread: (M, 3) float32 standard deviation of the display value over the pixels.
        saturated: (M, 3) float32 share of pixels clipped.
        black: (M, 3) float32 share of pixels whose byte is 0.
        sample: (M,) int64 one pixel of the observation, not on an edge if it has such; index into the pixel samples.
        pixel: (M,) int32 the middle of its pixels in the photo, row-major.
        sample_to_observation: (n,) int32 observation of every pixel sample.
    """

    patch: NDArray[np.int32]
    view: NDArray[np.int16]
    count: NDArray[np.float32]
    z: NDArray[np.float32]
    spread: NDArray[np.float32]
    saturated: NDArray[np.float32]
    black: NDArray[np.float32]
    sample: NDArray[np.int64]
    pixel: NDArray[np.int32]
    sample_to_observation: NDArray[np.int32]

    def apart(self, states: LightStates) -> Observations:
        """The same observations where a patch under another light is another patch: only photos of one light state
        show a place with one radiance."""
        if len(states) == 1:
            return self
        return replace(self, patch=self.patch * np.int32(len(states)) + states.index[self.view].astype(np.int32))

    def of_photos(self, photos: NDArray[np.bool_]) -> Observations:
        """Those of some ``photos`` (V,), with pixel samples numbered as :meth:`.TracedRoom.of_photos` numbers them."""
        rows = photos[self.view]
        kept = rows[self.sample_to_observation]
        columns = {column.name: getattr(self, column.name)[rows] for column in fields(self)[:-1]}
        columns["sample"] = (np.cumsum(kept) - 1)[columns["sample"]]
        number = (np.cumsum(rows) - 1).astype(np.int32)
        return Observations(**columns, sample_to_observation=number[self.sample_to_observation[kept]])


def observe(
    patch: NDArray[np.int32],
    view: NDArray[np.int16],
    pixel: NDArray[np.int32],
    widths: NDArray[np.integer],
    z: NDArray[np.float32],
    mixed: NDArray[np.bool_],
    hdr: bool,
    rng: np.random.Generator,
) -> Observations:
    """Group pixel samples by patch and view.

    Pixels on an edge show other surfaces too: they enter ``count`` like any other, but hardly weigh in the means.

    Args:
        patch: (n,) patch of each pixel.
        view: (n,) view of each pixel.
        pixel: (n,) where it is in its photo, row-major.
        widths: (V,) of the photos in pixels.
        z: (n, 3) display values of the pixels; radiance for HDR input, which never saturates.
        mixed: (n,) pixels on an edge.
        hdr: whether ``z`` is radiance.
        rng: picks the pixel that stands for each observation.
    """
    n_views = int(view.max()) + 1
    key = patch.astype(np.int64) * n_views + view
    order = rng.permutation(len(key))
    order = np.concatenate([order[~mixed[order]], order[mixed[order]]])
    groups = group_equal(key[order])
    unique, count, m = groups.keys, groups.count, len(groups.keys)
    group = np.empty(len(key), np.int32)
    group[order] = groups.group
    weight = np.where(mixed, np.float32(MIXED_WEIGHT), np.float32(1))[:, None]
    norm = np.bincount(group, weight[:, 0], m)[:, None]
    mean = group_sums(weight * z, group, m) / norm
    square = group_sums(weight * z.astype(np.float64) ** 2, group, m) / norm

    def share(pixels: NDArray[np.bool_]) -> NDArray[np.float32]:
        return (group_sums(np.where(pixels, weight, 0), group, m) / norm).astype(np.float32)

    neither = np.zeros((m, 3), np.float32)
    return Observations(
        patch=(unique // n_views).astype(np.int32),
        view=(unique % n_views).astype(np.int16),
        count=count.astype(np.float32),
        z=mean.astype(np.float32),
        spread=np.sqrt(np.maximum(square - mean**2, 0.0)).astype(np.float32),
        saturated=neither if hdr else share(z >= SATURATED),
        black=neither if hdr else share(z <= 0),
        sample=order[groups.order[groups.start]],
        pixel=_middle(pixel, widths[view], group, widths[unique % n_views], count),
        sample_to_observation=group,
    )


def _middle(
    pixel: NDArray[np.int32],
    width: NDArray[np.integer],
    group: NDArray[np.int32],
    width_of_group: NDArray[np.integer],
    count: NDArray[np.integer],
) -> NDArray[np.int32]:
    """(M,) row-major pixel nearest to the mean position of the pixels (n,) of each group."""
    row, column = (np.rint(np.bincount(group, axis) / count) for axis in np.divmod(pixel, width))
    return (row * width_of_group + column).astype(np.int32)
