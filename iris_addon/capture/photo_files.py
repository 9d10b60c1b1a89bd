"""What a photo file holds: pixels in sRGB's primaries, which of them are picture, and how the camera was held.

The content decides, not the suffix: phones and messengers write WebP and HEIC under the name .jpg. Embedded profiles
(Display P3, Adobe RGB, ProPhoto RGB) are converted; without one sRGB is assumed. Pixels that are not fully
opaque are no picture. HEIC needs the package pillow-heif, camera raw files need rawpy; both are optional.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

from ..base.errors import BadInput
from ..base.image_headers import MAX_IMAGE_BYTES, check_pixels
from ..base.images import HDR_SUFFIXES, check_image, exr_size, read_exr
from ..base.untrusted import decoding, open_file
from .color_profiles import ColorProfile

# What Pillow logs goes to those who look at its log; an error about a file is one line.
logging.getLogger("PIL").addHandler(logging.NullHandler())

FORMATS = ("PNG", "JPEG", "MPO", "WEBP", "TIFF", "AVIF", "BMP", "HEIF")
"""Pillow's names. MPO is a JPEG with further pictures behind it, as phones with several lenses or gain maps write."""
RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw")
PHOTO_SUFFIXES = (
    ".png", ".jpg", ".jpeg", ".exr", ".webp", ".tif", ".tiff", ".avif", ".heic", ".heif", ".bmp", *RAW_SUFFIXES
)  # fmt: skip
OPAQUE = 0.999
"""Alpha of a pixel that is all picture."""
RAW_FULL = 65535 - 64
"""Code of a camera raw file from which a channel is full: where one is clipped on the sensor, LibRaw brings the others
down to the same white, rounded."""
MEND = "copy or export the file again"
_OTHER_BYTE = {
    f"{bands};16{order}": f"{bands};16{other}"
    for bands in ("RGB", "RGBA")
    for order, other in (("B", "L"), ("L", "B"), ("N", "B" if sys.byteorder == "little" else "L"))
}
"""Pillow's names of 16-bit channels, and those under which it keeps the lower byte."""
UPRIGHT = 1
"""EXIF's orientation of a photo whose stored rows are its rows."""
SIDEWAYS = (5, 6, 7, 8)
"""EXIF's orientations that exchange width and height."""
_TURNS = {2: (0, True), 3: (2, False), 4: (2, True), 5: (3, True), 6: (3, False), 7: (1, True), 8: (1, False)}
"""Quarter turns to the left, and whether the columns are then reversed, that show a photo of each EXIF orientation."""
_UP = {3: (0.0, -1.0), 4: (0.0, -1.0), 5: (-1.0, 0.0), 6: (-1.0, 0.0), 7: (1.0, 0.0), 8: (1.0, 0.0)}
"""Where the top of the shown photo lies in the stored one: right and up."""


@dataclass(frozen=True)
class PhotoPixels:
    """The pixels of a file.

    Attributes:
        values: (H, W, 3) float32 as :class:`iris_addon.model.capture.Photo` has them.
        valid: (H, W) whether a pixel is picture.
        hdr: whether ``values`` are linear radiance.
    """

    values: NDArray[np.float32]
    valid: NDArray[np.bool_]
    hdr: bool

    def turned(self, orientation: int) -> PhotoPixels:
        """As EXIF's ``orientation`` shows them."""
        if orientation == UPRIGHT:
            return self
        return PhotoPixels(show(self.values, orientation), show(self.valid, orientation), self.hdr)


def show(pixels: NDArray, orientation: int) -> NDArray:
    """Stored ``pixels`` (H, W, ...) as EXIF's ``orientation`` shows them."""
    turns, mirrored = _TURNS[orientation]
    turned = np.rot90(pixels, turns)
    return np.ascontiguousarray(turned[:, ::-1] if mirrored else turned)


