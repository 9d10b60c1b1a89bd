"""Apply the result to the objects, and restore them."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.apply.looks import forget_states, keep_states
from ..iris_addon.blender.apply.on_objects import APPLIED, FaceRun, apply_steps, restore
from ..iris_addon.blender.apply.photo_cameras import move_to_solved_poses
from ..iris_addon.blender.images import read_pixels
from ..iris_addon.blender.scene_in.capture_objects import show_instead
from ..iris_addon.blender.scene_in.scene_capture import read_face_runs, whole_object
from ..iris_addon.blender.scene_out.lights import lamp_materials
from ..iris_addon.blender.scene_out.materials import LAMP_ID
from ..iris_addon.blender.stepwise import Steps, in_thread_asking
from ..iris_addon.edits.light_units import flux
from ..iris_addon.results.folder import ReadImage, load_result
from ..iris_addon.results.result import Result
from .editors import fade_photos, view_shadings
from .folders import folder, result_key
from .modal_steps import InSteps
from .polls import NeedsResult
from .relight import renew_wipe, set_scale


class IRIS_OT_apply(NeedsResult, InSteps, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Give the objects the recovered materials and lights; what they have now is kept and can be restored"""

    bl_idname = "iris.apply"
    bl_label = "Apply"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    def steps(self, context: bpy.types.Context) -> Steps[set[str]]:
        """Read the result, make meshes and materials of it, and give them to the objects."""
        scene, out, key = context.scene, folder(context.scene), result_key(context.scene)
        result = yield from load_steps(out)
        if not (yield from apply_steps(result, face_runs(scene), scene, key)):
            self.report({"INFO"}, "This result is applied already")
            return {"FINISHED"}
        list_lamps(scene, result)
        show_room(context)
        moved = move_to_solved_poses(result, capture_cameras(scene), scene)
        corrected = f", {moved} cameras moved to where the photos fit" if moved else ""
        self.report({"INFO"}, f"{len(result.emitters)} lights{corrected}")
        return {"FINISHED"}


class IRIS_OT_restore(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Restore the meshes, materials and modifiers of the objects, and the world and view settings of the scene"""

    bl_idname = "iris.restore"
    bl_label = "Restore Originals"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A result was applied."""
        return APPLIED in context.scene

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Restore the objects."""
        try:
            count = restore(context.scene)
        except IrisError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        context.scene.iris.lamps.clear()
        renew_wipe(context.scene)
        self.report({"INFO"}, f"Restored {count} objects")
        return {"FINISHED"}


def load_steps(folder: Path) -> Steps[Result]:
    """The result in ``folder``, read in a thread but for its images, which Blender reads; raises BadInput."""

    def load(read: ReadImage) -> Result:
        return load_result(folder, read_image=read)

    return in_thread_asking(load, read_pixels, "reading the files")


def face_runs(scene: bpy.types.Scene) -> list[FaceRun]:
    """Which faces of the result belong to which object of ``scene``; raises BadInput."""
    if scene.iris.source == "SCENE":
        return read_face_runs(folder(scene))
    return whole_object(scene.iris.room)


def capture_cameras(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """Perspective cameras of an imported capture by photo.

    Empty for Use This Scene, whose cameras belong to the user and stay where they are.
    """
    if scene.iris.source == "SCENE":
        return {}
    cameras = {view.name: view.camera for view in scene.iris.views if view.camera is not None}
    return {name: camera for name, camera in cameras.items() if camera.data.type == "PERSP"}


def show_room(context: bpy.types.Context) -> None:
    """Remove pictures from the views of the cameras, and show textures in solid views."""
    settings = context.scene.iris
    for view in settings.views:
        if view.camera is not None:
            show_instead(view.camera, None)
    fade_photos(context.scene, 0.0)
    for shading in view_shadings(context):
        if (shading.type, shading.color_type) == ("SOLID", "MATERIAL"):
            shading.color_type = "TEXTURE"


def list_lamps(scene: bpy.types.Scene, result: Result) -> None:
    """Fill the list of lamps from the materials of the scene, those that give most light first."""
    emitters = {emitter.id: emitter for emitter in result.emitters}
    shown = [(material, emitters.get(material[LAMP_ID])) for material in lamp_materials(scene.objects)]
    scene.iris.lamps.clear()
    for material, emitter in sorted(
        shown, key=lambda lamp: 0.0 if lamp[1] is None else -flux(lamp[1].radiance, lamp[1].area)
    ):
        item = scene.iris.lamps.add()
        item.name, item.material = material.name, material
        if emitter is not None:
            item.area, item.confidence = emitter.area, emitter.confidence
    scene.iris.lamp_index = 0
    set_scale(scene, 0.0, "")
    forget_states(scene)
    keep_states(scene, result)
    renew_wipe(scene)
