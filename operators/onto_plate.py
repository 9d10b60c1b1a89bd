"""Composite the additions to the room onto the plate of the tracked camera, frame by frame, by another Blender."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

from pathlib import Path

import bpy

from ..iris_addon.base.files import require_own_folder
from ..iris_addon.blender.apply.applied_states import has_light_states
from ..iris_addon.blender.insert.photo_composite import write_copy
from ..iris_addon.blender.insert.plate import shows_plate
from ..iris_addon.blender.worker import jobs
from ..iris_addon.blender.worker.jobs import CompositeOptions, plate_command
from .folders import folder
from .polls import NeedsApplied
from .run_job import run_on_copy


class IRIS_OT_onto_plate(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Composite what was added to the room onto every frame of the image sequence behind the scene's camera, which is
    tracked in this room. The exposure of each frame is found. Another Blender renders the frame range of the scene"""

    bl_idname = "iris.onto_plate"
    bl_label = "Onto Plate"

    directory: bpy.props.StringProperty(subtype="DIR_PATH")
    samples: bpy.props.IntProperty(name="Samples", description="Paths per pixel", default=64, min=2, soft_max=1024)
    light_state: bpy.props.StringProperty(
        name="Light State",
        description="That of the room in which the plate was filmed, one of those of its photos; empty for the first",
    )
    resume: bpy.props.BoolProperty(
        name="Keep Finished Frames", description="Go on after a stop. Frames that are there keep what they show"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A result is applied, the scene's camera shows a sequence, and no such render runs."""
        if not super().poll(context):
            return False
        if not shows_plate(context.scene):
            cls.poll_message_set(
                "The scene's camera has no movie clip, image sequence or movie as its background image"
            )
            return False
        return jobs.running("plate", folder(context.scene)) is None

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Ask for the folder of the frames."""
        self.directory = str(folder(context.scene) / "onto-plate")
        camera = context.scene.camera
        self.light_state = "" if camera is None or camera.type != "CAMERA" else camera.data.iris_light_state
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write a copy of the scene and start the job."""
        if not self.directory:
            self.report({"ERROR"}, "no folder is named — give the folder of the frames")
            return {"CANCELLED"}
        scene, result = context.scene, folder(context.scene)
        copy, frames = result / "onto-plate.blend", Path(bpy.path.abspath(self.directory)).absolute()
        wanted = f"{scene.frame_start}-{scene.frame_end}"
        state = self.light_state.strip() if has_light_states(scene) else ""
        options = CompositeOptions(
            samples=self.samples, light_state=state, layers=scene.iris.layers, acescg=scene.iris.acescg
        )

        def prepare() -> list[str]:
            require_own_folder(frames)
            write_copy(scene, copy)
            return plate_command(bpy.app.binary_path, copy, result, frames, wanted, options, resume=self.resume)

        return run_on_copy(self, "plate", copy, prepare)