def read_photo(path: Path, shrink: int = 1) -> PhotoPixels:
    """The pixels of a photo as stored, whatever its EXIF orientation.

    ``shrink`` (1, 2, 4 or 8) lets a JPEG decoder leave out high frequencies: each value is then about the mean over a
    block of so many rows and columns, the last of which may be cut. Other files are read as they are.

    Values of 8 bits are codes / 255. More bits are given in the same convention, half a step of 8 bits below the value,
    because the response takes them to be floors.

    Raises:
        BadInput: missing, damaged, too large, or of a format that is not read or whose package is missing.
    """
    if path.suffix.lower() in HDR_SUFFIXES:
        return _read_radiance(path)
    if path.suffix.lower() in RAW_SUFFIXES:
        return _read_raw(path)
    with open_photo(path) as image:
        if shrink > 1:
            image.draft("RGB", (image.width // shrink, image.height // shrink))
        if fine := _sixteen_bits(image, path):
            values, alpha = fine
            return PhotoPixels(_floored(_in_srgb(values, image, path)), _opaque(alpha, values.shape[:2]), hdr=False)
        if image.mode.startswith("F"):
            raise BadInput("has floating-point pixels", "save it as EXR", path)
        has_alpha = "A" in image.getbands() or "transparency" in image.info
        rgba = image.convert("RGBA") if has_alpha else None
        opaque = None if rgba is None else np.asarray(rgba.getchannel("A"), np.float32) / 255
        codes = np.asarray((image if rgba is None else rgba).convert("RGB"))
        values = _in_srgb(codes, image, path)
        return PhotoPixels(values, _opaque(opaque, codes.shape[:2]), hdr=False)


@contextmanager
def open_photo(path: Path) -> Iterator[Image.Image]:
    """The photo as Pillow has it, its size checked; what fails inside is an error of the file.

    Raises:
        BadInput: missing, damaged, too large, or of a format that is not read here.
    """
    _prepare(path)
    with (
        open_file(path, MAX_IMAGE_BYTES, mend=MEND) as file,
        decoding(path, "is damaged or not an image", MEND),
        Image.open(file, formats=_known()) as image,
    ):
        check_pixels(path, image.width, image.height)
        yield image


def photo_size(path: Path) -> tuple[int, int]:
    """(width, height) as stored, by the header; raises BadInput."""
    if path.suffix.lower() in HDR_SUFFIXES:
        return exr_size(path)
    if path.suffix.lower() in RAW_SUFFIXES:
        return check_photo(path)
    with open_photo(path) as image:
        return image.size


def turned_size(size: tuple[int, int], orientation: int) -> tuple[int, int]:
    """(width, height) as EXIF's ``orientation`` shows a photo of ``size``."""
    return (size[1], size[0]) if orientation in SIDEWAYS else size


def check_photo(path: Path) -> tuple[int, int]:
    """(width, height) as stored, after a cheap check for damage; raises BadInput."""
    if path.suffix.lower() in HDR_SUFFIXES:
        return exr_size(path)
    if path.suffix.lower() in RAW_SUFFIXES:
        with _raw(path) as raw:
            sizes = raw.sizes
            return sizes.width, sizes.height
    with open_photo(path) as image:
        if image.format in ("PNG", "JPEG"):
            return check_image(path)
        image.load()
        return image.size


# ---- EXIF -----------------------------------------------------------------------------------------------------------


def read_exif(path: Path) -> Image.Exif | None:
    """The EXIF block of a photo, None where it has none that can be read; pixels are checked elsewhere."""
    try:
        with open_photo(path) as image:
            return image.getexif()
    except BadInput:  # a damaged block counts as none
        return None


def read_orientation(path: Path) -> int:
    """EXIF's orientation of a photo, 1 to 8; 1 where it has none."""
    exif = None if path.suffix.lower() in HDR_SUFFIXES else read_exif(path)
    value = None if exif is None else exif.get(ExifTags.Base.Orientation)
    return int(value) if value in _TURNS else UPRIGHT


def shown_up(orientation: int) -> tuple[float, float, float]:
    """Up in the camera's frame (x right, y up) of a stored photo that EXIF's ``orientation`` shows upright."""
    return (*_UP.get(orientation, (0.0, 1.0)), 0.0)


def read_device(path: Path) -> str:
    """Maker and model of the camera by EXIF, "" where it is not recorded."""
    exif = None if path.suffix.lower() in HDR_SUFFIXES else read_exif(path)
    if exif is None:
        return ""
    names = [str(exif.get(tag, "")).strip("\0 ") for tag in (ExifTags.Base.Make, ExifTags.Base.Model)]
    return " ".join(name for name in names if name)


# ---- Display values -------------------------------------------------------------------------------------------------


def _in_srgb(values: NDArray, image: Image.Image, path: Path) -> NDArray:
    """``values`` (H, W, 3) of ``image``, codes of 8 bits or numbers from 0 to 1, as numbers in sRGB's primaries."""
    content = image.info.get("icc_profile")
    profile = ColorProfile(content, path) if content else None
    if profile is not None and not profile.is_srgb:
        return profile.converted(values)
    return values.astype(np.float32) / np.float32(255) if values.dtype == np.uint8 else values


def _opaque(alpha: NDArray[np.float32] | None, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(H, W) pixels that are all picture; an alpha that is nowhere opaque means nothing."""
    if alpha is None or not (alpha >= OPAQUE).any():
        return np.ones(shape, bool)
    return alpha >= OPAQUE


def _floored(values: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.where(values >= 1, 1, np.maximum(values - 0.5 / 255, 0)).astype(np.float32)


def _sixteen_bits(image: Image.Image, path: Path) -> tuple[NDArray[np.float64], NDArray[np.float32] | None] | None:
    """(H, W, 3) values and (H, W) alpha of a file of 16 bits per channel; None for others.

    Pillow keeps one byte per colour channel. Which one follows from the byte order it is told, so that decoding twice
    gives both.
    """
    if image.mode.startswith("I"):
        grey = np.asarray(image).astype(np.float64) / 65535
        return np.repeat(np.clip(grey, 0, 1)[..., None], 3, axis=-1), None
    known = [mode for tile in image.tile for mode in _raw_modes(tile) if mode in _OTHER_BYTE]
    if not known:
        return None
    with open_photo(path) as again:
        again.tile = [tile._replace(args=_with_mode(tile.args, known[0], _OTHER_BYTE[known[0]])) for tile in again.tile]
        low = np.asarray(again).astype(np.uint16)
    values = ((np.asarray(image).astype(np.uint16) << 8) | low) / 65535.0
    return values[..., :3], values[..., 3].astype(np.float32) if values.shape[-1] == 4 else None


def _raw_modes(tile: Any) -> tuple[Any, ...]:
    args = tile.args
    return args if isinstance(args, tuple) else (args,)


def _with_mode(args: object, old: str, new: str) -> object:
    return tuple(new if a == old else a for a in args) if isinstance(args, tuple) else new


# ---- Radiance and camera raw ----------------------------------------------------------------------------------------


def _read_radiance(path: Path) -> PhotoPixels:
    pixels = read_exr(path)
    if pixels.shape[2] < 3:
        raise BadInput("has one channel", "save the photo as RGB", path)
    valid = np.isfinite(pixels[..., :3]).all(-1)
    if pixels.shape[2] == 4:
        valid &= _opaque(pixels[..., 3], valid.shape)
    values = np.maximum(np.where(valid[..., None], pixels[..., :3], 0), 0).astype(np.float32)
    return PhotoPixels(values, valid, hdr=True)


def _read_raw(path: Path) -> PhotoPixels:
    """Linear sRGB of a camera raw file with the white balance as shot, 1 where the sensor is full."""
    with _raw(path) as raw:
        linear = raw.postprocess(
            use_camera_wb=True,
            gamma=(1, 1),
            no_auto_bright=True,
            output_bps=16,  # in sRGB's primaries, which are the default
            user_flip=0,
        )
    values = np.where(linear >= RAW_FULL, 1.0, linear / 65535.0)
    return PhotoPixels(_floored(values), np.ones(linear.shape[:2], bool), hdr=False)


@contextmanager
def _raw(path: Path) -> Iterator:
    try:
        import rawpy
    except ImportError as error:
        raise BadInput("is a camera raw file", "install the package rawpy, or convert it to TIFF", path) from error
    with (
        open_file(path, MAX_IMAGE_BYTES, mend=MEND) as file,
        decoding(path, "is damaged or not a raw file", MEND),
        rawpy.imread(file) as raw,
    ):
        check_pixels(path, raw.sizes.raw_width, raw.sizes.raw_height)
        yield raw


def _known() -> tuple[str, ...]:
    """Those of :data:`FORMATS` that this Pillow has."""
    return tuple(name for name in FORMATS if name in Image.OPEN)


def _prepare(path: Path) -> None:
    """Let Pillow read all formats, HEIC if ``path`` is one; raises BadInput where its package is missing."""
    Image.init()
    with open_file(path, MAX_IMAGE_BYTES, mend=MEND) as file:
        head = file.read(12)
    if head[4:8] != b"ftyp" or head[8:12] in (b"avif", b"avis"):
        return
    try:
        import pillow_heif
    except ImportError as error:
        raise BadInput(
            "is a HEIC photo", "install the package pillow-heif, or let the phone save JPEG (most compatible)", path
        ) from error
    pillow_heif.register_heif_opener()
