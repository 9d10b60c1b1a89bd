"""Pictures of all looks at once: the light of every source, rendered one time for the view of a photo."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy

from ..iris_addon.base.files import require_own_folder
from ..iris_addon.blender.insert.photo_composite import write_room_copy
from ..iris_addon.blender.worker import jobs
from ..iris_addon.blender.worker.jobs import looks_command
from .folders import folder
from .polls import NeedsApplied
from .run_job import run_on_copy, scene_of
from .ui.look_icons import shares_path, show_before


class IRIS_OT_look_pictures(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Show each look as this camera sees it. Another Blender renders the light of every lamp once; the pictures of all
    looks, also of those saved later, are sums of these. They are kept with the result"""

    bl_idname = "iris.look_pictures"
    bl_label = "Picture the Looks"

    width: bpy.props.IntProperty(
        name="Width", description="Of the pictures, pixels, at most", default=320, min=32, soft_max=1920
    )
    samples: bpy.props.IntProperty(name="Samples", description="Paths per pixel", default=16, min=2, soft_max=1024)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A result is applied, there is a camera, and no such render runs."""
        if not super().poll(context):
            return False
        if context.scene.camera is None:
            cls.poll_message_set("Look through a camera first")
            return False
        return jobs.running("looks", folder(context.scene)) is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write a copy of the room and start the render."""
        scene, out = context.scene, folder(context.scene)
        copy, shares = out / "looks.blend", shares_path(scene)
        name = scene.name

        def prepare() -> list[str]:
            require_own_folder(shares.parent)
            write_room_copy(scene, copy)
            return looks_command(bpy.app.binary_path, copy, shares, self.width, self.samples)

        def show() -> None:
            shown = scene_of(name, out)
            if shown is not None:
                show_before(shown)

        return run_on_copy(self, "looks", copy, prepare, show)
