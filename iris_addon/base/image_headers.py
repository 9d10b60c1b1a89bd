"""What an image file announces: its size, and the parts and channels of an EXR, read without decoding a pixel.

Libraries decode a file, and every part of it, at once, so its sizes must be known before one of them sees it. Needs no
package, since Blender's Python has neither OpenEXR nor Pillow. Formats: EXR,
https://openexr.com/en/latest/OpenEXRFileLayout.html; PNG, https://www.w3.org/TR/png-3; JPEG, ITU-T T.81; Radiance HDR,
https://www.graphics.cornell.edu/~bjw/rgbe.html
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

from .errors import BadInput
from .untrusted import decoding, open_file

MAX_IMAGE_BYTES = 4 << 30
"""Bytes of any image file."""
MAX_PIXELS = 16384 * 16384
"""Those of the largest textures."""
MAX_EXR_SAMPLES = 4 * MAX_PIXELS
"""Over all parts and channels of an EXR file."""
MAX_PARTS, MAX_CHANNELS, MAX_ATTRIBUTES, MAX_NAME = 1024, 1024, 4096, 255
MAX_LIST_BYTES = 1 << 20
"""Bytes of a list of channels."""
MAGIC = b"v/1\x01"
MULTIPART = 0x1000
"""Flag of the version field: several headers, with an empty one at their end."""
MEND = "copy or export the file again"


class ExrPart(NamedTuple):
    """One part: its name (empty if it is the only one), its size in pixels, its channels, and whether one of them has
    fewer samples than pixels."""

    name: str
    width: int
    height: int
    channels: tuple[str, ...]
    subsampled: bool


def read_exr_parts(path: Path) -> list[ExrPart]:
    """The parts of an EXR file, at least one, as its headers announce them.

    Raises:
        BadInput: missing, no EXR file, damaged within the headers, or of more parts than any program writes.
    """
    with open_file(path, MAX_IMAGE_BYTES, mend=MEND) as file, decoding(path, "is damaged or not an image", MEND):
        return exr_headers(file, path)[0]


def exr_headers(file: BinaryIO, path: Path) -> tuple[list[ExrPart], bool]:
    """The parts that ``file`` announces, and whether it is of several parts; it then stands behind the headers.

    Raises:
        BadInput: it has too many parts.
        ValueError, struct.error, KeyError: it is damaged within the headers.
    """
    magic, version = struct.unpack("<4sI", file.read(8))
    if magic != MAGIC:
        raise ValueError("no OpenEXR file")
    multipart, parts = bool(version & MULTIPART), []
    while (part := _part(file)) is not None:
        parts.append(part)
        if len(parts) > MAX_PARTS:
            raise BadInput(f"has more than {MAX_PARTS} parts", MEND, path)
        if not multipart:
            break
    if not parts:
        raise ValueError("no header")
    return parts, multipart


def check_exr_samples(path: Path, parts: Sequence[ExrPart]) -> None:
    """Raise BadInput unless all ``parts`` of ``path`` may be decoded together."""
    for part in parts:
        check_pixels(path, part.width, part.height)
    if sum(part.width * part.height * len(part.channels) for part in parts) > MAX_EXR_SAMPLES:
        raise BadInput(f"has more than {MAX_EXR_SAMPLES // 1_000_000} million samples in its parts", MEND, path)


def check_pixels(path: Path, width: int, height: int) -> None:
    """Raise BadInput for an image without pixels, or with more than MAX_PIXELS."""
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        what = f"is {width}x{height} pixels, more than {MAX_PIXELS // 1_000_000} million"
        raise BadInput(what if width * height > 0 else "has no pixels", "scale the image down", path)


def announced_size(path: Path) -> tuple[int, int]:
    """(width, height) of an EXR, PNG, JPEG or Radiance HDR, of the first part, by its header.

    Raises:
        BadInput: missing, of another format, damaged within the header, or too large to be decoded.
    """
    with open_file(path, MAX_IMAGE_BYTES, mend=MEND) as file, decoding(path, "is damaged or not an image", MEND):
        head = file.read(16)
        if head[:4] == MAGIC:
            parts = read_exr_parts(path)
            check_exr_samples(path, parts)
            return parts[0].width, parts[0].height
        if head[:8] == b"\x89PNG\r\n\x1a\n":
            size = struct.unpack(">II", file.read(8))
        elif head[:2] == b"\xff\xd8":
            file.seek(2)
            size = _jpeg_size(file)
        elif head[:2] == b"#?":
            size = _radiance_size(head + file.read(MAX_LIST_BYTES))
        else:
            raise ValueError("no EXR, PNG, JPEG or HDR file")
    width, height = size
    check_pixels(path, width, height)
    return width, height


def _jpeg_size(file: BinaryIO) -> tuple[int, int]:
    """(width, height) from the frame header; ``file`` stands behind the first marker."""
    while True:
        marker, kind = struct.unpack(">BB", file.read(2))
        while kind == 0xFF:  # fill bytes
            (kind,) = file.read(1)
        if marker != 0xFF:
            raise ValueError("a marker is missing")
        (length,) = struct.unpack(">H", file.read(2))
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            _, height, width = struct.unpack(">BHH", file.read(5))
            return width, height
        file.seek(max(length - 2, 0), 1)


def _radiance_size(head: bytes) -> tuple[int, int]:
    """(width, height) from the line behind the empty one."""
    found = re.search(rb"\n\n[-+]([XY]) (\d{1,9}) [-+]([XY]) (\d{1,9})\n", head)
    if found is None or found[1] == found[3]:
        raise ValueError("no size in its header")
    sizes = {found[1]: int(found[2]), found[3]: int(found[4])}
    return sizes[b"X"], sizes[b"Y"]


def _part(file: BinaryIO) -> ExrPart | None:
    """The next header; None for the empty one that ends them."""
    found: dict[str, bytes] = {}
    for _ in range(MAX_ATTRIBUTES):
        name = _text(file)
        if not name:
            break
        kind, (size,) = _text(file), struct.unpack("<i", file.read(4))
        if size < 0:
            raise ValueError(f"attribute {name!r} of {size} bytes")
        if (name, kind) in (("dataWindow", "box2i"), ("channels", "chlist"), ("name", "string")):
            value = file.read(min(size, MAX_LIST_BYTES + 1))
            if len(value) != size:
                raise ValueError(f"attribute {name!r} is cut off or too large")
            found[name] = value
        else:
            file.seek(size, 1)
    else:
        raise ValueError("a header without an end")
    if not found:
        return None
    x0, y0, x1, y1 = struct.unpack("<4i", found["dataWindow"])
    if x1 < x0 or y1 < y0:
        raise ValueError("its data window is empty")
    channels, subsampled = _channels(found["channels"])
    label = found.get("name", b"").decode("utf-8", "replace")
    return ExrPart(label, x1 - x0 + 1, y1 - y0 + 1, channels, subsampled)


def _channels(data: bytes) -> tuple[tuple[str, ...], bool]:
    names, subsampled, at = [], False, 0
    while data[at] != 0:
        end = data.index(b"\0", at)
        names.append(data[at:end].decode("utf-8", "replace"))
        x_step, y_step = struct.unpack_from("<2i", data, end + 9)
        subsampled |= (x_step, y_step) != (1, 1)
        at = end + 17
        if len(names) > MAX_CHANNELS:
            raise ValueError("too many channels")
    return tuple(names), subsampled


def _text(file: BinaryIO) -> str:
    """A null-terminated name."""
    text = bytearray()
    while (byte := file.read(1)) != b"\0":
        text += byte
        if not byte or len(text) > MAX_NAME:
            raise ValueError("a name without an end")
    return text.decode("utf-8", "replace")
