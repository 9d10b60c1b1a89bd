"""EXR files of many channels without OpenEXR, which Blender's Python lacks: 32-bit floats, line by line.

Blender gives the pixels of render passes by a file alone, and cannot write layers of its own making. Format:
https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .color_spaces import REC709, ColorSpace
from .files import atomic_write
from .image_headers import MAGIC, MAX_IMAGE_BYTES, check_exr_samples, exr_headers
from .untrusted import decoding, open_file

MEND = "render again"
ZIP, ZIP_LINES = 3, 16
"""The number of the compression, and the lines that it packs together."""
FLOAT = 2
"""The number of the type of a channel's values."""


def layer_channels(
    layers: Mapping[str, NDArray[np.floating]], alphas: Mapping[str, NDArray[np.floating]], space: ColorSpace | None
) -> dict[str, NDArray[np.float32]]:
    """(H, W) by the names that programs know layers by, of linear Rec.709 (H, W, 3), in ``space`` where given.

    The layer "" is what programs show that know no layers. ``alphas`` (H, W) are the A of layers.
    """
    matrix = np.eye(3) if space is None else REC709.matrix_to(space)
    channels: dict[str, NDArray[np.float32]] = {}
    for layer, values in layers.items():
        prefix = f"{layer}." if layer else ""
        pixels = (values @ matrix.T).astype(np.float32)
        channels |= {f"{prefix}{name}": np.ascontiguousarray(pixels[..., k]) for k, name in enumerate("RGB")}
        if layer in alphas:
            channels[f"{prefix}A"] = np.ascontiguousarray(alphas[layer], np.float32)
    return channels


def read_exr_planes(path: Path) -> dict[str, NDArray[np.float32]]:
    """(H, W) of every channel by its name, row 0 on top; of channels of one name in several parts, the last.

    Raises:
        BadInput: missing, damaged, compressed, or of other numbers than 32-bit floats.
    """
    with open_file(path, MAX_IMAGE_BYTES, mend=MEND) as file, decoding(path, "is no uncompressed EXR of floats", MEND):
        parts, multipart = exr_headers(file, path)
        check_exr_samples(path, parts)
        lines = [np.frombuffer(file.read(8 * part.height), "<u8") for part in parts]
        planes: dict[str, NDArray[np.float32]] = {}
        for number, (part, offsets) in enumerate(zip(parts, lines, strict=True)):
            pixels = np.empty((part.height, len(part.channels), part.width), np.float32)
            if len(offsets) != part.height:
                raise ValueError("its table of lines is cut off")
            for row, offset in enumerate(offsets.tolist()):
                file.seek(offset)
                of_part = struct.unpack("<i", file.read(4))[0] if multipart else 0
                _, size = struct.unpack("<2i", file.read(8))
                if of_part != number or size != pixels[row].nbytes:
                    raise ValueError("a line has another part or size")
                pixels[row] = np.frombuffer(file.read(size), "<f4").reshape(pixels[row].shape)
            planes |= {name: pixels[:, index] for index, name in enumerate(part.channels)}
        return planes


def write_exr_planes(path: Path, planes: Mapping[str, NDArray[np.floating]], space: ColorSpace | None = None) -> None:
    """Write channels (H, W), row 0 on top, as one EXR of 32-bit floats, compressed without loss.

    Args:
        space: that the header names; without any, EXR means Rec.709.

    Raises:
        IrisError: the file cannot be written.
    """
    names = sorted(planes, key=str.encode)
    pixels = np.stack([np.asarray(planes[name], "<f4") for name in names], axis=1)  # (H, C, W)
    height, _, width = pixels.shape
    header = _header(names, width, height, space)
    blocks = [_packed(pixels[top : top + ZIP_LINES].tobytes()) for top in range(0, height, ZIP_LINES)]
    at, offsets = len(header) + 8 * len(blocks), []
    for block in blocks:
        offsets.append(at)
        at += 8 + len(block)
    tops = range(0, height, ZIP_LINES)
    chunks = [struct.pack("<2i", top, len(block)) + block for top, block in zip(tops, blocks, strict=True)]
    content = b"".join([header, struct.pack(f"<{len(offsets)}Q", *offsets), *chunks])
    atomic_write(path, lambda temporary: temporary.write_bytes(content))


def _header(names: Sequence[str], width: int, height: int, space: ColorSpace | None) -> bytes:
    channels = b"".join(name.encode() + b"\0" + struct.pack("<iB3x2i", FLOAT, 0, 1, 1) for name in names) + b"\0"
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = [
        ("channels", "chlist", channels),
        ("compression", "compression", bytes([ZIP])),
        ("dataWindow", "box2i", box),
        ("displayWindow", "box2i", box),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1.0)),
    ]
    if space is not None:
        attributes.append(("chromaticities", "chromaticities", struct.pack("<8f", *space.chromaticities)))
    # Names of more than 31 bytes need a flag; layers have short ones, but artists name lamps.
    version = 2 | (0x400 if any(len(name.encode()) > 31 for name in names) else 0)
    written = [MAGIC + struct.pack("<I", version)]
    written += [
        name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
        for name, kind, value in attributes
    ]
    return b"".join(written) + b"\0"


def _packed(raw: bytes) -> bytes:
    """``raw`` as EXR's ZIP packs it: even bytes, then odd ones, as differences; as it is where that is no shorter."""
    data = np.frombuffer(raw, np.uint8)
    apart = np.concatenate([data[::2], data[1::2]]).astype(np.int16)
    apart[1:] = (np.diff(apart) + 128) & 255
    packed = zlib.compress(apart.astype(np.uint8).tobytes())
    return packed if len(packed) < len(raw) else raw
