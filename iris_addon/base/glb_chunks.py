"""Binary glTF as its two chunks, and whether what the first announces can be in the second.

An accessor without data stands for zeros and a node for a copy of its mesh, so that a small file may announce a mesh of
any size; importers make it. https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

from .errors import BadInput
from .untrusted import MAX_COMPRESSION, decoding, parse_json, read_bytes

MAGIC, VERSION = b"glTF", 2
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
COMPRESSED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression"}
MAX_REPEATED = 32
"""Corners and vertices of all nodes for each three numbers in the file."""
FREE_CORNERS = 3_000_000
"""Corners and vertices that a small file may have by repeating meshes."""
_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<II")
_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def read_chunks(path: Path, largest: int, mend: str) -> tuple[dict[str, Any], bytes]:
    """The JSON document and the binary chunk of a .glb of at most ``largest`` bytes; raises BadInput."""
    data = read_bytes(path, largest, mend=mend)
    with decoding(path, mend=mend):
        magic, version, total = _HEAD.unpack_from(data)
        length, kind = _CHUNK.unpack_from(data, _HEAD.size)
        start = _HEAD.size + _CHUNK.size
        if magic != MAGIC or version != VERSION or total != len(data) or kind != JSON_CHUNK:
            raise ValueError("not a complete binary glTF 2.0 file")
        document = parse_json(data[start : start + length], path, mend)
        if not isinstance(document, dict):
            raise ValueError("its JSON is no object")
        if start + length == len(data):
            return document, b""
        blob_length, blob_kind = _CHUNK.unpack_from(data, start + length)
        blob = data[start + length + _CHUNK.size :][:blob_length]
        if blob_kind != BINARY_CHUNK or len(blob) != blob_length:
            raise ValueError("chunks out of place")
        return document, blob


def pack_chunks(document: dict[str, Any], blob: bytes) -> bytes:
    """The bytes of a .glb."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    padding = b"\0" * (-len(blob) % 4)
    chunks = [_CHUNK.pack(len(text), JSON_CHUNK), text, _CHUNK.pack(len(blob + padding), BINARY_CHUNK), blob, padding]
    return b"".join([_HEAD.pack(MAGIC, VERSION, _HEAD.size + sum(map(len, chunks))), *chunks])


def check_announced(document: dict[str, Any], size: int, path: Path, mend: str) -> None:
    """Raise BadInput if the meshes of ``document`` are larger than the ``size`` of its file in bytes allows."""
    with decoding(path, mend=mend):
        accessors = document.get("accessors", [])
        if any(not isinstance(a["count"], int) or a["count"] < 0 for a in accessors):
            raise ValueError("a count is no whole number")
        announced = sum(a["count"] * _BYTES[a["componentType"]] * _COMPONENTS[a["type"]] for a in accessors)
        for view in document.get("bufferViews", []):
            packed = view.get("extensions", {}).get("EXT_meshopt_compression")
            announced += packed["count"] * packed["byteStride"] if packed else 0
        compressed = not COMPRESSED.isdisjoint(document.get("extensionsUsed", ()))
        if announced > (MAX_COMPRESSION if compressed else 2) * size + (1 << 20):
            raise BadInput("announces more numbers than the file can hold", mend, path)
        meshes = [sum(_elements(p, accessors) for p in mesh["primitives"]) for mesh in document.get("meshes", [])]
        shown = sum(meshes[node["mesh"]] for node in document.get("nodes", []) if "mesh" in node)
        if max(shown, sum(meshes)) > max(FREE_CORNERS, MAX_REPEATED * size // 12):
            raise BadInput("repeats its meshes more often than can be read", "export it without instances", path)


def _elements(primitive: dict[str, Any], accessors: list[dict[str, Any]]) -> int:
    """Corners and vertices of a primitive."""
    used = [*primitive["attributes"].values(), *([primitive["indices"]] if "indices" in primitive else [])]
    return sum(accessors[number]["count"] for number in used)
