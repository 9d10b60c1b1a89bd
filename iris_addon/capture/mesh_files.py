"""The mesh of a room from a PLY, OBJ or GLB file, faces in file order.

GLB is read by trimesh, Draco's compression by DracoPy, what else changes its geometry by :mod:`.glb_geometry`. OBJ and
PLY are read here, because general readers sort faces by material, and cut concave polygons to fans.
"""

from __future__ import annotations

import io
import logging
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.glb_chunks import check_announced, pack_chunks, read_chunks
from ..base.untrusted import decoding, open_file, open_text
from ..model.capture import DEGENERATE_AREA, FloatArray, Mesh
from ..rays.tracer import Tracer
from .glb_geometry import INSTANCES, MESHOPT, plain_geometry
from .ply_files import MAX_MESH_BYTES, read_ply
from .polygons import texture_coordinates, triangulate

# What trimesh logs goes to those who look at its log; an error about a file is one line.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

AGAIN = "copy or export the mesh again"
MESH_SUFFIXES = (".ply", ".obj", ".glb")
READ_EXTENSIONS = {
    "KHR_draco_mesh_compression", "KHR_mesh_quantization", "KHR_texture_transform", "KHR_materials_unlit",
    "KHR_texture_basisu", "EXT_texture_webp", "KHR_lights_punctual", MESHOPT, INSTANCES,
}  # fmt: skip
"""Extensions of glTF that are read, or that do not change the geometry."""
CHANGES_GEOMETRY = {"KHR_meshopt_compression"}
"""Extensions that are not read and without which other geometry is, whether or not they are required."""
MAX_FACES = 20_000_000
MAX_COORDINATE = 1e9
"""Metres from the origin that vertices and cameras may have for their distances to be computed."""
UV_TOLERANCE = 1e-4
"""By which coordinates may leave the unit square."""
MAX_UV_OVERLAP = 0.01
"""Share of the covered texture that several faces may share."""


def read_mesh(path: Path) -> tuple[Mesh, tuple[str, ...]]:
    """Read and check a mesh.

    Returns:
        The mesh with UVs only where they can serve as an atlas, and warnings.

    Raises:
        BadInput: missing, damaged, not PLY/OBJ/GLB, too large, empty, NaN vertices, only degenerate triangles.
    """
    _check_file(path)
    with decoding(path, "is damaged or not a mesh", AGAIN):
        mesh = {".obj": read_obj, ".ply": read_ply, ".glb": _read_glb}[path.suffix.lower()](path)
    _check_geometry(mesh, path)

    warnings = []
    mesh, doubled = without_doubles(mesh)
    if doubled:
        warnings.append(f"{path.name}: {doubled} faces lie twice in one place; each counts once")
    if excess := non_manifold_edges(mesh.faces[mesh.faces[:, 0] != mesh.faces[:, 1]]):
        warnings.append(f"{path.name}: {excess} edges are shared by more than two faces")
    if mesh.uv is not None and (reason := unusable_uv(mesh.uv)):
        warnings.append(f"{path.name}: its UVs {reason}; a new atlas is made")
        mesh = replace(mesh, uv=None)
    return mesh, tuple(warnings)


def _check_file(path: Path) -> None:
    if not path.is_file():
        raise BadInput("no such mesh", "put the file there or correct the path that names it", path)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise BadInput("is not a mesh format read here", "export the mesh as PLY, OBJ or GLB", path)
    if path.suffix.lower() == ".ply":
        counts = ply_counts(path).values()
        if min(counts, default=0) < 0 or sum(counts) > path.stat().st_size:
            raise BadInput("announces more elements than the file can hold", AGAIN, path)


def ply_counts(path: Path) -> dict[str, int]:
    """How many elements of each kind the header of a PLY file announces, e.g. {"vertex": 8, "face": 12}."""
    with open_file(path, MAX_MESH_BYTES, mend="decimate the mesh") as file, decoding(path, mend=AGAIN):
        header = file.read(1 << 16).split(b"end_header")[0].decode("ascii", "replace")
        words = [line.split() for line in header.splitlines()]
        return {line[1]: int(line[2]) for line in words if len(line) == 3 and line[0] == "element"}


# ---- PLY and GLB ----------------------------------------------------------------------------------------------------


def _read_glb(path: Path) -> Mesh:
    document, blob = read_chunks(path, MAX_MESH_BYTES, "decimate the mesh, or export it again")
    _check_extensions(document, path)
    size = path.stat().st_size
    check_announced(document, size, path, AGAIN)
    document, blob = plain_geometry(document, blob, path, AGAIN)
    check_announced(document, max(size, len(blob)), path, AGAIN)  # instances are nodes now
    document["materials"] = [{} for _ in document.get("materials", [])]
    for name in ("images", "textures", "samplers"):  # no picture of any format is decoded
        document.pop(name, None)
    # A file object instead of a path, so that no other file is opened.
    loaded = trimesh.load(io.BytesIO(pack_chunks(document, blob)), "glb", process=False, maintain_order=True)
    if isinstance(loaded, trimesh.Scene):
        return _concatenate_nodes(loaded)
    if not isinstance(loaded, trimesh.Trimesh):
        raise BadInput("has points and no faces", "export a mesh with faces", path)
    return _convert(loaded, np.eye(4))


