"""The faces of a lamp in a scene."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray


def lamp_triangles(scene: bpy.types.Scene, material: bpy.types.Material) -> NDArray[np.float64]:
    """(T, 3, 3) corners of the faces with ``material``, in the axes of the scene."""
    found = [np.zeros((0, 3, 3))]
    for thing in scene.objects:
        slots = [k for k, slot in enumerate(thing.material_slots) if slot.material == material]
        if thing.type != "MESH" or not slots:
            continue
        data, n = thing.data, len(thing.data.loop_triangles)
        slot, corners = np.zeros(n, np.int32), np.zeros(3 * n, np.int32)
        data.loop_triangles.foreach_get("material_index", slot)
        data.loop_triangles.foreach_get("vertices", corners)
        points = np.zeros(3 * len(data.vertices), np.float32)
        data.vertices.foreach_get("co", points)
        matrix = np.array(thing.matrix_world)
        used = corners.reshape(-1, 3)[np.isin(slot, slots)]
        found.append(points.reshape(-1, 3)[used] @ matrix[:3, :3].T + matrix[:3, 3])
    return np.concatenate(found).astype(np.float64)
