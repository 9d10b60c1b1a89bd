"""An object that follows the mouse through the room of a scene until it is dropped on a surface."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix

from ...edits.scene_edit import Material, Placement, Primitive, Shape
from ...model.capture import Mesh
from ..scene_in.scene_capture import read_scene_mesh
from ..scene_out.placing import Room, add_object, corners_of, placement_matrix
from ..stepwise import Steps

SIZE = 0.3
"""Initial width of a new shape, metres."""
SHAPES: dict[str, tuple[str, Shape, Material]] = {
    "MIRROR": ("Mirror Ball", "sphere", Material((0.95, 0.95, 0.95), roughness=0.0, metallic=1.0)),
    "GREY": ("Gray Ball", "sphere", Material((0.5, 0.5, 0.5), roughness=1.0, specular=0.0)),
    "BOX": ("White Box", "box", Material()),
    "CARD": ("Gray Card", "card", Material((0.18, 0.18, 0.18), roughness=1.0, specular=0.0)),
}
"""New shapes that can be placed: name, shape and material by key."""


class DraggedObject:
    """An object on its way, with its children; whatever else renders is the room it is placed in."""

    def __init__(self, thing: bpy.types.Object, room: Room, unit: float, made: Sequence[bpy.types.Object] = ()) -> None:
        """``thing`` on its way through ``room``.

        Args:
            room: in metres.
            unit: metres per unit of the scene.
            made: objects that :meth:`cancel` removes.
        """
        self._thing, self._before, self._made = thing, thing.matrix_world.copy(), list(made)
        self._room, self._unit = room, unit
        to_own = np.array(Matrix.Scale(unit, 4) @ self._before.inverted_safe())
        own = {thing, *thing.children_recursive}
        self._corners = corners_of(own) @ to_own[:3, :3].T + to_own[:3, 3]

    @classmethod
    def pick_up(
        cls, thing: bpy.types.Object, context: bpy.types.Context, made: Sequence[bpy.types.Object] = ()
    ) -> Steps[DraggedObject]:
        """Pick up ``thing``; ``made`` are objects that :meth:`cancel` removes.

        Raises:
            BadInput: the scene has no surface on which it could stand.
        """
        own = {thing, *thing.children_recursive}
        others = [other for other in context.scene.objects if other not in own]
        seen = read_scene_mesh(context.evaluated_depsgraph_get(), others)
        unit = float(context.scene.unit_settings.scale_length)
        room = Room(Mesh(seen.mesh.vertices * unit, seen.mesh.faces), (0.0, 0.0, 1.0))
        yield from room.search_trees()
        return cls(thing, room, unit, made)

    @classmethod
    def from_shape(cls, key: str, context: bpy.types.Context) -> Steps[DraggedObject]:
        """Pick up a new object of :data:`SHAPES`; raises BadInput as :meth:`pick_up` does."""
        name, shape, material = SHAPES[key]
        size = SIZE / float(context.scene.unit_settings.scale_length)
        empty = Room(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), (0.0, 0.0, 1.0))
        primitive = Primitive(shape, (size, size, size), Placement(), material)
        made = add_object(primitive, name, empty, context.collection)
        context.view_layer.update()
        try:
            return (yield from cls.pick_up(made[0], context, made))
        except BaseException:
            _remove(made)
            raise

    def move(self, origin: Sequence[float], direction: Sequence[float], size: float, turn: float) -> None:
        """Place it on the first surface along a line of sight, with its +Z along the normal there.

        Args:
            origin, direction: of the line of sight, in world space and the scene's units.
            size: factor on its original size.
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

    def drop(self, context: bpy.types.Context) -> None:
        """Leave it where it is, selected and active like any newly added object."""
        for thing in context.selected_objects:
            thing.select_set(False)
        self._thing.select_set(True)
        context.view_layer.objects.active = self._thing

    def cancel(self) -> None:
        """Put it back where it was, or remove it if it was made for this."""
        self._thing.matrix_world = self._before
        _remove(self._made)
        self._made = []


def _remove(made: Sequence[bpy.types.Object]) -> None:
    """Remove objects with their meshes and materials."""
    meshes = [thing.data for thing in made if thing.type == "MESH"]
    materials = [material for mesh in meshes for material in mesh.materials]
    bpy.data.batch_remove([*made, *meshes, *materials])
