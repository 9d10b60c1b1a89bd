"""Do the photos show anything? Plain, black, clipped, noisy, copied and grey ones are found, and bars around pictures.

A photo without contrast fits every mesh and every response, so that a solve runs to its end and means nothing. One
picture under several poses is as bad, and bars would be painted onto the room.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.parallel import over_each
from ..model.capture import View
from ..model.response import SATURATED
from .photo_files import PhotoPixels, read_photo
from .photos import photos_at_once, read_pixels

CONTENT_WIDTH = 128
"""Blocks of pixels in a row, at most about, whose means are looked at."""
CONTENT_SHRINKS = (8, 4, 2, 1)
"""Factors by which a JPEG decoder may shrink, as long as pixels enough are left."""
PLAIN_DEPARTURE, PLAIN_NOISE = 2.5 / 255, 12 / 255
"""Largest difference of the mean of a sixteenth of the width, and of a block, from the median of all, display values,
in a photo of one plain colour with the noise of a camera."""
COARSE = 16
"""Means in a row that average that noise away."""
SPOT_DEPARTURE, SPOT_PIXELS = 0.1, 4
"""So many pixels that differ so much from the median are something: a lamp in a photo that is dark otherwise."""
WHITE_CORRELATION, WHITE_STD = 0.1, 2.0
"""Correlation of neighbouring pixels, and spread of block means over that of averaged noise, up to which a photo is
nothing but noise. Texture of any kind has neighbours that are alike."""
SOME_PIXELS = 5
"""One pixel of so many rows and columns tells how much all differ."""
MIN_VALID = 0.02
"""Share of pixels that must be picture."""
SAME_PICTURE = 0.5 / 255
"""Largest difference of block means of two copies of one picture."""
GREY_DEPARTURE = 0.5 / 255
"""Largest difference of channels of a block mean in a photo without color; noise and white balance make it larger."""
MIN_TURN, MIN_MOVE = np.radians(1.0), 0.02
"""Turn in radians, or movement over the extent of all cameras, from which two photos cannot be one picture."""
MIN_BAR_PHOTOS = 4
"""Photos that must share a bar for it to be one."""
MIN_LEFT = 4
"""Photos that must be left where some show nothing."""
MAX_COPIED_SHARE = 1 / 3
"""Of the photos, that may be copies of others."""

LOSSLESS, JPEG_BLOCK = (".png", ".tif", ".tiff", ".bmp", ".exr"), 16
"""Suffixes of formats that keep pixels apart, and the pixels that JPEG codes together."""
Margins = tuple[int, int, int, int]
"""Pixels of a photo left, above, right and below that are no picture."""
SIDES = ("left", "top", "right", "bottom")
PLAIN, BLACK, CLIPPED, NOISE, MASKED = "one plain color", "black", "all clipped", "nothing but noise", "all masked"


@dataclass(frozen=True)
class Content:
    """What a photo shows, in short.

    Attributes:
        nothing: why it shows nothing, "" where it does.
        means: (h, w, 3) float32 means of blocks of ``block`` x ``block`` pixels of the file, NaN without picture.
        flat: (h, w) blocks whose pixels all have one colour.
        grey: whether the channels are one, as in a photo that was made black and white.
    """

    nothing: str
    means: NDArray[np.float32]
    flat: NDArray[np.bool_]
    block: int
    grey: bool


def showing_something(
    views: Sequence[View], strict: bool = False, check: Callable[[], None] = lambda: None
) -> tuple[list[View], list[str]]:
    """The views whose photos show something, with the bars around their pictures, and warnings about the rest.

    Args:
        strict: refuse a capture in which any photo shows nothing.
        check: called often; may raise, as for a cancel.

    Raises:
        BadInput: too few photos are left, or photos under different poses are copies of one picture.
    """
    contents = over_each(views, content_of, lambda _: check(), photos_at_once(views))
    empty = [k for k, content in enumerate(contents) if content.nothing]
    kinds = Counter(contents[k].nothing for k in empty)
    left = [k for k, content in enumerate(contents) if not content.nothing]
    warnings = []
    if empty:
        how = ", ".join(kinds) if len(kinds) == 1 else ", ".join(f"{count} {kind}" for kind, count in kinds.items())
        said = f"{len(empty)} of {len(views)} photos show nothing ({how})"
        if strict or len(left) < min(MIN_LEFT, len(views)):
            mend = "check that these are the photos, open a few of them, and export them again"
            raise BadInput(f"{said}, this one among them", mend, views[empty[0]].photo)
        warnings.append(f"{said} and are left out: {_some([views[k].name for k in empty])}")
    copies = _copies([views[k] for k in left], [contents[k] for k in left])
    if copies:
        names = [views[left[k]].name for k in copies]
        said = f"{len(copies)} of {len(views)} photos are the same picture as another, though their cameras differ"
        if strict or len(copies) > MAX_COPIED_SHARE * len(left) or len(left) - len(copies) < MIN_LEFT:
            mend = "check that each photo is in the folder once, and export them again"
            raise BadInput(f"{said}, this one among them", mend, views[left[copies[0]]].photo)
        warnings.append(f"{said}, and are left out: {_some(names)}")
        left = [k for rank, k in enumerate(left) if rank not in set(copies)]
    kept = [views[k] for k in left]
    warnings += _grey(kept, [contents[k].grey for k in left])
    lossy = any(view.photo is not None and view.photo.suffix.lower() not in LOSSLESS for view in kept)
    margins = _bars([contents[k] for k in left], JPEG_BLOCK if lossy else 1, _narrowest(kept))
    if any(margins):
        sides = [f"{width} pixels {side}" for side, width in zip(SIDES, margins, strict=True) if width]
        warnings.append(
            f"all photos have the same plain bars around the picture, which are left out: {', '.join(sides)}"
        )
        kept = [replace(view, margins=_wider(view.margins, margins)) for view in kept]
    return kept, warnings


def content_of(view: View) -> Content:
    """What the photo of ``view`` shows; raises BadInput where it cannot be read."""
    pixels, shrink = _pixels(view)
    values, valid = pixels.values, pixels.valid
    if pixels.hdr:
        values = values / max(float(np.quantile(values[valid][::SOME_PIXELS], 0.99)) if valid.any() else 0.0, 1e-9)
    side = max(1, values.shape[1] // CONTENT_WIDTH)
    height, width = values.shape[0] // side, values.shape[1] // side

    def blocks(array: NDArray, reduce: np.ufunc) -> NDArray:
        """(h, w, ...) ``array`` (H, W, ...) reduced over each block, rows first because these lie together."""
        rows = reduce.reduce(array[: height * side, : width * side].reshape(height, side, width * side, -1), 1)
        return reduce.reduce(rows.reshape(height, width, side, -1), 2)

    whole = np.ones((height, width), bool) if valid.all() else blocks(valid, np.logical_and)[..., 0]
    means = np.where(whole[..., None], blocks(values, np.add) / np.float32(side**2), np.float32(np.nan))
    flat = whole & (blocks(values, np.maximum) - blocks(values, np.minimum) < 1 / 255).all(-1)
    grey = bool(np.nanmax(np.ptp(means, axis=-1), initial=0.0) < GREY_DEPARTURE)
    nothing = _nothing(values, valid, means, side, pixels.hdr)
    return Content(nothing=nothing, means=means, flat=flat, block=side * shrink, grey=grey)


def _pixels(view: View) -> tuple[PhotoPixels, int]:
    """The pixels of a photo as the lens shows them, smaller where that is quick, and by what factor."""
    if view.photo is None or view.mask is not None:
        return read_pixels(view), 1
    large = max(view.camera.width, view.camera.height)
    shrink = next(factor for factor in CONTENT_SHRINKS if factor == 1 or large // factor >= 4 * CONTENT_WIDTH)
    pixels = read_photo(view.photo, shrink).turned(view.orientation)
    return pixels, round(view.camera.width / pixels.values.shape[1]) if shrink > 1 else 1


def _nothing(
    values: NDArray[np.float32], valid: NDArray[np.bool_], means: NDArray[np.float32], side: int, hdr: bool
) -> str:
    """Why pixels (H, W, 3), with means (h, w, 3) of blocks of ``side`` pixels, show nothing; "" where they do."""
    found = means[np.isfinite(means[..., 0])]
    if not len(found) or valid.mean() < MIN_VALID:
        return MASKED
    middle = np.median(found, axis=0)
    if _is_plain(means, middle):
        seen = values[valid]
        spots = int((np.abs(seen - middle) > SPOT_DEPARTURE).any(-1).sum())
        if spots < SPOT_PIXELS or _is_white_noise(values, means, side):
            if float(middle.max()) < PLAIN_DEPARTURE or (hdr and not seen.any()):
                return BLACK
            return CLIPPED if not hdr and float(middle.min()) >= SATURATED else PLAIN
    return NOISE if _is_white_noise(values, means, side) else ""


def _is_plain(means: NDArray[np.float32], middle: NDArray[np.float32]) -> bool:
    """Whether block means (h, w, 3) depart from their median (3,) by no more than noise does."""
    if float(np.nanmax(np.abs(means - middle))) > PLAIN_NOISE:
        return False
    side = max(1, means.shape[1] // COARSE)
    height, width = means.shape[0] // side, means.shape[1] // side
    coarse = means[: height * side, : width * side].reshape(height, side, width, side, 3).mean((1, 3))
    return not (np.abs(coarse - middle) > PLAIN_DEPARTURE).any()


def _is_white_noise(values: NDArray[np.float32], means: NDArray[np.float32], side: int) -> bool:
    """Whether no pixel tells anything of its neighbours, nor blocks more than chance does."""
    some = values[::SOME_PIXELS, ::SOME_PIXELS].mean(-1, dtype=np.float64)
    if not float(np.nanstd(means.mean(-1))) < WHITE_STD * float(some.std()) / side:
        return False  # as nearly all photos, before every pixel is looked at
    grey = values.mean(-1, dtype=np.float64)
    grey -= grey.mean()
    along = float((grey[:, 1:] * grey[:, :-1]).mean()), float((grey[1:] * grey[:-1]).mean())
    return max(along) < WHITE_CORRELATION * float((grey**2).mean())


def _grey(views: Sequence[View], grey: Sequence[bool]) -> list[str]:
    """A warning where photos have no color."""
    names = [view.name for view, one in zip(views, grey, strict=True) if one]
    if not names:
        return []
    if len(names) == len(views):
        return ["no photo has color, so that materials and lamps will be grey: export the photos in color"]
    return [
        f"{len(names)} of {len(views)} photos have no color and make materials and lamps paler than they are: "
        f"export them in color, or leave them out: {_some(names)}"
    ]


def _copies(views: Sequence[View], contents: Sequence[Content]) -> list[int]:
    """Indices of photos whose picture another photo has too, from a clearly different camera."""
    if not views:
        return []
    positions = np.array([view.camera.position for view in views])
    extent = max(float(np.linalg.norm(np.ptp(positions, axis=0))), 1e-9)
    levels = np.array([np.nanmean(content.means) for content in contents])
    order, copied = np.argsort(levels, kind="stable"), set()
    for rank, a in enumerate(order):
        for b in order[rank + 1 :]:
            if levels[b] - levels[a] > SAME_PICTURE:
                break
            if {a, b} <= copied or contents[a].means.shape != contents[b].means.shape:
                continue
            if np.nanmax(np.abs(contents[a].means - contents[b].means), initial=0.0) > SAME_PICTURE:
                continue
            # Of the difference, because poses of trackers are rotations to three decimals only.
            apart = np.linalg.norm(views[a].camera.c2w[:3, :3] - views[b].camera.c2w[:3, :3])
            angle = 2 * np.arcsin(min(float(apart) / 8**0.5, 1.0))
            if angle > MIN_TURN or np.linalg.norm(positions[a] - positions[b]) > MIN_MOVE * extent:
                copied |= {a, b}
    return sorted(int(k) for k in copied)


def _bars(contents: Sequence[Content], coded: int, known: Margins) -> Margins:
    """Pixels left, top, right and bottom that have one and the same plain colour in all photos.

    A bar ends somewhere within a block, which is left out with it, as is the block of ``coded`` pixels that a lossy
    format has mixed there. None where it lies within the pixels ``known`` to be no picture.
    """
    none = (0, 0, 0, 0)
    if len(contents) < MIN_BAR_PHOTOS or len({(content.means.shape, content.block) for content in contents}) > 1:
        return none
    first, block = contents[0], contents[0].block
    means = np.stack([content.means for content in contents])
    same = (np.abs(means - first.means) < SAME_PICTURE).all((0, 3)) & np.all([one.flat for one in contents], axis=0)

    def leading(rows: NDArray[np.bool_], colors: NDArray[np.float32], known: int) -> int:
        """Pixels of the bar along the first axis; none where it covers all."""
        plain = rows.all(1) & (np.abs(colors - colors[0, 0]) < SAME_PICTURE).all((1, 2))
        count = len(plain) if plain.all() else int(np.argmin(plain))
        if count == len(plain) or count * block <= known:
            return 0
        return (count + 1) * block if coded == 1 else -(-(count * block + coded) // coded) * coded

    columns, colors = same.T, first.means.transpose(1, 0, 2)
    left, right = leading(columns, colors, known[0]), leading(columns[::-1], colors[::-1], known[2])
    top, bottom = leading(same, first.means, known[1]), leading(same[::-1], first.means[::-1], known[3])
    return left, top, right, bottom


def _narrowest(views: Sequence[View]) -> Margins:
    """What is no picture in any of the views by what their format says."""
    if not views:
        return 0, 0, 0, 0
    left, top, right, bottom = (min(of_views) for of_views in zip(*(view.margins for view in views), strict=True))
    return left, top, right, bottom


def _wider(a: Margins, b: Margins) -> Margins:
    left, top, right, bottom = (max(pair) for pair in zip(a, b, strict=True))
    return left, top, right, bottom


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (" …" if len(names) > 5 else "")