def _check_extensions(document: dict[str, Any], path: Path) -> None:
    """Raise BadInput for a GLB that needs what is not read: its geometry would come as zeros."""
    required, used = (set(document.get(key, ())) for key in ("extensionsRequired", "extensionsUsed"))
    if "KHR_draco_mesh_compression" in required and find_spec("DracoPy") is None:
        raise BadInput("is Draco-compressed", "export it without compression, or install the package DracoPy", path)
    needed = sorted((required - READ_EXTENSIONS) | (used & CHANGES_GEOMETRY))
    if needed:
        raise BadInput(f"needs {', '.join(needed)}", "export it without this extension, or as PLY", path)


def _concatenate_nodes(scene: trimesh.Scene) -> Mesh:
    """One mesh of all nodes of a glTF scene in world space, one region per node."""
    meshes = []
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if isinstance(geometry, trimesh.Trimesh):
            meshes.append(_convert(geometry, transform))
    if not meshes:
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    uvs = [mesh.uv for mesh in meshes if mesh.uv is not None]
    regions = np.repeat(np.arange(len(meshes), dtype=np.int32), [len(mesh.faces) for mesh in meshes])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]),
        np.concatenate(uvs) if len(uvs) == len(meshes) else None,
        regions if len(meshes) > 1 else None,
    )


def _convert(geometry: trimesh.Trimesh, transform: FloatArray) -> Mesh:
    faces = np.asarray(geometry.faces, np.int64)
    vertices = np.asarray(geometry.vertices, np.float64) @ transform[:3, :3].T + transform[:3, 3]
    per_vertex = getattr(geometry.visual, "uv", None)
    uv = None
    if per_vertex is not None and len(per_vertex) == len(vertices):
        uv = texture_coordinates(per_vertex)[faces]
    return Mesh(vertices, faces, uv)


# ---- Checks ---------------------------------------------------------------------------------------------------------


def _check_geometry(mesh: Mesh, path: Path) -> None:
    vertices, faces = mesh.vertices, mesh.faces
    if len(faces) == 0:
        raise BadInput("has no faces", "export a mesh with faces, not a point cloud", path)
    if len(faces) > MAX_FACES:
        raise BadInput(f"has {len(faces)} faces, more than {MAX_FACES}", "decimate the mesh", path)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise BadInput("has faces that name vertices it does not have", "export the mesh again", path)
    if not (np.abs(vertices) <= MAX_COORDINATE).all():
        count = int((~(np.abs(vertices) <= MAX_COORDINATE).all(1)).sum())
        what = f"has {count} vertices with NaN or coordinates beyond {MAX_COORDINATE:g}"
        raise BadInput(what, "remove these vertices", path)
    if (face_areas(mesh) <= DEGENERATE_AREA).all():
        raise BadInput("has only triangles without area", "export the mesh again, in meters", path)


def face_areas(mesh: Mesh) -> FloatArray:
    """(F,) areas in square metres."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def without_doubles(mesh: Mesh) -> tuple[Mesh, int]:
    """``mesh`` with all but the first of faces with the same three corners made degenerate, and how many these are.

    Double-sided exports hold every face twice, back and front. Faces keep their numbers, and rays meet none without
    area.
    """
    places = np.ascontiguousarray(mesh.vertices + 0.0).view(np.dtype((np.void, 24))).ravel()  # -0 as 0
    place = np.unique(places, return_inverse=True)[1].reshape(-1)
    corners = np.sort(place[mesh.faces], axis=1)
    whole = np.flatnonzero((corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]))
    n = int(place.max()) + 1
    key = (corners[whole, 0] * n + corners[whole, 1]).astype(np.int64)
    order = np.lexsort((whole, corners[whole, 2], key))
    same = (np.diff(key[order]) == 0) & (np.diff(corners[whole, 2][order]) == 0)
    double = whole[order[1:][same]]
    if not len(double):
        return mesh, 0
    faces = mesh.faces.copy()
    faces[double] = faces[double, :1]
    return replace(mesh, faces=faces), len(double)


def non_manifold_edges(faces: NDArray[np.int64]) -> int:
    """How many edges of ``faces`` (F, 3) belong to more than two faces."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    keys = edges[:, 0] * (int(faces.max()) + 1) + edges[:, 1]
    return int((np.unique(keys, return_counts=True)[1] > 2).sum())


