"""Meshes of scenes as binary PLY. Does not use bpy, nor what Blender's own Python lacks, as the reader of PLY does."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..base.files import atomic_write
from ..model.capture import Mesh


def write_ply(path: Path, mesh: Mesh) -> None:
    """Write ``mesh`` for :mod:`iris_addon.capture.ply_files`: positions in the precision that they have, triangles, and
    where it has them UVs per corner and regions."""
    n, kind = len(mesh.faces), "float" if mesh.vertices.dtype == np.float32 else "double"
    fields: list[tuple] = [("corners", "u1"), ("vertex_indices", "<i4", 3)]
    properties = ["list uchar int vertex_indices"]
    if mesh.uv is not None:
        fields += [("coordinates", "u1"), ("texcoord", "<f4", 6)]
        properties.append("list uchar float texcoord")
    if mesh.regions is not None:
        fields.append(("material_index", "<i4"))
        properties.append("int material_index")
    rows = np.empty(n, np.dtype(fields))
    rows["corners"], rows["vertex_indices"] = 3, mesh.faces
    if mesh.uv is not None:
        rows["coordinates"], rows["texcoord"] = 6, mesh.uv.reshape(n, 6)
    if mesh.regions is not None:
        rows["material_index"] = mesh.regions
    header = [
        *("ply", "format binary_little_endian 1.0", f"element vertex {len(mesh.vertices)}"),
        *(f"property {kind} {axis}" for axis in "xyz"),
        *(f"element face {n}", *(f"property {each}" for each in properties), "end_header"),
    ]
    text = "".join(f"{line}\n" for line in header).encode("ascii")
    positions = mesh.vertices.astype("<f4" if kind == "float" else "<f8")
    atomic_write(path, lambda part: part.write_bytes(text + positions.tobytes() + rows.tobytes()))
