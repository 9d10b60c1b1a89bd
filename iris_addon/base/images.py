"""Image files: EXR, PNG and JPEG, with size limits checked before anything is allocated.

Row 0 of every array is the top of the image. EXR carries linear values unchanged; PNG and JPEG carry display values,
no colour management is applied on either side. Files are written by
:func:`~iris_addon.base.files.atomic_write`.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image

from .color_spaces import REC709, ColorSpace
from .errors import BadInput
from .files import atomic_write
from .image_headers import MAX_IMAGE_BYTES, MAX_PIXELS, MEND, check_exr_samples, check_pixels, read_exr_parts
from .untrusted import decoding, open_file

HALF_MAX = 65504.0
"""Largest finite float16."""
DWA_LEVEL = 120.0
"""Compression level of lossy EXR; OpenEXR's default is 45."""

HDR_SUFFIXES = (".exr",)

MAX_LAYERS = 256
"""Samples of all parts and channels of an EXR file for each pixel of its picture."""
_DAMAGED = "is damaged or not an image"
if Image.MAX_IMAGE_PIXELS is not None:  # Pillow refuses twice its own, a little less than the largest textures have
    Image.MAX_IMAGE_PIXELS = max(Image.MAX_IMAGE_PIXELS, MAX_PIXELS)


# ---- Writing --------------------------------------------------------------------------------------------------------


def write_exr(
    path: Path,
    values: NDArray[np.floating],
    *,
    half: bool = False,
    lossy: bool = False,
    space: ColorSpace | None = None,
) -> None:
    """Write (H, W, 3) RGB or (H, W) single-channel "Y" linear values as float32, or float16 with ``half``.

    ``lossy`` compresses by DWAB to a fifth of the space; albedo and display values keep about 50 dB. Linear Rec.709 is
    converted to ``space`` where given, whose chromaticities the header then has; without any, EXR means Rec.709.
    """
    if values.ndim not in (2, 3) or (values.ndim == 3 and values.shape[2] != 3):
        raise ValueError(f"EXR values have shape {values.shape}, expected (H, W, 3) or (H, W)")
    if space is not None and values.ndim == 3:
        values = values @ REC709.matrix_to(space).T
    pixels = np.ascontiguousarray(np.clip(values, -HALF_MAX, HALF_MAX) if half else values)
    pixels = pixels.astype(np.float16 if half else np.float32)
    _save_exr(path, {"Y" if pixels.ndim == 2 else "RGB": pixels}, space, lossy=lossy)


def _save_exr(path: Path, channels: Mapping[str, NDArray], space: ColorSpace | None, *, lossy: bool = False) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if space is not None:
        header["chromaticities"] = space.chromaticities
    if lossy:
        header |= {"compression": OpenEXR.DWAB_COMPRESSION, "dwaCompressionLevel": DWA_LEVEL}
    # Through memory, because OpenEXR reports a failed write to disk without its errno.
    encoded = io.BytesIO()
    OpenEXR.File(header, dict(channels)).write(encoded)
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
    number, names = _chosen_part(path)
    with decoding(path, _DAMAGED, MEND):
        parts = OpenEXR.File(str(path), separate_channels=True).parts
        if number >= len(parts) or not all(part.channels for part in parts):
            raise EOFError("truncated pixel data")  # the bindings drop what they fail to decode
        return np.stack([parts[number].channels[name].pixels for name in names], -1).astype(np.float32)


def exr_size(path: Path) -> tuple[int, int]:
    """(width, height), from the headers of an EXR file, of what :func:`read_exr` reads; raises BadInput."""
    part = read_exr_parts(path)[_chosen_part(path)[0]]
    return part.width, part.height


def _chosen_part(path: Path) -> tuple[int, list[str]]:
    """Number and channels of the part to read. All are decoded together, so the sizes of all are checked."""
    parts = read_exr_parts(path)
    check_exr_samples(path, parts)
    candidates = [_colour_channels(part.channels) for part in parts]
    number = candidates.index(max(candidates, key=len))
    if not candidates[number]:
        names = sorted(name for part in parts for name in part.channels)
        raise BadInput(f"has channels {', '.join(names[:8])} and no RGB", "save it as an RGB EXR", path)
    if parts[number].subsampled:
        raise BadInput("has subsampled channels", "save it as an RGB EXR", path)
    others = sum(part.width * part.height * len(part.channels) for part in parts)
    if others > MAX_LAYERS * parts[number].width * parts[number].height:
        raise BadInput("has far larger parts beside its picture", "save it as an RGB EXR", path)
    return number, candidates[number]


def _colour_channels(names: Sequence[str]) -> list[str]:
    """The R, G, B(, A) channels of a part, in any layer; else its only channel; else nothing."""
    by_suffix: dict[str, str] = {}
    for name in names:
        by_suffix.setdefault(name.rpartition(".")[2].upper(), name)
    if all(key in by_suffix for key in "RGB"):
        return [by_suffix[key] for key in "RGBA" if key in by_suffix]
    return list(names) if len(names) == 1 else []


def read_image(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 display values of an 8-bit PNG or JPEG; grey is repeated, alpha dropped.

    The orientation tag of EXIF is not applied: camera poses and intrinsics are about the pixels as stored.

    Raises:
        BadInput: missing, damaged, truncated, too large, or more than 8 bits per channel.
    """
    with open_image(path) as image:
        if image.mode.startswith(("I", "F")) or _is_cut_to_8_bits(image):
            raise BadInput("has more than 8 bits per channel", "save it as 8-bit PNG or as linear EXR", path)
        return np.asarray(image.convert("RGB"))


def _is_cut_to_8_bits(image: Image.Image) -> bool:
    """Whether Pillow would drop the lower byte of each channel: it knows 16-bit colour only in the file."""
    return any("16" in str(tile[3]) for tile in image.tile)


def read_map(path: Path) -> NDArray[np.unsignedinteger]:
    """(H, W) uint8 or uint16 of a single-channel PNG, with the depth it was written with; raises BadInput."""
    with open_image(path) as image:
        if image.mode not in ("L", "I;16"):
            raise BadInput(f"is not a single-channel PNG (mode {image.mode})", "save it as greyscale", path)
        return np.asarray(image)


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) of an image file by its header; raises BadInput."""
    if path.suffix.lower() in HDR_SUFFIXES:
        return exr_size(path)
    with open_image(path) as image:
        return image.size


def check_image(path: Path) -> tuple[int, int]:
    """(width, height) of an image file after a cheap check for damage; raises BadInput.

    PNG chunks are verified by their checksums; a JPEG without an end marker is decoded.
    """
    if path.suffix.lower() in HDR_SUFFIXES:
        return exr_size(path)
    with open_image(path) as image:
        size = image.size
        if image.format != "JPEG":
            image.verify()
        elif not _ends_with_marker(path):
            image.load()
    return size


def _ends_with_marker(path: Path) -> bool:
    with open_file(path, MAX_IMAGE_BYTES, mend=MEND) as file:
        file.seek(-2, os.SEEK_END)
        return file.read(2) == b"\xff\xd9"


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """A PNG or JPEG whose size has been checked; what fails inside is an error of this file.

    Raises:
        BadInput: missing, damaged or too large.
    """
    with (
        open_file(path, MAX_IMAGE_BYTES, mend=MEND) as file,
        decoding(path, _DAMAGED, MEND),
        Image.open(file, formats=("PNG", "JPEG")) as image,
    ):
        check_pixels(path, *image.size)
        yield image