def unusable_uv(uv: NDArray[np.float32]) -> str | None:
    """Why per-corner coordinates ``uv`` (F, 3, 2) cannot address one texture for the whole mesh; None when they can."""
    if not np.isfinite(uv).all():
        return "are not finite"
    if uv.min() < -UV_TOLERANCE or uv.max() > 1 + UV_TOLERANCE:
        return "leave the unit square"
    edge_a, edge_b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    areas = 0.5 * np.abs(edge_a[:, 0] * edge_b[:, 1] - edge_a[:, 1] * edge_b[:, 0])
    if areas.sum() < 0.01:
        return "cover almost nothing of the texture"
    if areas.sum() > 1 + MAX_UV_OVERLAP or uv_overlap(uv) > MAX_UV_OVERLAP:
        return "use the same place of the texture for several faces"
    return None


def uv_overlap(uv: NDArray[np.float32], side: int = 256) -> float:
    """Share of the covered texture that more than one face of ``uv`` (F, 3, 2) covers, sampled on side² points.

    Each face is placed above the UV plane at its own height; a point is covered once if rays from above and from below
    hit the same face.
    """
    heights = np.linspace(0, 1, len(uv))
    corners = np.concatenate([uv, np.broadcast_to(heights[:, None, None], (len(uv), 3, 1))], -1).reshape(-1, 3)
    sheets = Tracer(Mesh(corners.astype(np.float64), np.arange(len(corners)).reshape(-1, 3)))
    grid = (np.arange(side) + 0.37) / side  # off the texel grid, where edges of many atlases lie
    points = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    down, up = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])
    faces = [
        sheets.closest(
            np.column_stack([points, np.full(len(points), height)]), np.broadcast_to(direction, (len(points), 3))
        ).face
        for height, direction in ((2.0, down), (-1.0, up))
    ]
    covered = (faces[0] >= 0) & (faces[1] >= 0)
    return float((faces[0] != faces[1])[covered].mean()) if covered.any() else 0.0


# ---- OBJ ------------------------------------------------------------------------------------------------------------


@dataclass
class _Lines:
    """Tables of an OBJ file as they grow line by line; ``corners`` and ``corner_uv`` are table indices, polygon after
    polygon."""

    vertices: list[tuple[float, float, float]] = field(default_factory=list)
    uv: list[tuple[float, float]] = field(default_factory=list)
    corners: list[int] = field(default_factory=list)
    corner_uv: list[int] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)
    materials: list[str] = field(default_factory=list)

    def add_face(self, corners: list[str], group: str, material: str) -> None:
        """Add a polygon; an absent texture index is -1."""
        for corner in corners:
            indices = corner.split("/")
            self.corners.append(_index(indices[0], len(self.vertices)))
            self.corner_uv.append(_index(indices[1], len(self.uv)) if len(indices) > 1 and indices[1] else -1)
        self.counts.append(len(corners))
        made = max(len(corners) - 2, 0)
        self.groups += [group] * made
        self.materials += [material] * made


def _index(text: str, count: int) -> int:
    """Zero-based index; OBJ counts from 1, and negative numbers count back from the last line read."""
    index = int(text)
    return index - 1 if index > 0 else count + index


def read_obj(path: Path) -> Mesh:
    """Triangles of an OBJ file in file order; regions are its materials, or its groups when it has one material.

    Raises:
        ValueError, IndexError: the file is malformed.
    """
    lines, group, material = _Lines(), "", ""
    with open_text(path, MAX_MESH_BYTES, mend="decimate the mesh") as file:
        for line in file:
            keyword, _, rest = line.strip().partition(" ")
            if keyword == "v":
                x, y, z = rest.split()[:3]
                lines.vertices.append((float(x), float(y), float(z)))
            elif keyword == "vt":
                u, v = rest.split()[:2]
                lines.uv.append((float(u), float(v)))
            elif keyword == "f":
                lines.add_face(rest.split(), group, material)
            elif keyword in ("o", "g"):
                group = rest.strip()
            elif keyword == "usemtl":
                material = rest.strip()

    vertices = np.array(lines.vertices, np.float64).reshape(-1, 3)
    corners, corner_uv = np.array(lines.corners, np.int64), np.array(lines.corner_uv, np.int64)
    if len(corners) and (corners.min() < 0 or corners.max() >= len(vertices)):
        raise IndexError("faces name vertices that it does not have")
    at = triangulate(vertices, corners, np.array(lines.counts, np.int64))
    uv = None
    if len(corner_uv) and lines.uv and corner_uv.min() >= 0:
        uv = texture_coordinates(lines.uv)[corner_uv[at]]
    labels = lines.materials if len(set(lines.materials)) > 1 else lines.groups
    return Mesh(
        vertices,
        corners[at],
        uv,
        region_labels(labels),
    )


def region_labels(names: list[str]) -> np.ndarray | None:
    """(F,) int32 labels in order of first appearance, or None when all names are one."""
    order = {name: label for label, name in enumerate(dict.fromkeys(names))}
    return np.array([order[name] for name in names], np.int32) if len(order) > 1 else None
