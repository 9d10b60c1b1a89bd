"""The tab "IRIS" in the sidebar of the 3D view: one sub-panel per step, in work order, each with its state."""

from __future__ import annotations

from collections.abc import Callable

import bpy

from ...iris_addon.base.errors import IrisError
from ...iris_addon.blender.apply.camera_look import MATCHED
from ...iris_addon.blender.apply.looks import has_outside, is_solo
from ...iris_addon.blender.apply.on_objects import APPLIED
from ...iris_addon.blender.apply.review import model_sentences, shows_confidence
from ...iris_addon.blender.apply.suggested_photos import suggested_groups
from ...iris_addon.blender.insert.plate import shows_plate
from ...iris_addon.blender.render import light_mixing
from ...iris_addon.blender.scene_in.capture_objects import has_photo_to_fade
from ...iris_addon.blender.scene_out import lights as lamps
from ...iris_addon.blender.scene_out.lamp_profile_nodes import profile_of
from ...iris_addon.blender.scene_out.world import sky_strength
from ...iris_addon.blender.worker import jobs
from ...iris_addon.edits.light_units import kelvin
from ...iris_addon.model.seen_classes import SEEN_CLASSES
from ...iris_addon.results.files import REPORT_PAGE, lamp_picture
from ..folders import ROOT_PACKAGE, folder, result_key, solver_python
from ..relight import BEFORE_PREVIEW, chosen_lamp, lamp_flux, other_lights
from ..review import shown_kinds
from . import steps
from .icons import picture, swatch
from .photo_list import draw_list
from .relight_rows import look_rows, scale_rows, wipe_row
from .steps import ICONS, Step
from .widgets import job_box, paragraph, preview_box, sentence

UNSURE = 0.2
"""Lamps of lower confidence are folded away."""

WORDS = ("stale", "running", "failed")
"""States that the heading of a step says in a word; the icon says the others."""

StepOf = Callable[[bpy.types.Scene], Step]


class _Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "IRIS"


