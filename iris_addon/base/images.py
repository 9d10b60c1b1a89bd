"""Image files: EXR, PNG and JPEG, with size limits checked before anything is allocated.

Row 0 of every array is the top of the image. EXR carries linear values unchanged; PNG and JPEG carry display values,
no colour management is applied on either side. Files are written by
:func:`~iris_addon.base.files.atomic_write`.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image

from .errors import BadInput
from .files import atomic_write

MAX_PIXELS = 200_000_000
HALF_MAX = 65504.0
"""Largest finite float16."""
DWA_LEVEL = 120.0
"""Compression level of lossy EXR; OpenEXR's default is 45."""

LDR_SUFFIXES = (".png", ".jpg", ".jpeg")
HDR_SUFFIXES = (".exr",)
IMAGE_SUFFIXES = LDR_SUFFIXES + HDR_SUFFIXES

# What Pillow's decoders raise on damaged files. UnidentifiedImageError is an OSError.
_DECODE_ERRORS = (OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error, Image.DecompressionBombError)


# ---- Writing --------------------------------------------------------------------------------------------------------


def write_exr(path: Path, values: NDArray[np.floating], *, half: bool = False, lossy: bool = False) -> None:
    """Write (H, W, 3) RGB or (H, W) single-channel "Y" linear values as float32, or float16 with ``half``.

    ``lossy`` compresses by DWAB to a fifth of the space; albedo and display values keep about 50 dB.
    """
    if values.ndim not in (2, 3) or (values.ndim == 3 and values.shape[2] != 3):
        raise ValueError(f"EXR values have shape {values.shape}, expected (H, W, 3) or (H, W)")
    pixels = np.ascontiguousarray(np.clip(values, -HALF_MAX, HALF_MAX) if half else values)
    pixels = pixels.astype(np.float16 if half else np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if lossy:
        header |= {"compression": OpenEXR.DWAB_COMPRESSION, "dwaCompressionLevel": DWA_LEVEL}
    # Through memory, because OpenEXR reports a failed write to disk without its errno.
    encoded = io.BytesIO()
    OpenEXR.File(header, {"Y" if pixels.ndim == 2 else "RGB": pixels}).write(encoded)
    atomic_write(path, lambda temporary: temporary.write_bytes(encoded.getbuffer()))


def to_codes(image: NDArray[np.floating]) -> NDArray[np.uint8]:
    """The nearest 8-bit codes of display values of any shape; NaN is black."""
    return np.round(np.clip(np.nan_to_num(image), 0.0, 1.0) * 255).astype(np.uint8)


def write_png(path: Path, values: NDArray[np.unsignedinteger]) -> None:
    """Write uint8 (H, W, 3) or (H, W), or uint16 (H, W), as PNG.

    16 bits are compressed at level 1: a third of the time, files a tenth larger.
    """
    if values.dtype not in (np.uint8, np.uint16) or values.ndim not in (2, 3):
        raise ValueError(f"PNG values are {values.dtype} {values.shape}, expected uint8 (H, W[, 3]) or uint16 (H, W)")
    image, level = Image.fromarray(np.ascontiguousarray(values)), 1 if values.dtype == np.uint16 else 6
    atomic_write(path, lambda temporary: image.save(temporary, format="PNG", compress_level=level))


# ---- Reading --------------------------------------------------------------------------------------------------------


def read_exr(path: Path) -> NDArray[np.float32]:
    """(H, W, C) float32 of an EXR file: RGB(A) where it has colour, otherwise its one channel (Y, V, Z ...).

    Of a multi-part file, as Blender writes them, the first part with colour is read, otherwise the first part.

    Raises:
        BadInput: missing, damaged, too large, or neither colour nor a single channel.
    """
    exr_size(path)
    try:
        parts = OpenEXR.File(str(path), separate_channels=True).parts
    except (RuntimeError, ValueError, OSError) as error:
        raise _damaged(path, error) from error
    if not parts or not all(part.channels for part in parts):  # the bindings drop what they fail to decode
        raise _damaged(path, EOFError("truncated pixel data"))
    candidates = [_select_channels(part.channels) for part in parts]
    found = max(candidates, key=len, default=[])
    if not found:
        names = sorted(name for part in parts for name in part.channels)
        raise BadInput(f"has channels {', '.join(names[:8])} and no RGB", "save it as an RGB EXR", path)
    if len({channel.shape for channel in found}) != 1:
        raise BadInput("has subsampled channels", "save it as an RGB EXR", path)
    return np.stack(found, -1).astype(np.float32)


def _select_channels(channels: dict) -> list[NDArray]:
    """The R, G, B(, A) channels of a part, in any layer; else its only channel; else nothing."""
    by_suffix: dict[str, NDArray] = {}
    for name, channel in channels.items():
        by_suffix.setdefault(name.rpartition(".")[2].upper(), channel.pixels)
    if all(key in by_suffix for key in "RGB"):
        return [by_suffix[key] for key in "RGBA" if key in by_suffix]
    return [channel.pixels for channel in channels.values()] if len(channels) == 1 else []


def exr_size(path: Path) -> tuple[int, int]:
    """(width, height) from the header of an EXR file; raises BadInput."""
    _check_exists(path)
    try:
        header = OpenEXR.File(str(path), header_only=True).parts[0].header
        low, high = header["dataWindow"]
    except (RuntimeError, ValueError, OSError, KeyError, IndexError) as error:
        raise _damaged(path, error) from error
    width, height = (int(high[axis]) - int(low[axis]) + 1 for axis in (0, 1))
    _check_size(path, width, height)
    return width, height


def read_image(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 display values of an 8-bit PNG or JPEG; grey is repeated, alpha dropped.

    The orientation tag of EXIF is not applied: camera poses and intrinsics are about the pixels as stored.

    Raises:
        BadInput: missing, damaged, truncated, too large, or more than 8 bits per channel.
    """
    with _open(path) as image:
        if image.mode.startswith(("I", "F")) or _is_cut_to_8_bits(image):
            raise BadInput("has more than 8 bits per channel", "save it as 8-bit PNG or as linear EXR", path)
        try:
            return np.asarray(image.convert("RGB"))
        except _DECODE_ERRORS as error:
            raise _damaged(path, error) from error


def _is_cut_to_8_bits(image: Image.Image) -> bool:
    """Whether Pillow would drop the lower byte of each channel: it knows 16-bit colour only in the file."""
    return any("16" in str(tile[3]) for tile in image.tile)


def read_map(path: Path) -> NDArray[np.unsignedinteger]:
    """(H, W) uint8 or uint16 of a single-channel PNG, with the depth it was written with; raises BadInput."""
    with _open(path) as image:
        if image.mode not in ("L", "I;16"):
            raise BadInput(f"is not a single-channel PNG (mode {image.mode})", "save it as greyscale", path)
        try:
            return np.asarray(image)
        except _DECODE_ERRORS as error:
            raise _damaged(path, error) from error


def check_image(path: Path) -> tuple[int, int]:
    """(width, height) of an image file after a cheap check for damage; raises BadInput.

    PNG chunks are verified by their checksums; a JPEG without an end marker is decoded.
    """
    if path.suffix.lower() in HDR_SUFFIXES:
        return exr_size(path)
    with _open(path) as image:
        size, is_jpeg = image.size, image.format == "JPEG"
        try:
            if not is_jpeg:
                image.verify()
            elif not _ends_with_marker(path):
                image.load()
        except _DECODE_ERRORS as error:
            raise _damaged(path, error) from error
    return size


def _ends_with_marker(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-2, os.SEEK_END)
        return file.read(2) == b"\xff\xd9"


def _open(path: Path) -> Image.Image:
    _check_exists(path)
    try:
        image = Image.open(path, formats=("PNG", "JPEG"))
    except _DECODE_ERRORS as error:
        raise _damaged(path, error) from error
    _check_size(path, *image.size)
    return image


def _check_exists(path: Path) -> None:
    if not path.is_file():
        raise BadInput("no such image", "put the file there or correct the path that names it", path)


def _check_size(path: Path, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise BadInput(
            f"is {width}x{height} pixels, more than {MAX_PIXELS // 1_000_000} million", "scale the image down", path
        )


def _damaged(path: Path, error: Exception) -> BadInput:
    return BadInput(f"is damaged or not an image ({_first_line(error)})", "copy or export the file again", path)


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:120]
