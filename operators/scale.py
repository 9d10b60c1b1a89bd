"""The absolute scale of the room, which photos do not show: by a lamp's lumens, a light meter, or the photos' EXIF."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.apply.camera_look import LOOK, kept_look
from ..iris_addon.blender.apply.on_objects import APPLIED
from ..iris_addon.blender.images import read_image
from ..iris_addon.blender.insert.metering import box_area, meter_at, sunlight_at
from ..iris_addon.blender.insert.photo_composite import write_room_copy
from ..iris_addon.blender.scene_out.lights import RECOVERED
from ..iris_addon.blender.worker import jobs
from ..iris_addon.blender.worker.jobs import probe_command
from ..iris_addon.edits.light_units import flux, illuminance, metered_scale
from ..iris_addon.model.response import Response
from .folders import folder
from .polls import NeedsApplied
from .relight import OfLamp, chosen_lamp, lamp_flux, set_scale
from .run_job import run_on_copy

FAINT = 0.01
"""Of the light of all lamps per area of the room: a reading with less fixes no scale, because it hangs on noise."""
METER_WIDTH = 256
"""Pixels of the panorama that is rendered where the meter lay; the share of a lamp at its rim is that of the pixel."""


class IRIS_OT_anchor(OfLamp, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Give the lumens of this lamp as they stand on its box: those of all others follow, because photos show ratios"""

    bl_idname = "iris.anchor"
    bl_label = "Set Lumens"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    lumens: bpy.props.FloatProperty(name="Lumens", description="Of the whole lamp", default=800.0, min=1.0)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Ask for the lumens."""
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Set the scale of the scene's radiance."""
        lamp = chosen_lamp(context.scene)
        assert lamp is not None  # by poll
        emitted = lamp_flux(lamp)
        if emitted <= 0:
            self.report({"ERROR"}, f"{lamp.material.name} emits nothing — choose a lamp that shines")
            return {"CANCELLED"}
        set_scale(context.scene, self.lumens / emitted, f"{self.lumens:.0f} lm of {lamp.material.name}")
        return {"FINISHED"}


class IRIS_OT_meter(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Give what a light meter read on the surface at the 3D cursor, or on the first one below it, in the light of the
    photos: the lumens of all lamps follow. Another Blender renders the light that arrives there, in a few seconds"""

    bl_idname = "iris.meter"
    bl_label = "Set Lux at Cursor"

    lux: bpy.props.FloatProperty(
        name="Lux", description="What the meter read, flat on the surface", default=300.0, min=0.01
    )
    samples: bpy.props.IntProperty(name="Samples", description="Paths per pixel", default=16, min=2, soft_max=1024)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A result is applied, and no reading is being rendered."""
        return super().poll(context) and jobs.running("meter", folder(context.scene)) is None

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Ask for the reading."""
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write a copy of the scene in the light of the photos, and start the render."""
        scene, out = context.scene, folder(context.scene)
        copy, panorama = out / "meter.blend", out / "meter.exr"
        eyes = [view.camera.matrix_world.translation for view in scene.iris.views if view.camera is not None]
        try:
            at, normal = meter_at(scene, scene.cursor.location, eyes)
            sunlight = sunlight_at(scene, at, normal)
        except IrisError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        name, key, lux = scene.name, scene[APPLIED], self.lux

        def prepare() -> list[str]:
            write_room_copy(scene, copy)
            return probe_command(bpy.app.binary_path, copy, tuple(at), panorama, METER_WIDTH, self.samples)

        def anchor() -> None:
            # Another file, or another result, may be there by now. A file that was saved since may have another folder.
            shown = bpy.data.scenes.get(name)
            if shown is not None and shown.get(APPLIED) == key:
                _anchor_to_meter(shown, illuminance(read_image(panorama), tuple(normal)) + sunlight, lux)

        return run_on_copy(self, "meter", copy, prepare, anchor, also=(panorama,))


def _anchor_to_meter(scene: bpy.types.Scene, arriving: float, lux: float) -> None:
    emitted = sum(flux(lamp.material[RECOVERED], lamp.area) for lamp in scene.iris.lamps if lamp.material is not None)
    if arriving <= FAINT * emitted / max(box_area(scene), 1e-12):
        what = "hardly any light arrives at the 3D cursor, as inside of things and in corners"
        raise IrisError(what, "put the cursor where the meter lay, in the light")
    set_scale(scene, lux / arriving, f"{lux:.4g} lx at the cursor")


class IRIS_OT_exif_scale(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Take the scale from aperture, time and ISO of the photos: a camera exposes for a luminance of 12.5 N²/(t ISO)
    cd/m² (ISO 2720) and shows it at middle gray. That is good to half a stop, 40 %; phones that merge exposures may be
    further off"""

    bl_idname = "iris.exif_scale"
    bl_label = "Set by EXIF"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A result is applied, and some photo of it has all three."""
        if not super().poll(context):
            return False
        if not any(view.metered > 0 for view in context.scene.iris.views):
            cls.poll_message_set(
                "No photo has aperture, time and ISO in its EXIF; check the capture again if it should"
            )
            return False
        return LOOK in context.scene

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Average what the photos say."""
        photos = _metered_photos(context.scene)
        if not photos:
            self.report({"ERROR"}, "no photo of the solve has aperture, time and ISO — give lumens or lux instead")
            return {"CANCELLED"}
        scale, stops = metered_scale(photos)
        count = "1 photo" if len(photos) == 1 else f"{len(photos)} photos"
        set_scale(context.scene, scale, f"EXIF of {count}, ±{2**stops - 1:.0%}")
        return {"FINISHED"}


def _metered_photos(scene: bpy.types.Scene) -> list[tuple[Response, NDArray[np.floating], float]]:
    """Response, exposure and metered luminance of the photos that were solved and have one."""
    found = []
    for view in scene.iris.views:
        response, exposures = kept_look(scene, view.name)
        if view.metered > 0 and view.name in exposures and response.family != "identity":
            found.append((response, exposures[view.name], view.metered))
    return found


class IRIS_OT_forget_scale(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Forget the scale: lamps are shown in shares of the light again"""

    bl_idname = "iris.forget_scale"
    bl_label = "Forget Scale"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Forget it."""
        set_scale(context.scene, 0.0, "")
        return {"FINISHED"}
