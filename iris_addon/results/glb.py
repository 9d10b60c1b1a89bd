"""The mesh of a result as binary glTF 2.0, readable with numpy alone and by any program that opens .glb.

Other programs see an unindexed primitive: corner k of face f is vertex 3 f + k, so that face order and UV seams survive
every importer; a node matrix rotates the capture's up axis to glTF's +Y. Buffer views named by ``extras.iris`` of the
mesh hold what glTF cannot express: the shared vertices in float64, the faces, the region labels, and of a
scan the normals by which faces are shaded. Reading takes topology
from there, and UVs from TEXCOORD_0.

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.glb_chunks import pack_chunks, read_chunks
from ..base.untrusted import MEND, decoding, finite, numbers
from ..model.capture import Mesh

FLOAT, ARRAY_BUFFER = 5126, 34962
MAX_BYTES = 4 << 30

Up = tuple[float, float, float]


def encode_glb(mesh: Mesh, regions: NDArray[np.int32], up: Up) -> bytes:
    """The bytes of mesh.glb for ``mesh``, whose ``uv`` must be set, ``regions`` (F,) and the unit vector ``up``."""
    if mesh.uv is None:
        raise ValueError("the mesh of a result must have UVs")
    corners = mesh.vertices[mesh.faces].reshape(-1, 3).astype("<f4")
    uv = mesh.uv.reshape(-1, 2).astype(np.float64)
    uv = np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]).astype("<f4")  # glTF has v = 0 at the top
    arrays = {
        "corners": corners,
        "uv": uv,
        "vertices": mesh.vertices.astype("<f8"),
        "faces": mesh.faces.astype("<u4"),
        "parts": regions.astype("<i4"),
    }
    if mesh.regions is not None:
        arrays["file_parts"] = mesh.regions.astype("<i4")
    if mesh.normals is not None:
        arrays["normals"] = np.rint(32767 * mesh.normals).astype("<i2")
    names = list(arrays)
    blob, views = bytearray(), []
    for name, array in arrays.items():
        blob += b"\0" * (-len(blob) % 8)
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": array.nbytes})
        if name in ("corners", "uv"):
            views[-1]["target"] = ARRAY_BUFFER
        blob += array.tobytes()
    bounds = corners if len(corners) else np.zeros((1, 3), np.float32)
    document = {
        "asset": {"version": "2.0", "generator": "IRIS for Blender"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "IRIS Room", "mesh": 0, "matrix": _turn_up_to_y(up).T.ravel().tolist()}],  # column-major
        "meshes": [
            {
                "name": "IRIS Room",
                "primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0, "mode": 4}],
                "extras": {"iris": {"up": list(up), **{name: i for i, name in enumerate(names) if i >= 2}}},
            }
        ],
        "materials": [{"name": "IRIS Surface", "doubleSided": True}],  # some importers drop UVs without a material
        "accessors": [
            {
                "bufferView": 0,
                "componentType": FLOAT,
                "count": len(corners),
                "type": "VEC3",
                "min": bounds.min(0).tolist(),
                "max": bounds.max(0).tolist(),
            },
            {"bufferView": 1, "componentType": FLOAT, "count": len(uv), "type": "VEC2"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    return pack_chunks(document, bytes(blob))


def read_glb(path: Path) -> tuple[Mesh, NDArray[np.int32], Up]:
    """Mesh with UVs, region labels (F,) and up vector of a mesh.glb that :func:`encode_glb` made.

    Raises:
        BadInput: missing, damaged, made by another program, or with invalid indices or numbers.
    """
    document, blob = read_chunks(path, MAX_BYTES, MEND)
    with decoding(path, "is damaged or not from this program", MEND):
        primitive = document["meshes"][0]["primitives"][0]
        extras = document["meshes"][0]["extras"]["iris"]
        uv_view = document["accessors"][primitive["attributes"]["TEXCOORD_0"]]["bufferView"]
        views = document["bufferViews"]

        def array(view: int, dtype: str, width: int) -> NDArray[Any]:
            start, length = int(views[view].get("byteOffset", 0)), int(views[view]["byteLength"])
            row = np.dtype(dtype).itemsize * width
            if start < 0 or length < 0 or start + length > len(blob) or length % row:
                raise ValueError(f"buffer view {view} does not fit its data")
            return np.frombuffer(blob, dtype, length // np.dtype(dtype).itemsize, start).reshape(-1, width)

        vertices = array(extras["vertices"], "<f8", 3).copy()
        faces = array(extras["faces"], "<u4", 3).astype(np.int64)
        uv = array(uv_view, "<f4", 2).astype(np.float64)
        regions = array(extras["parts"], "<i4", 1)[:, 0].copy()
        file_parts = array(extras["file_parts"], "<i4", 1)[:, 0].copy() if "file_parts" in extras else None
        normals = array(extras["normals"], "<i2", 3) / np.float32(32767) if "normals" in extras else None
        up = numbers(extras["up"], (3,), "up", path)
    n = len(faces)
    of_faces = [each for each in (regions, file_parts, normals) if each is not None]
    if len(uv) != 3 * n or any(len(each) != n for each in of_faces):
        raise _damaged(path, "faces, UVs, regions and normals differ in number")
    if n and faces.max() >= len(vertices):
        raise _damaged(path, "a face refers to a vertex that does not exist")
    if finite(vertices, (None, 3)) is None or finite(uv, (None, 2)) is None or not 0.5 < np.linalg.norm(up) < 2:
        raise _damaged(path, "positions, UVs or the up vector are not finite")
    uv[:, 1] = 1.0 - uv[:, 1]
    mesh = Mesh(
        vertices=vertices,
        faces=faces,
        uv=uv.astype(np.float32).reshape(n, 3, 2),
        regions=file_parts,
        normals=normals,
    )
    return mesh, regions, (float(up[0]), float(up[1]), float(up[2]))


def _turn_up_to_y(up: Up) -> NDArray[np.float64]:
    """(4, 4) shortest rotation that takes ``up`` to +Y (Rodrigues); about X if they are opposite."""
    a, y = np.asarray(up, float) / np.linalg.norm(up), np.array([0.0, 1.0, 0.0])
    turn = np.eye(4)
    cosine = float(a @ y)
    if cosine < -1 + 1e-9:
        turn[:3, :3] = np.diag([1.0, -1.0, -1.0])
        return turn
    x, yy, z = np.cross(a, y)
    K = np.array([[0, -z, yy], [z, 0, -x], [-yy, x, 0]])
    turn[:3, :3] = np.eye(3) + K + K @ K / (1 + cosine)
    return turn


def _damaged(path: Path, why: str) -> BadInput:
    return BadInput(f"is damaged or not from this program ({why})", MEND, path)
