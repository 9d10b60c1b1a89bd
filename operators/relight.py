"""Relight the room that is applied: looks, one lamp alone, and a preview in the 3D view."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.apply.looks import LOOKS, forget_look, own_looks, save_look, set_look, set_own_look, solo
from ..iris_addon.blender.apply.on_objects import MADE
from ..iris_addon.blender.apply.saved_looks import preset_names, read_preset, remove_preset, show_look, write_preset
from ..iris_addon.edits.light_units import flux
from .folders import look_presets
from .polls import NeedsApplied

PREVIEW_SAMPLES = 64
BEFORE_PREVIEW = "iris_before_preview"
"""Custom property of a screen with a preview: shading and overlays of its 3D view before it."""


class IRIS_OT_look(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Switch and dim all lamps and the light from outside"""

    bl_idname = "iris.look"
    bl_label = "Look"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    look: bpy.props.EnumProperty(name="Look", items=[(key, look.label, look.tooltip) for key, look in LOOKS.items()])

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """The tooltip is that of the look."""
        return LOOKS[properties.look].tooltip

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Set the look."""
        set_look(context.scene, self.look)
        return {"FINISHED"}


class IRIS_OT_save_look(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Keep how lamps, sun and light from outside are set now as a look of your own, in this file and as a preset for
    other rooms, in shares of what was recovered"""

    bl_idname = "iris.save_look"
    bl_label = "Save Look"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    name: bpy.props.StringProperty(name="Name", description="Of the look; one of that name is replaced", maxlen=40)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Ask for a name."""
        self.name = self.name or f"Look {len(own_looks(context.scene)) + 1}"
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Save the look."""
        if not self.name.strip():
            self.report({"ERROR"}, "the look has no name — give it one")
            return {"CANCELLED"}
        look = save_look(context.scene, self.name.strip())
        renew_wipe(context.scene)
        try:
            write_preset(look_presets(), self.name.strip(), look)
        except IrisError as error:
            self.report({"WARNING"}, f"the look is kept in this file alone: {error}")
        return {"FINISHED"}


class _OfOwnLook(NeedsApplied):
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    name: bpy.props.StringProperty(name="Name", description="Of the look")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Do it, where there is such a look."""
        if self.name not in all_looks(context.scene):
            self.report({"ERROR"}, f"there is no look {self.name!r} — save one first")
            return {"CANCELLED"}
        try:
            self.change(context.scene, self.name)  # type: ignore[attr-defined]
        except (IrisError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class IRIS_OT_own_look(_OfOwnLook, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Set lamps, sun and light from outside as they were when this look was saved, here or as a preset in
    another room, or in the photos of this light state"""

    bl_idname = "iris.own_look"
    bl_label = "Own Look"

    @staticmethod
    def change(scene: bpy.types.Scene, name: str) -> None:
        """Set what this file keeps, else the preset."""
        if name in own_looks(scene):
            set_own_look(scene, name)
        else:
            show_look(scene, read_preset(look_presets(), name))


class IRIS_OT_forget_look(_OfOwnLook, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Remove this look from this file and from the presets; the lights stay as they are"""

    bl_idname = "iris.forget_look"
    bl_label = "Remove Look"

    @staticmethod
    def change(scene: bpy.types.Scene, name: str) -> None:
        """Remove it in both places."""
        forget_look(scene, name)
        remove_preset(look_presets(), name)


class OfLamp(NeedsApplied):
    """Mixin of operators on the chosen lamp."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A result was applied, and a lamp is chosen."""
        return super().poll(context) and chosen_lamp(context.scene) is not None


class IRIS_OT_solo(OfLamp, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Switch all other lamps off; pressed again, all on"""

    bl_idname = "iris.solo"
    bl_label = "Solo"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Leave the chosen lamp alone."""
        lamp = chosen_lamp(context.scene)
        assert lamp is not None  # by poll
        solo(context.scene, lamp.material)
        return {"FINISHED"}


class IRIS_OT_hide_lights(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Hide the lights of this scene that are not the result's, in views and in renders"""

    bl_idname = "iris.hide_lights"
    bl_label = "Hide Other Lights"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Hide them."""
        for thing in other_lights(context.scene):
            thing.hide_viewport = thing.hide_render = True
        return {"FINISHED"}


class IRIS_OT_preview(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Render in this 3D view, denoised and without overlays; pressed again, back to how it was"""

    bl_idname = "iris.preview"
    bl_label = "Preview"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A result was applied, and this is a 3D view."""
        return super().poll(context) and context.area is not None and context.area.type == "VIEW_3D"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Change the shading of the view."""
        space, scene = context.area.spaces.active, context.scene
        before = context.screen.get(BEFORE_PREVIEW)
        if before is not None and space.shading.type == "RENDERED":
            space.shading.type, space.overlay.show_overlays = before[0], before[1] == "on"
            del context.screen[BEFORE_PREVIEW]
            return {"FINISHED"}
        context.screen[BEFORE_PREVIEW] = [space.shading.type, "on" if space.overlay.show_overlays else "off"]
        scene.render.engine = "CYCLES"
        scene.cycles.preview_samples = PREVIEW_SAMPLES
        scene.cycles.use_preview_denoising = True
        space.overlay.show_overlays = False
        space.shading.type = "RENDERED"
        return {"FINISHED"}


def chosen_lamp(scene: bpy.types.Scene) -> bpy.types.PropertyGroup | None:
    """The lamp that is chosen in the list, if its material still exists."""
    lamps = scene.iris.lamps
    lamp = lamps[scene.iris.lamp_index] if 0 <= scene.iris.lamp_index < len(lamps) else None
    return None if lamp is None or lamp.material is None else lamp


def all_looks(scene: bpy.types.Scene) -> list[str]:
    """Names of the looks that ``scene`` keeps, and of the presets."""
    return list(dict.fromkeys([*own_looks(scene), *preset_names(look_presets())]))


def renew_wipe(scene: bpy.types.Scene) -> None:
    """Make the picture of the look that a wipe goes to once more: what it is made of has changed."""
    if scene.iris.wipe_to:  # empty: a look that is gone
        scene.iris.wipe_to = str(scene.iris.wipe_to)


def lamp_flux(lamp: bpy.types.PropertyGroup) -> float:
    """Flux of a lamp of the list as it is set now, in the unit of the scene's radiance times square metre."""
    return flux([lamp.strength * channel for channel in lamp.color], lamp.area)


def set_scale(scene: bpy.types.Scene, lumens_per_unit: float, anchor: str) -> None:
    """Set the scale of all that is shown in units of light, and what it was taken from; 0 and "" forget it."""
    scene.iris.lumens_per_unit, scene.iris.scale_anchor = lumens_per_unit, anchor


def other_lights(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Lights that render and are not the result's."""
    return [thing for thing in scene.objects if thing.type == "LIGHT" and not thing.hide_render and MADE not in thing]
