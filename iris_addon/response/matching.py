"""The exposure of a picture of a solved room, found by comparing it with a render of that room.

With the picture z, the response f and rendered radiance L, every pixel names an exposure f⁻¹(z) / L, per channel. Most
agree; people who walk through the picture, things that the room lacks and reflections do not. The exposure is the
location of the logarithms by Tukey's biweight (Beaton & Tukey 1974), which pixels far off do not move at all, weighted
by how finely a code tells the exposure. Needs no package but numpy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..model.capture import Photo
from ..model.response import Response

FloatArray = NDArray[np.floating]

HALF_CODE = 0.5 / 255
"""Codes of photos are floors (:mod:`iris_addon.model.response`)."""
MATCH_MIDTONES = (0.04, 0.96)
"""Display values between which a pixel tells the exposure, in the picture and as the render predicts it."""
MATCH_PIXELS = 16
"""Pixels of each channel that must."""
MATCH_ROOM_ERROR = 0.1
"""Natural logarithm by which a pixel of the solved room is typically wrong: codes finer than that weigh no more."""
BIWEIGHT, MATCH_STEPS = 4.685, 50
"""Tukey's constant (95 % efficient where errors are normal), and the most steps until the location stands still."""
MIN_SPREAD, STANDS_STILL = 0.02, 1e-5
"""Natural logarithms: least spread assumed of the pixels, and change of the location that ends the search."""


def match_exposure(
    radiance: FloatArray, picture: Photo, response: Response, gain: FloatArray | float = 1.0
) -> FloatArray:
    """(3,) exposure × white balance at which a render of the room looks like ``picture``.

    Args:
        radiance: (H, W, 3) scene-linear, what the camera of the picture sees in the solved room.
        picture: of display values, or of radiance in a unit of its own; the response is not used then.
        gain: local exposure of the picture, broadcastable to it.

    Raises:
        BadInput: too little of the picture is neither black nor clipped.
    """
    z = picture.values.astype(np.float64)
    seen = z if picture.hdr else response.invert(np.minimum(z + HALF_CODE, 1.0))
    low, high = (0.0, np.inf) if picture.hdr else MATCH_MIDTONES
    light = radiance * np.broadcast_to(gain, seen.shape)
    usable = picture.valid[..., None] & (z > low) & (z < high) & (seen > 0) & (light > 0) & np.isfinite(light)
    if min(usable[..., c].sum() for c in range(3)) < MATCH_PIXELS:
        raise BadInput("shows too little that is neither black nor clipped", "leave the frame out: no exposure fits it")
    found = np.ones(3)
    for c in range(3):
        x, L = seen[..., c][usable[..., c]], light[..., c][usable[..., c]]
        if picture.hdr:
            bounds, weights = (0.0, np.inf), np.ones_like(x)
        else:
            curve = np.clip(np.linspace(0.0, 1.0, response.samples.shape[1]), 1e-9, None)
            bounds = tuple(np.interp(MATCH_MIDTONES, response.samples[c], curve))
            # One code is so much of the logarithm of x; the curve may be flat somewhere.
            code = 1 / 255 / np.maximum(np.interp(x, curve, response.slopes[c]) * x, 1e-6)
            weights = 1.0 / (code**2 / 12 + MATCH_ROOM_ERROR**2)
        found[c] = np.exp(_location(np.log(x / L), weights, np.log(L), np.log(np.maximum(bounds, 1e-300))))
    return found


def _location(ratios: FloatArray, weights: FloatArray, light: FloatArray, bounds: FloatArray) -> float:
    """Where most of the ``ratios`` are; those whose ``light`` is then predicted outside ``bounds`` do not count.

    Pixels are chosen by both pictures: chosen by one, errors across the bounds would all count in one direction.
    """
    at = _weighted_median(ratios, weights)
    for _ in range(MATCH_STEPS):
        inside = (light + at > bounds[0]) & (light + at < bounds[1])
        if inside.sum() < MATCH_PIXELS:
            return at
        r, w = ratios[inside], weights[inside]
        spread = max(1.4826 * _weighted_median(np.abs(r - at), w), MIN_SPREAD)
        share = np.clip(1.0 - ((r - at) / (BIWEIGHT * spread)) ** 2, 0.0, None) ** 2 * w
        before, at = at, float((share * r).sum() / share.sum())
        if abs(at - before) < STANDS_STILL:
            break
    return at


def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
