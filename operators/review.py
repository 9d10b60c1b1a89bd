"""Review a result: pictures of it, the response curve, the confidence in the viewport."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.apply.review import curve_image, review_image, reviewed_views, show_confidence
from ..iris_addon.blender.scene_in.capture_objects import photo_of, show_instead
from ..iris_addon.results.records import read_response
from .editors import show_in_editor, view_shadings
from .folders import folder
from .polls import NeedsResult


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
        try:
            if self.kind == "curve":
                image = curve_image(read_response(out)[0].samples)
            elif self.kind == "photo" and (current := _current_photo(settings)) is not None:
                camera, image = current
                show_instead(camera, None)
                settings.overlay = 1.0
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
        self.report({"INFO"}, image.name)
        return {"FINISHED"}

    def _show_in_view(self, settings: bpy.types.PropertyGroup, view: str, image: bpy.types.Image) -> None:
        index = settings.views.find(view)
        if index < 0 or settings.views[index].camera is None:
            return
        show_instead(settings.views[index].camera, None if self.kind == "photo" else image)
        settings.overlay = 1.0
        settings.view_index = index


def _current_photo(settings: bpy.types.PropertyGroup) -> tuple[bpy.types.Object, bpy.types.Image] | None:
    """Camera and image of the current photo, if both still exist."""
    camera = settings.views[settings.view_index].camera if settings.views else None
    image = None if camera is None else photo_of(camera)
    return None if image is None else (camera, image)


class IRIS_OT_confidence(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Show in the solid view how certain the textures are: white where many photos agree, black where none shows it"""

    bl_idname = "iris.confidence"
    bl_label = "Confidence"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    on: bpy.props.BoolProperty(default=True, options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Change the displayed texture; renders do not change."""
        if not show_confidence(list(context.scene.objects), self.on):
            self.report({"ERROR"}, "nothing is applied — apply the result first")
            return {"CANCELLED"}
        for shading in view_shadings(context):
            shading.type, shading.color_type = "SOLID", "TEXTURE"
            shading.light = "FLAT" if self.on else "STUDIO"
        return {"FINISHED"}
