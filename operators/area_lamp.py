"""Replace a recovered lamp by Blender's own light, a bulb or a photometric one, and put it back."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.apply.area_lamps import put_lamp_back, replace_lamp
from .relight import OfLamp, chosen_lamp
from .wait_cursor import wait_cursor

REPLACEMENTS = (
    (
        "AREA",
        "Area Light",
        "A light of the lamp's shape: an area light, two for two sides, a point for a ball",
    ),
    ("POINT", "Bulb", "A point light of 6 cm, or of the size of a ball, that shines alike in all directions"),
    ("IES", "IES Light", "A point that shines in each direction as the lamp does: its photometric file, in the .blend"),
)


class IRIS_OT_area_lamp(OfLamp, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Let a light of Blender of the same place, color and flux shine in place of the chosen lamp: less noise, settings
    of its own, and light linking. Cameras see the lamp as before; its row in the list leads the light. Pressed again,
    the lamp shines itself"""

    bl_idname = "iris.area_lamp"
    bl_label = "Replace Lamp by Light"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    on: bpy.props.BoolProperty(name="Replace", default=True, options={"SKIP_SAVE"})
    kind: bpy.props.EnumProperty(name="By", description="What shines for the lamp", items=REPLACEMENTS)

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """The tooltip, with what the button replaces the lamp by."""
        words = next(text for key, _, text in REPLACEMENTS if key == properties.kind)
        return f"{cls.__doc__}.\n{words}" if properties.on else cls.__doc__ or ""

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Replace the lamp, or put it back."""
        scene, lamp = context.scene, chosen_lamp(context.scene)
        assert lamp is not None  # by poll
        try:
            if not self.on:
                put_lamp_back(scene, lamp.material)
                return {"FINISHED"}
            eyes = [view.camera.matrix_world.translation for view in scene.iris.views if view.camera is not None]
            with wait_cursor(context):  # the first ray builds the search tree of the room
                lights, faithful = replace_lamp(scene, lamp.material, eyes, self.kind)
        except IrisError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if faithful:
            self.report({"INFO"}, f"{' and '.join(thing.name for thing in lights)} in place of {lamp.material.name}")
        else:
            other = "no ball" if self.kind == "POINT" else "neither flat nor a ball"
            self.report({"WARNING"}, f"{lamp.material.name} is {other}: its light is an approximation")
        return {"FINISHED"}
