"""Embedded color profiles of photos: display values in sRGB's primaries and curve.

Display P3, Adobe RGB and ProPhoto RGB are a matrix and a curve per channel, which are applied here to photos of any
depth without rounding. Other profiles are left to littleCMS, in 8 bits.

Format: ICC.1:2022, sections 9.2 (tags), 10.6 (curveType) and 10.18 (parametricCurveType).
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms

from ..base.errors import BadInput
from ..model.response import SATURATED, srgb

COLORANTS = ("red_colorant", "green_colorant", "blue_colorant")
CURVE_TAGS = (b"rTRC", b"gTRC", b"bTRC")
TABLES = (b"A2B0", b"A2B1", b"D2B0")
"""Tags of profiles that are more than a matrix and curves."""
MAX_TAGS = 256
PARAMETERS = (1, 3, 4, 5, 7)
"""Numbers of each kind of parametric curve."""
UNUSED = (1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""What the numbers are that a kind does not have: (a x + b)^g + e from d on, c x + f below."""
FINEST = 65535
"""Largest code of a photo."""
BLOCK_PIXELS = 65536
"""Pixels that are converted at a time, so that what is computed on the way stays small beside the photo."""
SRGB_WITHIN = 0.02
"""Difference of the matrix to sRGB from none that is rounding or another adaptation to white; Display P3's is 0.2."""
LARGEST_LINEAR = 16.0
"""Value of a curve beyond which it is damaged; those of displays end at 1."""
SMALLEST_VOLUME = 1e-6
"""Determinant of the primaries in XYZ below which they lie in one plane; that of sRGB's is 0.16."""
Curve = Callable[[NDArray[np.float64]], NDArray[np.float64]]


class ColorProfile:
    """A profile out of a photo; raises BadInput for one that cannot be used."""

    def __init__(self, content: bytes, path: Path) -> None:
        self._path = path
        try:
            self._profile = ImageCms.ImageCmsProfile(io.BytesIO(content))
        except (ImageCms.PyCMSError, OSError) as error:
            raise self._unusable(error) from error
        self._content = content
        self._matrix = _matrix_to_srgb(self._profile)

    def _unusable(self, error: Exception) -> BadInput:
        return BadInput(f"has a color profile that cannot be used ({error})", "save it as sRGB", self._path)

    @property
    def is_srgb(self) -> bool:
        """Whether nothing is to do: it is not of RGB, or has sRGB's primaries, and the curve is the camera's anyway."""
        other = self._profile.profile.xcolor_space.strip() != "RGB"
        return other or (self._matrix is not None and np.allclose(self._matrix, np.eye(3), atol=SRGB_WITHIN))

    def converted(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Display values in sRGB's primaries and curve; full channels stay full.

        Args:
            values: (H, W, 3) codes of 8 bits, or numbers from 0 to 1 of more.
        """
        coded = values.dtype == np.uint8
        curves = _curves(self._content)
        if self._matrix is None or curves is None:
            return self._by_little_cms(values if coded else np.round(255 * values).astype(np.uint8))
        codes = np.arange(256 if coded else FINEST + 1)
        tables = [curve(codes / codes[-1]).astype(np.float32) for curve in curves]
        matrix, converted = self._matrix.T.astype(np.float32), np.empty(values.shape, np.float32)
        rows = max(BLOCK_PIXELS // max(values.shape[1], 1), 1)
        for start in range(0, len(values), rows):
            block = values[start : start + rows]
            block = block if coded else np.rint(block * FINEST).astype(np.uint16)
            linear = np.stack([table[block[..., k]] for k, table in enumerate(tables)], axis=-1)
            found = srgb(linear @ matrix)
            found[found >= SATURATED] = 1  # a channel that was clipped comes back a little below
            converted[start : start + rows] = found
        return converted

    def _by_little_cms(self, codes: NDArray[np.uint8]) -> NDArray[np.float32]:
        image = Image.fromarray(codes)
        try:
            transform = ImageCms.buildTransform(
                self._profile, ImageCms.createProfile("sRGB"), "RGB", "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC
            )
            codes = np.array(ImageCms.applyTransform(image, transform))
        except ImageCms.PyCMSError as error:
            raise self._unusable(error) from error
        codes[codes == 254] = 255  # rounding takes clipped channels one code down on their way
        return codes.astype(np.float32) / np.float32(255)


def _matrix_to_srgb(profile: ImageCms.ImageCmsProfile) -> NDArray[np.float64] | None:
    """(3, 3) linear RGB of the profile to sRGB's; None where it has no primaries."""
    columns = []
    for one in (profile.profile, ImageCms.createProfile("sRGB")):
        found = [getattr(one, name, None) for name in COLORANTS]
        if any(colorant is None for colorant in found):
            return None
        columns.append(np.array([colorant[0] for colorant in found if colorant is not None]).T)
    primaries, of_srgb = columns
    if abs(np.linalg.det(primaries)) < SMALLEST_VOLUME:
        return None
    matrix = np.linalg.solve(of_srgb, primaries)
    return matrix / matrix.sum(1, keepdims=True)  # white stays white to the last bit


# ---- Curves ---------------------------------------------------------------------------------------------------------


def _curves(content: bytes) -> list[Curve] | None:
    """Display value to linear for each channel; None where the profile has more than curves, or damaged ones."""
    try:
        (count,) = struct.unpack_from(">I", content, 128)
        entries = [struct.unpack_from(">4sII", content, 132 + 12 * k) for k in range(min(count, MAX_TAGS))]
        tags = {name: content[start : start + size] for name, start, size in entries}
        if any(name in tags for name in TABLES):
            return None
        curves = [_curve(tags[name]) for name in CURVE_TAGS]
        with np.errstate(over="ignore"):
            sound = all((np.abs(curve(np.arange(256) / 255)) <= LARGEST_LINEAR).all() for curve in curves)
        return curves if sound else None
    except (struct.error, KeyError, ValueError):  # littleCMS says what is wrong with it, if anything
        return None


def _curve(tag: bytes) -> Curve:
    """The curve of a tag; raises ValueError, struct.error for one that is none."""
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return lambda x: x
        if count == 1:
            (gamma,) = struct.unpack_from(">H", tag, 12)
            if gamma == 0:
                raise ValueError("no exponent")
            return lambda x: x ** (gamma / 256)
        table = np.frombuffer(tag, ">u2", count, 12).astype(np.float64) / 65535
        return lambda x: np.interp(x, np.linspace(0, 1, count), table)
    if tag[:4] != b"para":
        raise ValueError("no curve")
    (kind,) = struct.unpack_from(">H", tag, 8)
    if kind >= len(PARAMETERS):
        raise ValueError("no known curve")
    values = tuple(value / 65536 for value in struct.unpack_from(f">{PARAMETERS[kind]}i", tag, 12))
    g, a, b, c, d, e, f = values + UNUSED[len(values) :]
    if g <= 0:
        raise ValueError("no exponent")
    if kind in (1, 2):  # below the zero of what is raised, a constant
        d, e, f, c = -b / a if a else 0.0, c, c, 0.0
    return lambda x: np.where(x >= d, np.maximum(a * x + b, 0) ** g + e, c * x + f)
