"""The geometry of a binary glTF without the extensions that change it: compression by meshopt, integer coordinates and
instances are written out, so that any reader of plain glTF finds the same mesh.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.untrusted import decoding
from .meshopt_codec import decode

MESHOPT, INSTANCES = "EXT_meshopt_compression", "EXT_mesh_gpu_instancing"
MAX_INSTANCES = 100_000
"""Of all nodes together."""
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_FLOAT = 5126
_PLACES = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
"""Attributes of instances, and what a node calls them."""
READ_ATTRIBUTES = ("POSITION", "TEXCOORD_0")


def plain_geometry(document: dict[str, Any], blob: bytes, path: Path, mend: str) -> tuple[dict[str, Any], bytes]:
    """``document`` and its ``blob`` with plain geometry; both as they are where they had no other.

    Raises:
        BadInput: damaged, or more instances than can be read.
    """
    with decoding(path, mend=mend):
        if any(_compressed(view) for view in document.get("bufferViews", [])):
            document, blob = _uncompressed(document, blob)
        document, blob = _with_floats(document, blob)
        counts = [_instances(node, document) for node in document.get("nodes", [])]
        if sum(counts) > MAX_INSTANCES:
            what = f"has {sum(counts)} instances, more than {MAX_INSTANCES}"
            raise BadInput(what, "export fewer, or the room without its plants", path)
        return (_with_nodes(document, blob) if any(counts) else document), blob


def _compressed(view: dict[str, Any]) -> dict[str, Any] | None:
    """What says how a buffer view is compressed."""
    return view.get("extensions", {}).get(MESHOPT)


def _uncompressed(document: dict[str, Any], blob: bytes) -> tuple[dict[str, Any], bytes]:
    """Buffer views in their plain form behind the ``blob``, which becomes the only buffer.

    Attributes that are not read are left out, because the filter of normals is not undone.
    """
    parts, length, views = [blob, b"\0" * (-len(blob) % 4)], len(blob) + -len(blob) % 4, []
    for view in document["bufferViews"]:
        extension = _compressed(view)
        if extension is None:
            views.append(view)
            continue
        if extension.get("buffer", 0) != 0:
            raise ValueError("compressed data are in another file")
        data = decode(extension, blob)
        place = {"buffer": 0, "byteOffset": length, "byteLength": len(data)}
        views.append({**place, "byteStride": extension["byteStride"]} if extension["mode"] == "ATTRIBUTES" else place)
        parts += [data, b"\0" * (-len(data) % 4)]
        length += len(data) + -len(data) % 4
    return {
        **document,
        "bufferViews": views,
        "buffers": [{"byteLength": length}],
        "meshes": [
            {**mesh, "primitives": [_of_read_attributes(primitive) for primitive in mesh["primitives"]]}
            for mesh in document.get("meshes", [])
        ],
    }, b"".join(parts)


def _of_read_attributes(primitive: dict[str, Any]) -> dict[str, Any]:
    read = {name: number for name, number in primitive["attributes"].items() if name in READ_ATTRIBUTES}
    return {**{key: value for key, value in primitive.items() if key != "targets"}, "attributes": read}


def _with_floats(document: dict[str, Any], blob: bytes) -> tuple[dict[str, Any], bytes]:
    """Positions and texture coordinates that are integers as floats behind the ``blob``."""
    accessors, views = list(document.get("accessors", [])), list(document.get("bufferViews", []))
    used = {
        primitive["attributes"][name]
        for mesh in document.get("meshes", [])
        for primitive in mesh["primitives"]
        for name in READ_ATTRIBUTES
        if name in primitive["attributes"] and "KHR_draco_mesh_compression" not in primitive.get("extensions", {})
    }
    parts, length = [blob, b"\0" * (-len(blob) % 4)], len(blob) + -len(blob) % 4
    changed = False
    for number in sorted(used):
        accessor = accessors[number]
        if accessor["componentType"] == _FLOAT or "bufferView" not in accessor:
            continue
        data = read_accessor(document, blob, number).astype("<f4").tobytes()
        place = {"bufferView": len(views), "componentType": _FLOAT}
        kept = {key: accessor[key] for key in ("count", "type", "name") if key in accessor}
        accessors[number] = {**kept, **place}
        views.append({"buffer": 0, "byteOffset": length, "byteLength": len(data)})
        parts.append(data)
        length += len(data)
        changed = True
    if not changed:
        return document, blob
    buffers = [{"byteLength": length}, *document.get("buffers", [])[1:]]
    return {**document, "accessors": accessors, "bufferViews": views, "buffers": buffers}, b"".join(parts)


def read_accessor(document: dict[str, Any], blob: bytes, number: int) -> NDArray[np.float64]:
    """(count, components) values of an accessor, normalised integers as fractions.

    Raises:
        ValueError, KeyError, IndexError: damaged, or without data of its own.
    """
    accessor = document["accessors"][number]
    if "sparse" in accessor:
        raise ValueError("an accessor is sparse")
    view = document["bufferViews"][accessor["bufferView"]]
    kind, width = np.dtype(_TYPES[accessor["componentType"]]), _COMPONENTS[accessor["type"]]
    count, stride = accessor["count"], view.get("byteStride", kind.itemsize * width)
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    end = start + (count - 1) * stride + kind.itemsize * width
    if view.get("buffer", 0) != 0 or min(start, count - 1, stride - kind.itemsize * width) < 0 or end > len(blob):
        raise ValueError("an accessor is not in the file")
    values = np.ndarray((count, width), kind, blob, start, (stride, kind.itemsize)).astype(np.float64)
    if accessor.get("normalized") and kind.kind in "iu":
        values = np.maximum(values / np.iinfo(kind).max, -1.0)
    return values


# ---- Instances ------------------------------------------------------------------------------------------------------


def _instances(node: dict[str, Any], document: dict[str, Any]) -> int:
    """How many instances a node makes of its mesh, 0 where it is plain."""
    attributes = node.get("extensions", {}).get(INSTANCES, {}).get("attributes", {})
    counts = {document["accessors"][number]["count"] for name, number in attributes.items() if name in _PLACES}
    if "mesh" not in node or not counts:
        return 0
    if len(counts) > 1:
        raise ValueError("its instances have places of different number")
    return int(counts.pop())


def _with_nodes(document: dict[str, Any], blob: bytes) -> dict[str, Any]:
    """A node for each instance, below the node that made them."""
    nodes = [dict(node) for node in document["nodes"]]
    for node in list(nodes):
        count = _instances(node, document)
        if not count:
            continue
        attributes = node["extensions"][INSTANCES]["attributes"]
        places = {
            _PLACES[name]: read_accessor(document, blob, number).tolist()
            for name, number in attributes.items()
            if name in _PLACES
        }
        mesh = node.pop("mesh")
        node["children"] = [*node.get("children", []), *range(len(nodes), len(nodes) + count)]
        nodes += [{"mesh": mesh, **{key: values[k] for key, values in places.items()}} for k in range(count)]
    return {**document, "nodes": nodes}