class IRIS_PT_iris(_Sidebar, bpy.types.Panel):  # noqa: N801 - Blender's naming
    """The parent of the steps; shows which one is next."""

    bl_label = "IRIS"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the next thing to do."""
        layout = self.layout
        if not context.scene.iris.views:
            layout.operator("iris.open_demo", icon="HOME")
        name, step = steps.current(context.scene)
        if name in ("data", "check", "solve") and not solver_python(context):
            box = layout.box()
            box.label(text="The solver needs a Python of its own", icon="ERROR")
            opened = box.operator("preferences.addon_show", text="Open Preferences", icon="PREFERENCES")
            opened.module = ROOT_PACKAGE
        if step.state != "done":
            paragraph(layout, f"{name.capitalize()}: {step.hint or step.state}", context, "FORWARD")
            return
        layout.label(text="Relight, insert or export", icon="CHECKMARK")


class _Step(_Sidebar):
    """A section whose heading folds it; which one is open follows from the work (:mod:`.steps`)."""

    bl_parent_id = "IRIS_PT_iris"
    bl_options = {"HIDE_HEADER"}  # noqa: RUF012 - Blender's form
    section: str
    step: StepOf

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the heading with the state as an icon and, while it matters, a word; and the section if it is open."""
        state = type(self).step(context.scene).state
        layout = self.layout  # type: ignore[attr-defined]
        header, body = layout.panel_prop(context.scene.iris, f"open_{self.section}")
        header.label(text=self.bl_label, icon=ICONS[state])  # type: ignore[attr-defined]
        word = header.row()
        word.alignment, word.active = "RIGHT", False
        if self.section == "check" and context.scene.iris.warnings:
            word.label(text="", icon="ERROR")
        if state in WORDS:
            word.label(text=state)
        if body is not None:
            self.draw_section(body, context)

    def draw_section(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        """Draw what stands under the heading."""
        raise NotImplementedError


class IRIS_PT_data(_Step, bpy.types.Panel):  # noqa: N801 - Blender's naming
    """Import of photos, poses and mesh."""

    bl_label = "Data"
    section = "data"
    step = staticmethod(steps.data_step)

    def draw_section(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        """Draw import buttons, and a summary of what was imported."""
        settings = context.scene.iris
        column = layout.column(align=True)
        column.operator("iris.import_capture", icon="IMPORT")
        column.operator("iris.use_scene", icon="CAMERA_DATA")
        column.operator("iris.import_demo", icon="HOME")
        if settings.views:
            known = sum(view.exposure > 0 for view in settings.views)
            exposures = {0: "estimated", len(settings.views): "all known"}.get(
                known, f"{known} known, all are estimated"
            )
            column = layout.column(align=True)
            paragraph(column, f"{len(settings.views)} photos; exposures: {exposures}", context)
            if settings.room is not None:
                column.label(text=f"{len(settings.room.data.polygons)} faces in {settings.room.name}")
            if settings.source == "CAPTURE":
                shown = layout.row()
                shown.enabled = False
                shown.prop(settings, "capture", text="")
        if settings.source == "CAPTURE":
            layout.prop(settings, "metres_per_unit")
        camera = context.scene.camera
        if settings.source == "SCENE" and camera is not None and camera.type == "CAMERA":
            layout.prop(camera.data, "iris_exposure", text=f"Exposure of {camera.name}")
            layout.prop(camera.data, "iris_light_state")
        layout.prop(settings, "result")


class IRIS_PT_check(_Step, bpy.types.Panel):  # noqa: N801 - Blender's naming
    """Photo over mesh, and measurements."""

    bl_label = "Check"
    section = "check"
    step = staticmethod(steps.check_step)

    def draw_section(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        """Draw the current photo, the list of all, and warnings."""
        settings = context.scene.iris
        job_box(layout, "inspect", context)
        if not settings.views:
            return
        row = layout.row(align=True)
        row.operator("iris.step_photo", text="", icon="TRIA_LEFT").by = -1
        index = min(settings.view_index, len(settings.views) - 1)
        row.operator("iris.step_photo", text=f"{settings.views[index].name}  {index + 1}/{len(settings.views)}").by = 0
        row.operator("iris.step_photo", text="", icon="TRIA_RIGHT").by = 1
        row = layout.row(align=True)
        photo, camera = row.row(align=True), settings.views[index].camera
        photo.enabled = camera is not None and has_photo_to_fade(camera)
        photo.prop(settings, "overlay", slider=True)
        row.prop(settings, "all_cameras", text="", icon="OUTLINER_OB_CAMERA")
        draw_list(layout, settings)
        view = settings.views[index]
        if view.problem:
            paragraph(layout, f"{view.name}: {view.problem}", context, "ERROR")
        column = layout.column(align=True)
        fits = {"aligned": "coincides with the mesh", "unclear": "too few common edges to decide"}
        column.label(text=f"Fit {view.score:.2f}: " + fits.get(view.verdict, f"{view.shift:.0f} px off the mesh"))
        exposure = f"{view.exposure:.3g}" if view.exposure else "unknown"
        column.label(text=f"Clipped {view.saturated:.0%}, exposure {exposure}")
        column.label(text=view.histogram)
        column.label(text=f"Mesh in {view.seen:.0%} of the picture")
        for warning in settings.warnings.splitlines():
            paragraph(layout, warning, context, "ERROR")
        layout.operator("iris.check", icon="FILE_REFRESH")


class IRIS_PT_solve(_Step, bpy.types.Panel):  # noqa: N801 - Blender's naming
    """Preset, solve, progress."""

    bl_label = "Solve"
    section = "solve"
    step = staticmethod(steps.solve_step)

    def draw_section(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        """Draw the settings, and progress while a solve runs."""
        settings = context.scene.iris
        running = jobs.running("solve", folder(context.scene)) is not None
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.enabled = not running
        column.prop(settings, "preset")
        column.prop(settings, "atlas_size")
        column.prop(settings, "texels_per_metre", text="Texels/m")
        for name in ("device", "seed"):
            column.prop(settings, name)
        if not running:
            layout.label(text=steps.textures_line(settings), icon="TEXTURE")
        if not running:
            state = steps.solve_step(context.scene).state
            record = jobs.record("solve", folder(context.scene))
            again = {"done": "Solve Again", "stale": "Solve Again"}.get(state, "Solve")
            text = "Resume" if record.state in ("cancelled", "interrupted", "failed") else again
            column.operator("iris.solve", text=text, icon="PLAY")
        job_box(layout, "solve", context)
        if not running and (line := steps.solved_line(folder(context.scene))):
            column = layout.column(align=True)
            column.label(text=line, icon="CHECKMARK")
            if line := steps.atlas_line(folder(context.scene)):
                column.label(text=line, icon="BLANK1")
        if running:
            preview_box(layout, context)


class IRIS_PT_review(_Step, bpy.types.Panel):  # noqa: N801 - Blender's naming
    """Review of the result, before it is applied to the objects."""

    bl_label = "Review"
    section = "review"
    step = staticmethod(steps.review_step)

    def draw_section(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        """Draw Apply, buttons for pictures and the figures of the model; what undoes an applied result at any time."""
        scene = context.scene
        if not result_key(scene):
            layout.label(text="No result yet", icon="INFO")
        else:
            grid = layout.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
            seen = shown_kinds(context)
            for kind, text in (("photo", "Photo"), ("render", "Re-render"), ("error", "Error"), ("curve", "Response")):
                grid.operator("iris.review", text=text, depress=kind in seen).kind = kind
            wipe_row(layout, scene)
            layout.operator("iris.apply", icon="MATERIAL")
        if APPLIED in scene:
            _seen_map(layout, scene)
            layout.operator("iris.restore", icon="LOOP_BACK")
        if result_key(scene):
            _figures(layout, context)


def _seen_map(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Draw the switch of the map of what was seen, its legend, and that of the suggested photos."""
    shown, suggested = shows_confidence(), bool(suggested_groups(scene))
    column = layout.column(align=True)
    column.operator("iris.confidence", text="Show Confidence", icon="HIDE_OFF", depress=shown).on = not shown
    if shown:
        legend = column.row(align=True)
        for seen in reversed(SEEN_CLASSES):
            legend.label(text=seen.name, icon_value=swatch(seen.color))
    text = "More Photos From Here" if suggested else "Where to Take More Photos"
    column.operator("iris.next_photos", text=text, icon="OUTLINER_OB_CAMERA", depress=suggested).on = not suggested


def _figures(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the warnings of the report, what it says of the model in words, and a button that opens it."""
    try:
        report = steps.report_of(folder(context.scene))
    except IrisError as error:
        paragraph(layout, str(error), context, "ERROR")
        return
    for warning in report.get("warnings") or ():
        paragraph(layout, sentence(str(warning)), context, "ERROR")
    header, body = layout.panel("IRIS_PT_model", default_closed=True)
    psnr = report.get("holdout_psnr")
    header.label(text="Model" if psnr is None else f"Model: {psnr:.1f} dB on held-out pixels")
    if body is not None:
        for text in model_sentences(report):
            paragraph(body, text, context)
        page = folder(context.scene) / REPORT_PAGE
        if page.is_file():
            body.operator("wm.url_open", text="Open Report", icon="URL").url = page.as_uri()


class IRIS_PT_relight(_Step, bpy.types.Panel):  # noqa: N801 - Blender's naming
    """The recovered lamps."""

    bl_label = "Relight"
    section = "relight"
    step = staticmethod(steps.relight_step)

    def draw_section(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        """Draw looks, the lamps with switch, color and strength, and how renders are shown."""
        scene = context.scene
        settings = scene.iris
        if APPLIED not in scene:
            layout.label(text="Apply a result first", icon="INFO")
            return
        shown = context.space_data.shading.type == "RENDERED" and BEFORE_PREVIEW in context.screen
        layout.operator("iris.preview", icon="SHADING_RENDERED", depress=shown)
        wipe_row(layout, scene)
        look_rows(layout, context)
        if settings.lamps:
            layout.template_list("IRIS_UL_lamps", "", settings, "lamps", settings, "lamp_index", rows=4)
            _chosen_lamp(layout, scene)
            scale_rows(layout, context)
        else:
            paragraph(layout, "No lamp was recovered", context, "INFO")
        outside = sky_strength(scene.world)
        if not has_outside(scene):
            text = "No light from outside was recovered; a window that shines is a lamp"
            paragraph(layout, text, context, "INFO")
        elif outside is not None:
            layout.prop(outside, "default_value", text="Light from Outside")
        sun = next((thing for thing in scene.objects if lamps.is_recovered_sun(thing)), None)
        if sun is not None:
            row = layout.row(align=True)
            row.prop(sun, "hide_render", text="")
            row.label(text="Sun")
            row.prop(sun.data, "color", text="")
            row.prop(sun.data, "energy", text="")
            layout.prop(sun, "rotation_euler", text="Sun's Direction")
        lights = [thing.name for thing in other_lights(scene)]
        if lights:
            row = layout.row()
            row.label(text=f"{lights[0]}{' and others shine' if lights[1:] else ' shines'} as well", icon="LIGHT")
            row.operator("iris.hide_lights", text="Hide")
        matched = MATCHED in scene
        text = "Renders Match the Photo" if matched else "Match Photo"
        layout.operator("iris.match_photo", text=text, icon="CAMERA_DATA", depress=matched).on = not matched
        _mixing(layout, scene)


def _chosen_lamp(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Draw what the chosen lamp is: its share of the light or its lumens, kelvin, watts, area and confidence."""
    lamp, settings = chosen_lamp(scene), scene.iris
    unsure = sum(other.confidence < UNSURE for other in settings.lamps)
    if unsure:
        layout.prop(settings, "show_unsure", text=f"Show {unsure} Unsure Lamps")
    if lamp is None:
        return
    shown = lamp_icon(lamp)
    if shown:
        layout.template_icon(shown, scale=4.0)
    row = layout.row(align=True)
    row.prop(lamp.material, "name", text="")
    row.operator("iris.solo", depress=is_solo(scene, lamp.material))
    if lamps.camera_only_mode(lamp.material):
        text = "A Light Shines for It"
        layout.operator("iris.area_lamp", text=text, icon="LIGHT_AREA", depress=True).on = False
    else:
        split = layout.split(factor=0.36, align=True)
        split.label(text="Replace by")
        row = split.row(align=True)
        for kind, text in (("AREA", "Area"), ("POINT", "Bulb"), ("IES", "IES")):
            row.operator("iris.area_lamp", text=text).kind = kind
    own, scale = lamp_flux(lamp), settings.lumens_per_unit
    total = max(sum(lamp_flux(other) for other in settings.lamps), 1e-12)
    share = f"{scale * own:.0f} lm" if scale else f"{own / total:.0%} of the light"
    temperature = kelvin(lamp.color)
    tint = "" if temperature is None else f", {round(temperature, -1):.0f} K"
    split = layout.split(factor=0.6, align=True)
    split.label(text=f"{share}{tint}")
    split.prop(lamp, "watts", text="")
    layout.label(text=f"{lamp.area:.2g} m², {lamp.confidence:.0%} sure")
    profile = profile_of(lamp.material)
    if profile is not None:
        layout.label(text=f"Beam of {profile.beam_angle:.0f}°", icon="LIGHT_SPOT")


def _mixing(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Draw the switch, and a slider and a color per light of the finished render."""
    node = light_mixing.mixer(scene)
    text = "Mix Lights" if node is None else "Lights Are Mixed"
    layout.operator("iris.mix_lights", text=text, icon="NODE_COMPOSITING", depress=node is not None).on = node is None
    if node is None:
        return
    column = layout.column(align=True)
    for name, strength, color in light_mixing.sliders(node):
        split = column.split(factor=0.5, align=True)
        split.label(text=name.removeprefix("IRIS "))
        row = split.row(align=True)
        row.prop(color, "default_value", text="")
        row.prop(strength, "default_value", text="")


def lamp_icon(lamp: bpy.types.PropertyGroup) -> int:
    """The icon of what a photo shows of ``lamp``; 0 where the result has no picture of it."""
    if lamp.material is None or lamps.LAMP_ID not in lamp.material:
        return 0
    return picture(lamp_picture(folder(lamp.id_data), lamp.material[lamps.LAMP_ID]))


class IRIS_UL_lamps(bpy.types.UIList):  # noqa: N801 - Blender's naming
    """Recovered lamps with switch, swatch and strength."""

    def draw_item(self, _context, layout, _data, item, _icon, _active, _name) -> None:  # noqa: ANN001 - Blender's
        """One lamp."""
        split = layout.split(factor=0.5, align=True)
        row = split.row(align=True)
        row.prop(item, "on", text="", icon="OUTLINER_OB_LIGHT" if item.on else "LIGHT", emboss=False)
        shown = lamp_icon(item)
        name = (item.name if item.material is None else item.material.name).removeprefix("IRIS ")
        row.label(text=name, icon_value=shown) if shown else row.label(text=name)
        row = split.row(align=True)
        if not lamps.is_plain(item.material):
            row.label(text="edited by hand")
            return
        row.active = item.on
        row.prop(item, "color", text="")
        row.prop(item, "strength", text="")

    def filter_items(self, _context, data, name) -> tuple[list[int], list[int]]:  # noqa: ANN001 - Blender's
        """Hide lamps of low confidence, unless they are to be listed, or are all there are."""
        items = getattr(data, name)
        sure = [data.show_unsure or item.confidence >= UNSURE for item in items]
        return [self.bitflag_filter_item if shown or not any(sure) else 0 for shown in sure], []


class IRIS_PT_insert(_Step, bpy.types.Panel):  # noqa: N801 - Blender's naming
    """Objects put into the room."""

    bl_label = "Insert"
    section = "insert"
    step = staticmethod(steps.relight_step)

    def draw_section(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        """Draw what can be placed, and the button that puts it onto the photo."""
        settings = context.scene.iris
        if APPLIED not in context.scene:
            layout.label(text="Apply a result first", icon="INFO")
            return
        row = layout.row(align=True)
        row.prop(settings, "placed", text="")
        row.operator("iris.place", text="Place", icon="MESH_UVSPHERE").thing = settings.placed
        if settings.views:
            name = settings.views[min(settings.view_index, len(settings.views) - 1)].name
            layout.operator("iris.onto_photo", text=f"Put Onto Photo {name}", icon="IMAGE_RGB_ALPHA")
            job_box(layout, "composite", context)
            wipe_row(layout, context.scene)
        if shows_plate(context.scene):
            layout.operator("iris.onto_plate", text="Put Onto Plate", icon="SEQUENCE")
            job_box(layout, "plate", context)
        if settings.views or shows_plate(context.scene):
            row = layout.row(align=True)
            row.prop(settings, "layers")
            spaces = row.row(align=True)
            spaces.active = settings.layers
            spaces.prop(settings, "acescg")
        layout.operator("iris.probe", icon="WORLD")
        job_box(layout, "probe", context)


class IRIS_PT_export(_Step, bpy.types.Panel):  # noqa: N801 - Blender's naming
    """The room as a file."""

    bl_label = "Export"
    section = "export"
    step = staticmethod(steps.export_step)

    def draw_section(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        """Draw a button per format."""
        row = layout.row(align=True)
        row.operator("iris.export", text=".blend").format = "BLEND"
        row.operator("iris.export", text=".glb").format = "GLB"
        usd = row.row(align=True)
        usd.enabled = bool(bpy.app.build_options.usd)
        usd.operator("iris.export", text=".usd").format = "USD"
        row.operator("iris.export", text="Textures").format = "TEXTURES"
        if not bpy.app.build_options.usd:
            paragraph(layout, "This Blender was built without USD", context, "INFO")
        row = layout.row(align=True)
        row.operator("iris.export", text="Light .glb", icon="MOD_DECIM").format = "LIGHT"
        row.operator("iris.export_ies", text="Lamps (.ies)", icon="LIGHT")
        layout.operator("iris.export_camera", icon="CAMERA_DATA")
        layout.operator("iris.export_farm", icon="NETWORK_DRIVE")
        job_box(layout, "farm", context)
