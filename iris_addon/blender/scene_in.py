"""A Blender scene as the solver's input: its mesh objects as one mesh with parts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import bpy
import numpy as np

from ..capture.types import Mesh
from ..errors import BadInput
from .backdrop import is_backdrop
from .onto_objects import FaceRun


@dataclass(frozen=True)
class SceneMesh:
    """The geometry of a scene as one mesh.

    Attributes:
        mesh: in Blender's units and axes; ``parts`` is set.
        part_names: "object / material" per part.
        runs: the faces of each object, in order.
    """

    mesh: Mesh
    part_names: list[str]
    runs: list[FaceRun]


def read_scene_mesh(depsgraph: bpy.types.Depsgraph, objects: Iterable[bpy.types.Object] | None = None) -> SceneMesh:
    """What Cycles would see of the scene's geometry: modifiers applied, instances real, in world space.

    Each pair of object and material slot is a part. Faces follow the order of the depsgraph's instances; UVs are those
    of the active render layer, kept only if every object has them.

    Args:
        objects: take these (and what they instance) instead of all that render.

    Raises:
        BadInput: there is no face.
    """
    wanted = None if objects is None else {thing.original for thing in objects}
    vertices, faces, uvs, parts, names, runs = [], [], [], [], [], []
    n_vertices = n_faces = 0
    for instance in depsgraph.object_instances:
        source = instance.parent if instance.is_instance else instance.object
        if not instance.show_self or (wanted is not None and source.original not in wanted):
            continue
        if is_backdrop(source.original):
            continue
        if instance.object.type not in {"MESH", "CURVE", "SURFACE", "META", "FONT"} or source.original.hide_render:
            continue
        evaluated = instance.object
        data = evaluated.to_mesh()
        if data is not None and len(data.loop_triangles):
            points, corners, uv, slot = _triangles(data)
            matrix = np.array(instance.matrix_world)
            points = points @ matrix[:3, :3].T + matrix[:3, 3]
            if np.linalg.det(matrix[:3, :3]) < 0:  # a mirrored instance keeps its outside
                corners, uv = corners[:, ::-1], None if uv is None else uv[:, ::-1]
            used, part = np.unique(slot, return_inverse=True)
            vertices.append(points)
            faces.append(corners + n_vertices)
            uvs.append(uv)
            parts.append(part.ravel() + len(names))
            names += [f"{source.name} / {_slot_name(evaluated, index)}" for index in used]
            runs.append(FaceRun(source.name, n_faces, n_faces + len(corners), instance.is_instance, matrix))
            n_vertices += len(points)
            n_faces += len(corners)
        evaluated.to_mesh_clear()
    if not faces:
        raise BadInput("the scene has no mesh that renders", "add the room's mesh, or enable it for renders")
    uv = None if any(layer is None for layer in uvs) else np.concatenate(uvs).astype(np.float32)
    mesh = Mesh(np.concatenate(vertices), np.concatenate(faces), uv, np.concatenate(parts).astype(np.int32))
    return SceneMesh(mesh, names, runs)


def _triangles(data: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:
    """Vertices (V, 3), triangles (F, 3), UV per corner (F, 3, 2) or None, and material slot (F,), in object space."""
    n = len(data.loop_triangles)
    points = np.empty(3 * len(data.vertices), np.float32)
    data.vertices.foreach_get("co", points)
    corners, loops, slot = np.empty(3 * n, np.int32), np.empty(3 * n, np.int32), np.empty(n, np.int32)
    data.loop_triangles.foreach_get("vertices", corners)
    data.loop_triangles.foreach_get("loops", loops)
    data.loop_triangles.foreach_get("material_index", slot)
    layer = next((layer for layer in data.uv_layers if layer.active_render), None)
    uv = None
    if layer is not None:
        flat = np.empty(2 * len(data.loops), np.float32)
        layer.uv.foreach_get("vector", flat)
        uv = flat.reshape(-1, 2)[loops].reshape(n, 3, 2)
    return points.reshape(-1, 3).astype(np.float64), corners.reshape(n, 3).astype(np.int64), uv, slot


def _slot_name(thing: bpy.types.Object, index: int) -> str:
    slots = thing.material_slots
    material = slots[index].material if index < len(slots) else None
    return material.name if material else "no material"
