"""PLY meshes, text and binary, with polygons of any and of mixed sizes.

Format: Turk, The PLY Polygon File Format (1994). Blender writes triangles, quads and n-gons mixed by default, which
readers that take all lists to be of one length do not read.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.untrusted import open_file
from ..model.capture import Mesh
from .polygons import texture_coordinates, triangulate

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float": "f4", "double": "f8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
MAX_MESH_BYTES = 2 << 30
MAX_HEADER_LINES = 10_000
MAX_CORNERS = 100_000
"""Of one polygon."""


@dataclass(frozen=True)
class _Property:
    """One property of an element; ``count`` is the type of a list's length, "" for a single value."""

    name: str
    kind: str
    count: str = ""


@dataclass(frozen=True)
class _Element:
    name: str
    size: int
    properties: tuple[_Property, ...]


def read_ply(path: Path) -> Mesh:
    """The triangles of a PLY file in file order, with per-corner UVs where its vertices or faces have them; regions are
    the "material_index" of its faces.

    Raises:
        BadInput: it has points and no faces.
        ValueError, IndexError, KeyError: the file is malformed.
    """
    with open_file(path, MAX_MESH_BYTES, mend="decimate the mesh") as file:
        order, elements = _header(file)
        tables = {element.name: _read(file, element, order) for element in elements}
    vertex = tables["vertex"]
    vertices = np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], -1)
    face = tables.get("face", {})
    lists = face.get("vertex_indices", face.get("vertex_index"))
    if lists is None:
        raise BadInput("has points and no faces", "export a mesh with faces", path)
    corners, counts = np.asarray(lists[0], np.int64), np.asarray(lists[1], np.int64)
    if len(corners) and (corners.min() < 0 or corners.max() >= len(vertices)):
        raise IndexError("faces name vertices that it does not have")
    at = triangulate(vertices, corners, counts)
    return Mesh(vertices, corners[at], _uv(vertex, face, corners, counts, at), _regions(face, counts))


def _uv(vertex: dict, face: dict, corners: NDArray, counts: NDArray, at: NDArray) -> NDArray[np.float32] | None:
    """(F, 3, 2) of the faces' list of texture coordinates, else of the vertices."""
    if "texcoord" in face and np.array_equal(face["texcoord"][1], 2 * counts):
        return texture_coordinates(face["texcoord"][0]).reshape(-1, 2)[at]
    for u, v in _UV_NAMES:
        if u in vertex and v in vertex:
            return texture_coordinates(np.stack([vertex[u], vertex[v]], -1))[corners[at]]
    return None


def _regions(face: dict, counts: NDArray[np.int64]) -> NDArray[np.int32] | None:
    """(F,) labels of the triangles, in order of first appearance; None where no material or one is named."""
    if "material_index" not in face or isinstance(face["material_index"], tuple):
        return None
    named = np.repeat(np.asarray(face["material_index"]), np.maximum(counts - 2, 0))
    _, first, label = np.unique(named, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[label].astype(np.int32) if len(first) > 1 else None


def _header(file: BinaryIO) -> tuple[str, list[_Element]]:
    """Byte order ("" for text) and the elements."""
    if file.readline(16).strip() != b"ply":
        raise ValueError("no PLY file")
    order, elements = None, []
    for _ in range(MAX_HEADER_LINES):
        words = file.readline(4096).decode("ascii", "replace").split()
        if words[:1] == ["format"]:
            order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[words[1]]
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[:1] == ["property"]:
            own = _Property(words[4], _TYPES[words[3]], _TYPES[words[2]]) if words[1] == "list" else None
            own = own or _Property(words[2], _TYPES[words[1]])
            last = elements[-1]
            elements[-1] = _Element(last.name, last.size, (*last.properties, own))
        elif words[:1] == ["end_header"]:
            break
    else:
        raise ValueError("a header without an end")
    if order is None:
        raise ValueError("no format in its header")
    return order, elements


def _read(file: BinaryIO, element: _Element, order: str) -> dict:
    """The values of an element by property; a list is a pair of all its items and the number of each row's."""
    if not order:
        return _read_text(file, element)
    if element.size == 0:
        return {
            p.name: (np.empty(0, p.kind), np.empty(0, np.int64)) if p.count else np.empty(0) for p in element.properties
        }
    start = file.tell()
    uniform = _read_uniform(file, element, order)
    if uniform is not None:
        return uniform
    file.seek(start)
    return _read_mixed(file, element, order)


def _read_uniform(file: BinaryIO, element: _Element, order: str) -> dict | None:
    """By one table of rows, if every list has the length of the first row's; else None."""
    start = file.tell()
    first = _read_mixed(file, _Element(element.name, 1, element.properties), order)
    file.seek(start)
    lengths = {p.name: int(first[p.name][1][0]) for p in element.properties if p.count}
    fields = []
    for number, p in enumerate(element.properties):
        if p.count:
            fields += [(f"count {number}", order + p.count), (f"items {number}", order + p.kind, (lengths[p.name],))]
        else:
            fields.append((f"items {number}", order + p.kind))
    row = np.dtype(fields)
    data = file.read(row.itemsize * element.size)
    if len(data) < row.itemsize * element.size:
        return None
    table, values = np.frombuffer(data, row), {}
    for number, p in enumerate(element.properties):
        if not p.count:
            values[p.name] = table[f"items {number}"]
            continue
        counts = table[f"count {number}"].astype(np.int64)
        if (counts != lengths[p.name]).any():
            return None
        values[p.name] = table[f"items {number}"].reshape(-1), counts
    return values


def _read_mixed(file: BinaryIO, element: _Element, order: str) -> dict:
    """Row by row. Single values between two lists are read together."""
    kinds = [(np.dtype(order + p.kind), np.dtype(order + p.count) if p.count else None) for p in element.properties]
    parts: list[list[bytes]] = [[] for _ in kinds]
    counts: list[list[int]] = [[] for _ in kinds]
    for _ in range(element.size):
        for number, (kind, count) in enumerate(kinds):
            n = 1 if count is None else int(np.frombuffer(_exactly(file, count.itemsize), count)[0])
            if not 0 <= n <= MAX_CORNERS:
                raise ValueError(f"a list of {n} items")
            parts[number].append(_exactly(file, n * kind.itemsize))
            counts[number].append(n)
    values: dict = {}
    for p, (kind, count), own, n in zip(element.properties, kinds, parts, counts, strict=True):
        items = np.frombuffer(b"".join(own), kind)
        values[p.name] = items if count is None else (items, np.array(n, np.int64))
    return values


def _exactly(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) != size:
        raise ValueError("it ends before its last element")
    return data


def _read_text(file: BinaryIO, element: _Element) -> dict:
    rows: list[list[float]] = [[] for _ in element.properties]
    counts: list[list[int]] = [[] for _ in element.properties]
    for _ in range(element.size):
        words = iter(file.readline().split())
        for number, p in enumerate(element.properties):
            n = int(next(words, b"")) if p.count else 1
            items = [float(next(words, b"")) for _ in range(min(n, MAX_CORNERS + 1))]
            if not 0 <= n <= MAX_CORNERS:
                raise ValueError(f"a list of {n} items")
            rows[number] += items
            counts[number].append(n)
    values: dict = {}
    for number, p in enumerate(element.properties):
        items = np.array(rows[number], np.float64)
        values[p.name] = (items, np.array(counts[number], np.int64)) if p.count else items
    return values
