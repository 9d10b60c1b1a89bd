"""Pixels that the textures never see, on which they are tested."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.capture import first_of_pose
from ..model.recovered import Textures
from ..surface.traced_room import TracedRoom
from ..textures.atlas import Atlas, interpolate_uv
from .maps import bilinear

HELD_OUT_SHARE = 0.02
"""Share of pixels hidden from the textures."""
HELD_OUT_BLOCK, HELD_OUT_MARGIN = 8, 2
"""Side of the hidden blocks, and the pixels along their sides that are not tested: pixels beside a block, from which
texels are interpolated, show a little of them."""
SUBPIXELS = 4
"""Rays along the side of a tested pixel over which base colour is averaged."""

MIN_TESTED = 16
"""Tested pixels of a photo, below which its error says nothing."""
DARK = 0.02
"""Least brightness, of that of the brightest hundredth, that an error is relative to: display values are coarse."""
MISFIT_ERROR, MISFIT_FACTOR = 0.2, 3.0
"""Error of a photo relative to its brightness, and as a multiple of the median photo's, beyond both of which it shows
something else than its pose does (experiment 0160)."""
POOR_PSNR = 18.0
"""Of all tested pixels as displayed, dB, below which something is wrong though the typical pixel is right (0160)."""


@dataclass(frozen=True)
class HeldOut:
    """Which of the n pixels the textures may not see, and on which of these they are tested; (n,) bool each."""

    hidden: NDArray[np.bool_]
    tested: NDArray[np.bool_]


def hold_out(room: TracedRoom, rng: np.random.Generator) -> HeldOut:
    """Blocks of pixels drawn at random, about :data:`HELD_OUT_SHARE` of all.

    Photos of one pose, such as a bracket, lack the same blocks: one would show the textures what is hidden in another.
    """
    samples, block = room.samples, HELD_OUT_BLOCK
    widths = np.array([camera.width for camera in room.cameras])
    blocks = np.array([-(-camera.width // block) * -(-camera.height // block) for camera in room.cameras])
    chosen = rng.random(int(blocks.sum())) < HELD_OUT_SHARE
    row, column = np.divmod(samples.pixel.astype(np.int64), widths[samples.view])
    first = (np.cumsum(blocks) - blocks)[first_of_pose(room.cameras)][samples.view]
    hidden = chosen[first + row // block * -(-widths[samples.view] // block) + column // block]
    inner = (np.minimum(row % block, column % block) >= HELD_OUT_MARGIN) & (
        np.maximum(row % block, column % block) < block - HELD_OUT_MARGIN
    )
    return HeldOut(hidden, hidden & inner)


def base_color_of_pixels(
    textures: Textures, atlas: Atlas, room: TracedRoom, rows: NDArray[np.integer]
) -> NDArray[np.float64]:
    """(k, 3) mean base colour over the pixels ``rows`` (k,), of what they show of the face at their centre's region."""
    samples, regions = room.samples, room.regions.of_face
    total, count = np.zeros((len(rows), 3)), np.zeros(len(rows))
    for view in np.unique(samples.view[rows]):
        own, camera = np.flatnonzero(samples.view[rows] == view), room.cameras[view]
        fine = camera.resized(camera.width * SUBPIXELS, camera.height * SUBPIXELS)
        row, column = np.divmod(samples.pixel[rows[own]].astype(np.int64), camera.width)
        for down in range(SUBPIXELS):
            for across in range(SUBPIXELS):
                pixel = (row * SUBPIXELS + down) * fine.width + column * SUBPIXELS + across
                hits = room.tracer.closest(*fine.rays(pixel))
                face = np.maximum(hits.face, 0)
                same = (hits.face >= 0) & (regions[face] == regions[samples.face[rows[own]]])
                uv = interpolate_uv(atlas.uv, face, hits.barycentric)
                total[own] += np.where(same[:, None], bilinear(textures.base_color, uv), 0)
                count[own] += same
    centre = interpolate_uv(atlas.uv, samples.face[rows], samples.barycentric[rows])
    return np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], bilinear(textures.base_color, centre))


def errors_of_photos(
    found: NDArray[np.floating], shown: NDArray[np.floating], view: NDArray[np.integer], n_views: int
) -> NDArray[np.float64]:
    """(V,) error of the typical tested pixel of each photo relative to its brightness; NaN where few are tested.

    Medians over the pixels of a photo: its mean squared error is that of its lamps and edges, and of how bright it is.

    Args:
        found, shown: (k, 3) values of the tested pixels as explained and as photographed.
        view: (k,) photo of each.
    """
    error, brightness = np.abs(found - shown).mean(1), shown.mean(1)
    errors, dark = np.full(n_views, np.nan), DARK * float(np.quantile(brightness, 0.99)) if len(brightness) else DARK
    for k in np.unique(view):
        own = view == k
        if own.sum() >= MIN_TESTED:
            errors[k] = np.median(error[own]) / max(float(np.median(brightness[own])), dark, 1e-9)
    return errors


def misfits(errors: NDArray[np.floating]) -> NDArray[np.intp]:
    """Photos that the solved room does not explain at all, though it does the others, worst first."""
    known = errors[np.isfinite(errors)]
    if not len(known):
        return np.zeros(0, np.intp)
    worst_first = np.argsort(-np.nan_to_num(errors, nan=-1.0), kind="stable")
    limit = max(MISFIT_ERROR, MISFIT_FACTOR * float(np.median(known)))
    return worst_first[np.nan_to_num(errors, nan=-1.0)[worst_first] > limit]
