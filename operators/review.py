"""Review a result: pictures of it, the response curve, the confidence in the viewport."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.apply.review import (
    CURVE_NAME,
    KIND,
    curve_image,
    review_image,
    reviewed_views,
    show_confidence,
)
from ..iris_addon.blender.apply.suggested_photos import forget_suggested, suggest_steps
from ..iris_addon.blender.camera import read_camera
from ..iris_addon.blender.images import read_pixels
from ..iris_addon.blender.scene_in.capture_objects import INSTEAD, background_of, photo_of, show_instead
from ..iris_addon.blender.stepwise import Steps, in_thread_asking
from ..iris_addon.model.capture import Mesh
from ..iris_addon.results.folder import ReadImage, read_coverage
from ..iris_addon.results.records import read_response
from .apply import face_runs
from .editors import fade_photos, is_in_editor, show_in_editor, view_shadings
from .folders import folder
from .modal_steps import InSteps
from .polls import NeedsApplied, NeedsResult


class IRIS_OT_review(NeedsResult, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Show this picture of the result over the camera's view, and in the Image Editor where one is open"""

    bl_idname = "iris.review"
    bl_label = "Review"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    kind: bpy.props.EnumProperty(
        items=(
            ("photo", "Photo", "The photo"),
            ("render", "Re-render", "What the result predicts for it"),
            ("error", "Error", "Four times the difference"),
            ("curve", "Response", "The recovered camera response"),
        )
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Load the picture and show it."""
        settings, out = context.scene.iris, folder(context.scene)
        said = ""
        try:
            if self.kind == "curve":
                photo = settings.views[settings.view_index].name if settings.views else ""
                device = read_response(out).device_of(photo)
                image = curve_image(device.response.samples)
                said = f"Response of {device.name}" if device.name else ""
            elif self.kind == "photo" and (current := _current_photo(settings)) is not None:
                camera, image = current
                show_instead(camera, None)
                fade_photos(context.scene, 1.0)
                settings.view_index = settings.view_index  # looks through its camera, as the other pictures do
            else:
                shown = reviewed_views(out)
                name = settings.views[settings.view_index].name if settings.views else ""
                # The report compares a few photos: the current one if it is among them, else the next.
                view = name if name in shown or not shown else min(shown, key=lambda other: (other < name, other))
                image = review_image(out, view, self.kind)
                self._show_in_view(settings, view, image)
        except IrisError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        # The curve belongs to no view and needs an editor; pictures use one only if it is open.
        show_in_editor(context, "IMAGE_EDITOR", "image", image, only_open=self.kind != "curve")
        self.report({"INFO"}, said or image.name)
        return {"FINISHED"}

    def _show_in_view(self, settings: bpy.types.PropertyGroup, view: str, image: bpy.types.Image) -> None:
        index = settings.views.find(view)
        if index < 0 or settings.views[index].camera is None:
            return
        show_instead(settings.views[index].camera, None if self.kind == "photo" else image)
        fade_photos(settings.id_data, 1.0)
        settings.view_index = index


def _current_photo(settings: bpy.types.PropertyGroup) -> tuple[bpy.types.Object, bpy.types.Image] | None:
    """Camera and image of the current photo, if both still exist."""
    camera = settings.views[settings.view_index].camera if settings.views else None
    image = None if camera is None else photo_of(camera)
    return None if image is None else (camera, image)


def shown_kinds(context: bpy.types.Context) -> set[str]:
    """Which pictures of :class:`IRIS_OT_review` are seen: one over this 3D view, and the curve in an editor."""
    curve = bpy.data.images.get(CURVE_NAME)
    kinds = {"curve"} if curve is not None and is_in_editor(context, "IMAGE_EDITOR", "image", curve) else set()
    settings, view = context.scene.iris, getattr(context.space_data, "region_3d", None)
    camera = settings.views[settings.view_index].camera if settings.views else None
    if camera is None or camera != context.scene.camera or view is None or view.view_perspective != "CAMERA":
        return kinds
    behind, instead = background_of(camera), camera.data.get(INSTEAD)
    if instead is not None:
        return kinds | {instead.get(KIND, "")} - {""}
    seen = behind is not None and behind.show_background_image and behind.alpha > 0
    return kinds | {"photo"} if seen else kinds


class IRIS_OT_confidence(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Show in the solid view how often photos show each place: often, seldom, or never, so that it was filled in"""

    bl_idname = "iris.confidence"
    bl_label = "Confidence"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    on: bpy.props.BoolProperty(name="Show", description="Show the map, or the room", default=True, options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Change the displayed texture; renders do not change."""
        if not show_confidence(list(context.scene.objects), self.on):
            self.report({"ERROR"}, "nothing is applied — apply the result first")
            return {"CANCELLED"}
        for shading in view_shadings(context):
            shading.type, shading.color_type = "SOLID", "TEXTURE"
            shading.light = "FLAT" if self.on else "STUDIO"
        return {"FINISHED"}


class IRIS_OT_next_photos(NeedsApplied, InSteps, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Place up to five cameras in the room, from where one sees most of what the photos show seldom or never. Take
    photos there, and solve again. Pressed again, the cameras go"""

    bl_idname = "iris.next_photos"
    bl_label = "Where to Take More Photos"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    on: bpy.props.BoolProperty(
        name="Show", description="Place the cameras, or remove them", default=True, options={"SKIP_SAVE"}
    )

    def steps(self, context: bpy.types.Context) -> Steps[set[str]]:
        """Place the cameras, or remove them."""
        scene, out = context.scene, folder(context.scene)
        if not self.on:
            forget_suggested(scene)
            return {"FINISHED"}
        taken = [read_camera(scene, view.camera) for view in scene.iris.views if view.camera is not None]

        def read(read_image: ReadImage) -> tuple[Mesh, NDArray[np.float32], tuple[float, float, float]]:
            return read_coverage(out, read_image)

        room = yield from in_thread_asking(read, read_pixels, "reading the files")
        found = yield from suggest_steps(room, face_runs(scene), scene, taken)
        if not found:
            self.report({"INFO"}, "The photos show all that can be seen from where people stand")
            return {"CANCELLED"}
        share = sum(photo.share for photo in found)
        photos = "1 photo" if len(found) == 1 else f"{len(found)} photos"
        self.report({"INFO"}, f"{photos} would show {share:.0%} of what is badly seen")
        return {"FINISHED"}
