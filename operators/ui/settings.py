"""Settings stored in a scene: its capture, how to solve it, the photos and the recovered lamps."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from ...iris_addon.blender.scene_in.capture_objects import fade_photo
from ...iris_addon.blender.scene_out import lights as lamps
from ...iris_addon.edits.light_units import LUMENS_PER_WATT, area_light_energy
from ...iris_addon.model.texture_size import HIGHEST_DENSITY, blender_bytes, in_blender
from ..editors import look_at_photo, redraw_views, show_cameras
from ..place import PLACEABLE
from . import steps
from .lamp_highlight import highlight
from .look_icons import look_choices, show_before
from .wipe import PHOTO

ATLAS_SIZES = (
    ("auto", "Auto", "As many as the photos resolve, up to the limit of the preset"),
    *((str(side), str(side), f"{in_blender(side)} of Blender's memory") for side in (1024, 2048, 4096, 8192)),
)

# ---- callbacks -----------------------------------------------------------------------------------------------------


def _get(read: Callable[[bpy.types.Material | None], Any]) -> Callable[[bpy.types.PropertyGroup], Any]:
    return lambda lamp: read(lamp.material)


def _set(write: Callable[[bpy.types.Material | None, Any], None]) -> Callable[[bpy.types.PropertyGroup, Any], None]:
    return lambda lamp, value: write(lamp.material, value)


def _watts(lamp: bpy.types.PropertyGroup) -> float:
    scale = lamp.id_data.iris.lumens_per_unit
    unit = scale / LUMENS_PER_WATT if scale else 1.0
    return unit * lamps.strength(lamp.material) * area_light_energy(lamp.area)


def _look(settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    look_at_photo(context, settings.view_index)
    if settings.wipe_to not in ("", PHOTO):
        show_before(settings.id_data)


def _show_cameras(_settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    show_cameras(context)


def _show_lamp(settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    if 0 <= settings.lamp_index < len(settings.lamps) and settings.lamps[settings.lamp_index].material is not None:
        highlight(context.scene, settings.lamps[settings.lamp_index].material)


def _redraw(_settings: bpy.types.PropertyGroup, _context: bpy.types.Context) -> None:
    redraw_views()


def _wipe_to(settings: bpy.types.PropertyGroup, _context: bpy.types.Context) -> None:
    show_before(settings.id_data)
    redraw_views()


def _set_overlay(settings: bpy.types.PropertyGroup, _context: bpy.types.Context) -> None:
    for view in settings.views:
        if view.camera is not None:
            fade_photo(view.camera, settings.overlay)


def _open(section: str) -> bpy.props.BoolProperty:
    """Whether a section of the sidebar is unfolded."""
    return bpy.props.BoolProperty(
        name=section.capitalize(),
        description="Fold or unfold this section",
        get=lambda settings: steps.is_open(settings.id_data, section),
        set=lambda settings, value: steps.set_open(settings.id_data, section, value),
        options={"SKIP_SAVE"},
    )


EXPOSURE = bpy.props.FloatProperty(
    name="Exposure",
    description="Relative exposure of this camera's photo, time · ISO/100 / f-number²; 0 where it is unknown",
    min=0.0,
)


LIGHT_STATE = bpy.props.StringProperty(
    name="Light State",
    description="Name of the set of lamps that are on in this camera's photo; empty where it is the same in all photos",
    maxlen=40,
)


# ---- properties -----------------------------------------------------------------------------------------------------


class IrisView(bpy.types.PropertyGroup):
    """The check of one photo; ``name`` is that of the view."""

    use: bpy.props.BoolProperty(name="Use", description="Solve with this photo, or leave it out", default=True)
    problem: bpy.props.StringProperty(
        name="Problem", description="Why the photo should be looked at; empty where it need not be"
    )
    camera: bpy.props.PointerProperty(
        type=bpy.types.Object,
        name="Camera",
        description="Where the photo was taken; it has the photo as its background",
    )
    aspect: bpy.props.FloatProperty(name="Pixel aspect", description="Focal length along x over along y", default=1)
    exposure: bpy.props.FloatProperty(name="Exposure", description="Relative exposure; 0 where it is unknown", min=0.0)
    metered: bpy.props.FloatProperty(
        name="Metered Luminance",
        description="Luminance that the photo was exposed for by its EXIF, candela per square meter; 0: unknown",
        min=0.0,
    )
    saturated: bpy.props.FloatProperty(
        name="Clipped", description="Share of clipped pixels, at the upper end of the display range", min=0, max=1
    )
    histogram: bpy.props.StringProperty(name="Histogram", description="Display values from black to clipped")
    seen: bpy.props.FloatProperty(
        name="Mesh in view", description="Share of the picture in which the mesh is seen", min=0, max=1
    )
    score: bpy.props.FloatProperty(name="Fit", description="Correlation of the photo's edges with the mesh's")
    shift: bpy.props.FloatProperty(name="Shift", description="Offset of the photo from the mesh, pixels")
    verdict: bpy.props.EnumProperty(
        name="Verdict",
        description="Whether the photo lies on the mesh",
        items=(
            ("aligned", "Aligned", "Edges of photo and mesh coincide"),
            ("shifted", "Shifted", "Edges of photo and mesh are offset"),
            ("unclear", "Unclear", "Too few common edges to decide: look at the overlay"),
        ),
        default="unclear",
    )


class IrisLamp(bpy.types.PropertyGroup):
    """A recovered lamp; reads and writes the values of its material."""

    material: bpy.props.PointerProperty(
        type=bpy.types.Material, name="Material", description="The emissive material of the lamp's faces"
    )
    area: bpy.props.FloatProperty(name="Area", description="Surface that shines, square meters")
    confidence: bpy.props.FloatProperty(
        name="Confidence",
        description="How sure it is that this is a lamp: how much of what the photos show its light explains",
        min=0.0,
        max=1.0,
    )
    watts: bpy.props.FloatProperty(
        name="Watts",
        description="Power that an area light of Blender has with this lamp's area and radiance: in the scale of this "
        "scene or, once the scale is set, in absolute units, with 178 lumens of white light to the watt as Cycles "
        "reads IES files. Not what the lamp takes from the socket",
        unit="POWER",
        precision=1,
        get=_watts,
    )
    on: bpy.props.BoolProperty(
        name="On",
        description="Whether the lamp is on",
        get=_get(lamps.is_on),
        set=_set(lamps.switch),
    )
    strength: bpy.props.FloatProperty(
        name="Strength",
        description="Radiance of the brightest channel",
        min=0.0,
        soft_max=100.0,
        get=_get(lamps.strength),
        set=_set(lamps.set_strength),
    )
    color: bpy.props.FloatVectorProperty(
        name="Color",
        description="Color of the lamp's light, scene-linear; its brightest channel is 1",
        subtype="COLOR",
        size=3,
        min=0.0,
        max=1.0,
        get=_get(lamps.color),
        set=_set(lamps.set_color),
    )


class IrisSettings(bpy.types.PropertyGroup):
    """Scene.iris: what is solved, how, and into which folder."""

    source: bpy.props.EnumProperty(
        name="Source",
        description="What is solved",
        items=(
            ("CAPTURE", "Capture", "A folder with photos, poses and mesh"),
            ("SCENE", "This scene", "The cameras of this scene that have a background image, and its mesh objects"),
        ),
        default="CAPTURE",
    )
    capture: bpy.props.StringProperty(
        name="Capture", description="Folder with photos, poses and mesh of the room", subtype="DIR_PATH"
    )
    importing: bpy.props.StringProperty(
        name="Importing",
        description="Capture that is being read, or could not be read; it replaces the present one once it has been",
        subtype="DIR_PATH",
    )
    result: bpy.props.StringProperty(
        name="Result", description="Folder for checks and results; empty: beside the capture", subtype="DIR_PATH"
    )
    metres_per_unit: bpy.props.FloatProperty(
        name="Meters per Unit",
        description="What poses and mesh of the capture are multiplied by, where their unit is not the meter; 0: they "
        "are in meters",
        min=0.0,
        max=1e6,
        precision=4,
    )
    preset: bpy.props.EnumProperty(
        name="Preset",
        description="How fine the solve is, and how long it takes. Times are those of small rooms, about 30 photos of "
        "320 x 240 pixels, on two processor cores; a scanned kitchen took one to four minutes",
        items=(
            (
                "draft",
                "Draft",
                "A first look: up to 50 000 patches, textures up to 1024 x 1024. Small rooms take 20 to 40 seconds",
            ),
            (
                "balanced",
                "Balanced",
                "For most rooms: up to 100 000 patches, textures up to 2048 x 2048. Small rooms take 30 to 50 seconds",
            ),
            (
                "final",
                "Final",
                "Fine patches, many rays: up to 250 000 patches, textures up to 4096 x 4096. Small rooms take 50 to "
                "95 seconds",
            ),
        ),
        default="balanced",
    )
    atlas_size: bpy.props.EnumProperty(
        name="Atlas Size",
        description="Texels along a side of the textures. Twice the side takes four times the memory",
        items=ATLAS_SIZES,
        default="auto",
    )
    texels_per_metre: bpy.props.IntProperty(
        name="Texels per Meter",
        description="Density of the textures, as far as the atlas holds it; 0: that of the photos. "
        f"Twice as many take four times the memory, {blender_bytes(1)} bytes of Blender's per texel",
        min=0,
        max=int(HIGHEST_DENSITY),
    )
    device: bpy.props.EnumProperty(
        name="Device",
        description="What the solve runs on. No graphics card is needed",
        items=(
            ("auto", "Automatic", "A CUDA card where there is one"),
            ("cpu", "CPU", "Processor only"),
            ("cuda", "CUDA", "NVIDIA card"),
        ),
        default="auto",
    )
    preview: bpy.props.EnumProperty(
        name="Preview",
        description="Picture of the room shown during the solve",
        items=(
            ("albedo", "Albedo", "Color of the surfaces; lamps are black"),
            ("light", "Light", "Light that the surfaces receive; lamps are white"),
            (
                "error",
                "Error",
                "Four times the difference from what the other photos predict: errors of response, exposure or pose",
            ),
        ),
    )
    seed: bpy.props.IntProperty(
        name="Seed", description="Of the random rays: the same seed gives the same result", min=0
    )
    room: bpy.props.PointerProperty(type=bpy.types.Object, name="Room", description="The mesh of the capture")
    warnings: bpy.props.StringProperty(name="Warnings", description="Warnings of the check, one per line")
    views: bpy.props.CollectionProperty(type=IrisView, name="Photos", description="The photos of the capture")
    view_index: bpy.props.IntProperty(
        name="Photo", description="The photo that is looked at: its camera is the active one", update=_look
    )
    photo_order: bpy.props.EnumProperty(
        name="Order",
        description="Order of the list of photos",
        items=(
            ("CAPTURE", "As Captured", "In the order of the capture"),
            ("SCORE", "Worst Fit First", "Those whose edges agree least with the mesh first"),
            ("SATURATED", "Most Clipped First", "Those with most clipped pixels first"),
        ),
    )
    problems_only: bpy.props.BoolProperty(
        name="Problems Only",
        description="List only photos that lie beside the mesh, see little of it, or are clipped over a large area",
    )
    all_cameras: bpy.props.BoolProperty(
        name="All Cameras",
        description="Show the cameras of all photos in 3D views, not only that of the current one",
        update=_show_cameras,
    )
    folds: bpy.props.StringProperty(
        name="Folds", description="Sections that the artist has folded or unfolded", options={"HIDDEN"}
    )
    open_data: _open("data")
    open_check: _open("check")
    open_solve: _open("solve")
    open_review: _open("review")
    open_relight: _open("relight")
    open_insert: _open("insert")
    open_export: _open("export")
    lamps: bpy.props.CollectionProperty(type=IrisLamp, name="Lamps", description="The recovered lamps")
    lamp_index: bpy.props.IntProperty(
        name="Lamp", description="The chosen lamp; a click shows for two seconds where it is", update=_show_lamp
    )
    show_unsure: bpy.props.BoolProperty(
        name="Unsure Lamps", description="List lamps too whose light explains little of what the photos show"
    )
    lumens_per_unit: bpy.props.FloatProperty(
        name="Lumens per Unit",
        description="Lumens per unit of radiance times square meter, which are candela per square meter per unit of "
        "radiance; 0 while the scale is not known",
        min=0.0,
    )
    scale_anchor: bpy.props.StringProperty(name="Scale From", description="What the lumens per unit were taken from")
    wipe: bpy.props.FloatProperty(
        name="Wipe",
        description="In the camera's view, show the photo or a look up to this share of the frame's width, and to its "
        "right what the view shows otherwise: a re-render, a preview in other light, or what was put onto the photo. "
        "0 is off",
        min=0.0,
        max=1.0,
        subtype="FACTOR",
        update=_redraw,
    )
    wipe_to: bpy.props.EnumProperty(
        name="Wipe To",
        description="What the wipe shows left of its line: the photo, or a look as this camera sees it",
        items=look_choices,
        update=_wipe_to,
    )
    wipe_before: bpy.props.PointerProperty(
        type=bpy.types.Image, name="Before", description="The picture of the look that the wipe shows"
    )
    layers: bpy.props.BoolProperty(
        name="EXR Layers",
        description="Beside each picture that is put onto a photo or plate, an EXR with the layers picture, plate, "
        "shadow catcher and object, for Nuke and other compositors",
    )
    acescg: bpy.props.BoolProperty(name="ACEScg", description="Write the layers in ACEScg, not in linear Rec.709")
    placed: bpy.props.EnumProperty(name="Object", description="The object that Place adds", items=PLACEABLE)
    overlay: bpy.props.FloatProperty(
        name="Photo",
        description="Opacity over the mesh of the imported photo, or of the picture that is shown in its place",
        min=0.0,
        max=1.0,
        default=0.5,
        subtype="FACTOR",
        update=_set_overlay,
    )
