"""From radiance to photos: exposure levels, the response curve, quantisation to 8 bits. Does not use bpy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...base.errors import BadInput
from ...base.untrusted import read_curves
from ...model.response import LUMINANCE, N_SAMPLES, Response, gamma, identity

FloatArray = NDArray[np.floating]

MAX_RESPONSE_BYTES = 16 << 20

GREY = 0.14
"""Radiance × exposure of the median pixel of the median view."""
FILM_CONTRAST, FILM_SHOULDER = 1.05, 2.4


def film() -> Response:
    """A film-like S-curve of our own, z = 1 − (1 − x^1.05)^2.4.

    It has a short toe (slope 0 at the origin), is steep in the shadows and rolls off into a soft shoulder; middle grey
    0.18 maps to 0.35. No power of x is close to it.
    """
    x = np.linspace(0, 1, N_SAMPLES)
    z = 1 - (1 - x**FILM_CONTRAST) ** FILM_SHOULDER
    return Response(np.tile(z, (3, 1)), "film", (FILM_CONTRAST, FILM_SHOULDER))


BUILT_IN = {"film": film, "gamma": gamma, "linear": identity}


def read_response(response: str | Path) -> Response:
    """A built-in curve by name ('film', 'gamma', 'linear') or a file: .npy of (1024,) or (3, 1024), or response.json.

    Raises:
        BadInput: no such curve, or a file that is not a monotone curve from 0 to 1.
    """
    if str(response) in BUILT_IN:
        return BUILT_IN[str(response)]()
    path = Path(response)
    mend = f"give one of {', '.join(BUILT_IN)}, or a file of {N_SAMPLES} or 3x{N_SAMPLES} samples over [0, 1]"
    curves = read_curves(path, MAX_RESPONSE_BYTES, mend)
    if curves.shape not in ((1, N_SAMPLES), (3, N_SAMPLES)):
        raise BadInput(f"is not a response (its shape is {curves.shape})", mend, path)
    samples = np.broadcast_to(curves, (3, N_SAMPLES)).copy()
    if (np.diff(samples) < 0).any() or np.abs(samples[:, [0, -1]] - [0, 1]).max() > 1e-3:
        raise BadInput("is not a monotone curve from 0 to 1", "normalize it first", path)
    return Response(samples, "file")


def brightness(radiance: FloatArray, emission: FloatArray) -> float:
    """Median luminance of the pixels of (H, W, 3) ``radiance`` that do not show a lamp."""
    lit = (emission > 0).any(-1)
    luminance = radiance @ LUMINANCE
    return float(np.median(luminance if lit.all() else luminance[~lit]))


def exposures(
    train: Sequence[float], val: Sequence[float], levels: Sequence[float]
) -> tuple[FloatArray, FloatArray, float]:
    """Exposure per training and per validation view, and the global scale they share.

    The training views are divided into as many equal groups as there are ``levels`` (ascending): the brightest group
    gets the lowest level. A validation view gets the level of the training views of its brightness. The scale maps the
    median pixel of the median training view to :data:`GREY`.

    Args:
        train, val: brightness per view.
    """
    ascending = np.sort(np.asarray(train, dtype=float))
    descending_levels = np.sort(np.asarray(levels, dtype=float))[::-1]
    scale = GREY / max(float(np.median(ascending)), 1e-12)

    def level(brightnesses: Sequence[float]) -> FloatArray:
        rank = np.searchsorted(ascending, brightnesses, side="left")
        group = np.minimum(rank * len(levels) // len(ascending), len(levels) - 1)
        return descending_levels[group]

    return level(train) * scale, level(val) * scale, scale


def develop(radiance: FloatArray, exposure: float, response: Response) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 = floor(255 · f(clip(radiance · exposure, 0, 1)))."""
    return np.floor(255 * response.apply(np.clip(radiance * exposure, 0, 1))).astype(np.uint8)
