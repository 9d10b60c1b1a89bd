"""Something that is carried through the room of a scene until it is left standing somewhere."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix

from ...edits.scene_edit import Material, Placement, Primitive, Shape
from ...model.capture import Mesh
from ..scene_in.scene_capture import read_scene_mesh
from ..scene_out.placing import Room, add_object, corners_of, placement_matrix

SIZE = 0.3
"""Metres that a new shape is wide at first."""
SHAPES: dict[str, tuple[str, Shape, Material]] = {
    "MIRROR": ("Mirror Ball", "sphere", Material((0.95, 0.95, 0.95), roughness=0.0, metallic=1.0)),
    "GREY": ("Grey Ball", "sphere", Material((0.5, 0.5, 0.5), roughness=1.0, specular=0.0)),
    "BOX": ("White Box", "box", Material()),
    "CARD": ("Grey Card", "card", Material((0.18, 0.18, 0.18), roughness=1.0, specular=0.0)),
}
"""What can be made to be carried: name, shape and material by key."""


class Carried:
    """An object on its way, with all that hangs on it; whatever else renders is the room."""

    def __init__(self, thing: bpy.types.Object, context: bpy.types.Context) -> None:
        """Take up ``thing``; raises BadInput where there is nothing else that it could stand on."""
        self._thing, self._before = thing, thing.matrix_world.copy()
        self._made: list[bpy.types.Object] = []
        own = {thing, *thing.children_recursive}
        room = read_scene_mesh(
            context.evaluated_depsgraph_get(), [other for other in context.scene.objects if other not in own]
        )
        self._unit = float(context.scene.unit_settings.scale_length)
        self._room = Room(Mesh(room.mesh.vertices * self._unit, room.mesh.faces), (0.0, 0.0, 1.0))
        to_own = np.array(Matrix.Scale(self._unit, 4) @ self._before.inverted_safe())
        self._corners = corners_of(own) @ to_own[:3, :3].T + to_own[:3, 3]

    @classmethod
    def made(cls, key: str, context: bpy.types.Context) -> Carried:
        """A new one of :data:`SHAPES`; raises BadInput as above."""
        name, shape, material = SHAPES[key]
        size = SIZE / float(context.scene.unit_settings.scale_length)
        nowhere = Room(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), (0.0, 0.0, 1.0))
        primitive = Primitive(shape, (size, size, size), Placement(), material)
        made = add_object(primitive, name, nowhere, context.collection)
        context.view_layer.update()
        try:
            carried = cls(made[0], context)
        except BaseException:
            _remove(made)
            raise
        carried._made = made
        return carried

    def move(self, origin: Sequence[float], direction: Sequence[float], size: float, turn: float) -> None:
        """Stand it on the first surface along a line of sight, its +Z along the normal there.

        Args:
            size: factor on the size it had.
            turn: degrees about the normal.

        Raises:
            BadInput: there is no surface along the line.
        """
        x, y, z = (value * self._unit for value in origin)
        along = (direction[0], direction[1], direction[2])
        scale = self._before.to_scale() * size
        placed = Placement(
            scale=(scale.x, scale.y, scale.z), rotation=(0.0, 0.0, turn), snap="surface", ray=((x, y, z), along)
        )
        in_metres = placement_matrix(placed, self._room, self._corners)
        self._thing.matrix_world = Matrix.Scale(1 / self._unit, 4) @ in_metres @ Matrix.Scale(self._unit, 4)

    def leave(self, context: bpy.types.Context) -> None:
        """Let it stand, selected and active as what was just added to a scene is."""
        for thing in context.selected_objects:
            thing.select_set(False)
        self._thing.select_set(True)
        context.view_layer.objects.active = self._thing

    def take_back(self) -> None:
        """As if it had never been taken up."""
        self._thing.matrix_world = self._before
        _remove(self._made)
        self._made = []


def _remove(made: Sequence[bpy.types.Object]) -> None:
    """Objects that were made, with their meshes and materials."""
    meshes = [thing.data for thing in made if thing.type == "MESH"]
    materials = [material for mesh in meshes for material in mesh.materials]
    bpy.data.batch_remove([*made, *meshes, *materials])
