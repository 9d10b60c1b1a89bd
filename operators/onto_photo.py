"""Composite the additions to the room onto the current photo, rendered by another Blender."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

from pathlib import Path

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.base.files import require_own_folder
from ..iris_addon.blender.apply.applied_states import light_state_of
from ..iris_addon.blender.apply.scene_files import write_whole
from ..iris_addon.blender.insert.photo_composite import write_copy
from ..iris_addon.blender.scene_in.capture_objects import photo_of, show_instead
from ..iris_addon.blender.worker import jobs
from ..iris_addon.blender.worker.jobs import CompositeOptions, composite_command
from .editors import fade_photos, look_at_photo, show_in_editor
from .folders import folder
from .polls import NeedsApplied
from .run_job import run_on_copy, scene_of


class IRIS_OT_onto_photo(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Composite what was added to the room, and changes of its lamps, onto the current photo. Another Blender renders
    it, so that this one stays free"""

    bl_idname = "iris.onto_photo"
    bl_label = "Onto Photo"

    samples: bpy.props.IntProperty(name="Samples", description="Paths per pixel", default=64, min=2, soft_max=1024)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A result is applied, there is a photo, and no such render runs."""
        if not super().poll(context):
            return False
        if not context.scene.iris.views:
            cls.poll_message_set("There are no photos in this scene")
            return False
        return jobs.running("composite", folder(context.scene)) is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write a copy of the scene and start the job."""
        scene, out = context.scene, folder(context.scene)
        view = scene.iris.views[scene.iris.view_index]
        camera = view.camera
        image = None if camera is None else photo_of(camera)
        if camera is None or image is None:
            self.report({"ERROR"}, f"{view.name} has no camera with a photo in this scene — check the capture again")
            return {"CANCELLED"}
        look_at_photo(context, scene.iris.view_index)
        copy, picture = out / "onto-photo.blend", out / "onto-photos" / f"{view.name}.png"
        name, view_name = scene.name, view.name
        file = Path(bpy.path.abspath(image.filepath, library=image.library))
        packed = image.packed_file is not None
        photo = copy.with_suffix(file.suffix) if packed else file
        options = CompositeOptions(
            samples=self.samples,
            light_state=light_state_of(camera, scene),
            layers=scene.iris.layers,
            acescg=scene.iris.acescg,
        )

        def prepare() -> list[str]:
            require_own_folder(picture.parent)
            write_copy(scene, copy)
            if packed:
                write_whole(photo, lambda part: part.write_bytes(image.packed_file.data))
            return composite_command(bpy.app.binary_path, copy, out, photo, view_name, picture, options)

        def show() -> None:
            shown = scene_of(name, out)
            if shown is not None:
                _show(shown, view_name, picture)

        return run_on_copy(self, "composite", copy, prepare, show, also=(photo,) if packed else ())


def _show(scene: bpy.types.Scene, view: str, picture: Path) -> None:
    """Show the finished picture over the view of the camera, and in the Image Editor if one is open."""
    try:
        image = bpy.data.images.load(str(picture), check_existing=True)
    except RuntimeError as error:
        raise IrisError(f"cannot be shown ({error})", "press Onto Photo again", picture) from error
    image.name = f"IRIS Onto {view}"
    image.reload()
    index = scene.iris.views.find(view)
    if index >= 0 and scene.iris.views[index].camera is not None:
        show_instead(scene.iris.views[index].camera, image)
        fade_photos(scene, 1.0)
    show_in_editor(bpy.context, "IMAGE_EDITOR", "image", image, only_open=True)
