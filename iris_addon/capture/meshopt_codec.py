"""Decoder of glTF's EXT_meshopt_compression: vertices, triangles and indices of a compressed buffer view.

https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Vendor/EXT_meshopt_compression/README.md, version 0 of the
vertex stream and 0 and 1 of the index streams. Streams come from strangers: whatever they say, nothing beyond their
ends is read.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Integer, kernel

Bytes = NDArray[np.uint8]

BLOCK_BYTES, BLOCK_VERTICES, GROUP = 8192, 256, 16
"""Bytes and vertices of a block at most, and vertices of a group of one width."""
TAIL = 32
"""Bytes behind the vertex stream, at least."""
VERTICES, TRIANGLES, INDICES = 0xA0, 0xE0, 0xD0
"""Upper half of the first byte of a stream."""


def decode(extension: Mapping[str, Any], blob: bytes) -> bytes:
    """The plain content of a buffer view.

    Args:
        extension: of the buffer view.
        blob: the buffer that holds the stream.

    Raises:
        ValueError, KeyError, TypeError: damaged, or of a version or filter that is not read.
    """
    start, length = int(extension.get("byteOffset", 0)), int(extension["byteLength"])
    count, stride, mode = int(extension["count"]), int(extension["byteStride"]), extension["mode"]
    data = np.frombuffer(blob, np.uint8)[start : start + length]
    if min(start, length, count) < 0 or len(data) != length or length < 1:
        raise ValueError("a compressed buffer view is not in the file")
    kind, version = int(data[0]) & 0xF0, int(data[0]) & 0x0F
    if mode == "ATTRIBUTES" and kind == VERTICES and version == 0 and stride % 4 == 0 and 0 < stride <= BLOCK_VERTICES:
        out = np.empty((count, stride), np.uint8)
        good = length > max(stride, TAIL) and _vertices(data, out, data[length - stride :].astype(np.int64))
        if good:
            return _FILTERS[extension.get("filter", "NONE")](out).tobytes()
    elif mode in ("TRIANGLES", "INDICES") and version <= 1 and stride in (2, 4):
        indices = np.zeros(count, np.int64)
        if mode == "TRIANGLES" and kind == TRIANGLES and count % 3 == 0 and length >= 17 + count // 3:
            edges, corners = np.full((16, 2), -1), np.full(16, -1)
            good = _triangles(data, indices.reshape(-1, 3), edges, corners, 13 if version else 15)
        else:
            good = kind == INDICES and length >= 5 + count and _sequence(data, indices, np.zeros(2, np.int64))
        if good:
            return indices.astype(np.uint16 if stride == 2 else np.uint32).tobytes()
    raise ValueError(f"its compressed {mode} are damaged or of another version")


# ---- Vertices -------------------------------------------------------------------------------------------------------


@kernel
def _vertices(data: Bytes, out: Bytes, last: NDArray[np.int64]) -> bool:
    """Vertices ``out`` (n, stride), of each byte the difference from the vertex before; ``last`` (stride,) is the
    vertex before the first. False where the stream is damaged."""
    n, stride = out.shape
    at, end = 1, len(data) - max(stride, TAIL)
    block = min((BLOCK_BYTES // stride) & ~(GROUP - 1), BLOCK_VERTICES)
    for first in range(0, n, block):
        size = min(block, n - first)
        groups = (size + GROUP - 1) // GROUP
        for k in range(stride):
            head, value = at, last[k]
            at += (groups + 3) // 4
            if at > end:
                return False
            for group in range(groups):
                width = (int(data[head + group // 4]) >> (2 * (group % 4))) & 3
                packed = at
                at += (0, 4, 8, 16)[width]
                if at > end:
                    return False
                for i in range(GROUP):
                    code = 0
                    if width == 1:
                        code = (int(data[packed + i // 4]) >> (6 - 2 * (i % 4))) & 3
                    elif width == 2:
                        code = (int(data[packed + i // 2]) >> (4 - 4 * (i % 2))) & 15
                    elif width == 3:
                        code = int(data[packed + i])
                    if (width == 1 and code == 3) or (width == 2 and code == 15):
                        if at >= end:
                            return False
                        code = int(data[at])
                        at += 1
                    if GROUP * group + i < size:
                        value = (value + ((code >> 1) ^ -(code & 1))) & 255
                        out[first + GROUP * group + i, k] = value
            last[k] = value
    return True


def _plain(out: Bytes) -> NDArray:
    return out


def _exponential(out: Bytes) -> NDArray:
    """Floats of an exponent of 8 and a mantissa of 24 bits."""
    packed = out.view("<i4")
    return np.ldexp(((packed << 8) >> 8).astype(np.float32), packed >> 24).astype("<f4")


def _quaternion(out: Bytes) -> NDArray:
    """Quaternions of normalised 16-bit numbers, the largest component of which was left out."""
    packed = out.view("<i2").astype(np.float64)
    if packed.shape[1] != 4:
        raise ValueError("its compressed rotations are damaged")
    low = out.view("<i2")[:, 3].astype(np.int64)
    small = packed[:, :3] * (0.5**0.5 / (low | 3))[:, None]
    largest = np.sqrt(np.maximum(1 - (small**2).sum(1), 0))
    turned, rows = np.empty((len(out), 4)), np.arange(len(out))
    for k, values in enumerate((largest, *small.T)):
        turned[rows, ((low & 3) + k) & 3] = values
    return np.rint(turned * 32767).astype("<i2")


_FILTERS = {"NONE": _plain, "OCTAHEDRAL": _plain, "EXPONENTIAL": _exponential, "QUATERNION": _quaternion}
"""Normals, which the octahedral filter is for, are not read."""


# ---- Indices --------------------------------------------------------------------------------------------------------


@kernel
def _number(data: Bytes, at: Integer, end: Integer) -> tuple[int, int]:
    """A number of 7 bits per byte from ``at`` on, and where it ends; beyond ``end`` where it is cut."""
    value, shift = 0, 0
    while at < end and shift < 35:
        byte = int(data[at])
        value |= (byte & 127) << shift
        at += 1
        if byte < 128:
            return value, at
        shift += 7
    return 0, end + 1


@kernel
def _sequence(data: Bytes, indices: NDArray[np.int64], last: NDArray[np.int64]) -> bool:
    """Indices (n,), each a difference from one of the two ``last`` ones."""
    at, end = 1, len(data) - 4
    for i in range(len(indices)):
        value, at = _number(data, at, end)
        if at > end:
            return False
        which, value = value & 1, value >> 1
        last[which] = (last[which] + ((value >> 1) ^ -(value & 1))) & 0xFFFFFFFF
        indices[i] = last[which]
    return True


@kernel
def _triangles(
    data: Bytes, faces: NDArray[np.int64], edges: NDArray[np.int64], corners: NDArray[np.int64], far: Integer
) -> bool:
    """Faces (n, 3), coded by the 16 latest edges (16, 2) and corners (16,); ``far`` is the first code of an index that
    is none of these."""
    end = len(data) - 16
    at = 1 + len(faces)
    edge, corner, following, last = 0, 0, 0, 0
    for i in range(len(faces)):
        code = int(data[1 + i])
        new_b, new_c = True, True  # whether b and c are remembered
        if code < 0xF0:
            before = (edge - 1 - (code >> 4)) & 15
            a, b, third = edges[before, 0], edges[before, 1], code & 15
            if third == 0:
                c = following
                following += 1
            elif third < far:
                c, new_c = corners[(corner - 1 - third) & 15], False
            elif third < 15:
                last += third - (third ^ 3)
                c = last
            else:
                step, at = _number(data, at, end)
                last += (step >> 1) ^ -(step & 1)
                c = last
        else:
            if code < 0xFE:
                more, first = int(data[end + (code & 15)]), 0
            else:
                if at >= end:
                    return False
                more, first = int(data[at]), 0 if code == 0xFE else 15
                at += 1
                if more == 0:
                    following = 0
            second, third = more >> 4, more & 15
            a, b, c = 0, 0, 0
            if first == 0:
                a = following
                following += 1
            if second == 0:
                b = following
                following += 1
            elif second < 15 or code < 0xFE:
                b, new_b = corners[(corner - second) & 15], False
            if third == 0:
                c = following
                following += 1
            elif third < 15 or code < 0xFE:
                c, new_c = corners[(corner - third) & 15], False
            if first == 15:
                step, at = _number(data, at, end)
                last += (step >> 1) ^ -(step & 1)
                a = last
            if second == 15 and code >= 0xFE:
                step, at = _number(data, at, end)
                last += (step >> 1) ^ -(step & 1)
                b = last
            if third == 15 and code >= 0xFE:
                step, at = _number(data, at, end)
                last += (step >> 1) ^ -(step & 1)
                c = last
            corners[corner] = a
            corner = (corner + 1) & 15
            corners[corner] = b
            corner = (corner + new_b) & 15
            edges[edge, 0], edges[edge, 1] = b, a
            edge = (edge + 1) & 15
        if at > end:
            return False
        corners[corner] = c
        corner = (corner + new_c) & 15
        edges[edge, 0], edges[edge, 1] = c, b
        edge = (edge + 1) & 15
        edges[edge, 0], edges[edge, 1] = a, c
        edge = (edge + 1) & 15
        faces[i, 0], faces[i, 1], faces[i, 2] = a, b, c
    return True
