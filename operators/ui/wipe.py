"""A wipe in the camera's view: the photo or a look to the left of a line, and to its right what the view shows
otherwise, be it a re-render, a preview in other light, or the photo with something put onto it."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from typing import Any

import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d

from ...iris_addon.blender.scene_in.capture_objects import VIEW, background_of

PHOTO = "PHOTO"
"""What a wipe goes to unless it goes to a look."""
BEFORE_VIEW = "iris_view"
"""Custom property of the picture of a look: whose view it is (:func:`view_name`)."""
LINE_PIXELS = 2.0
LINE_COLOR = (1.0, 1.0, 1.0, 0.9)

Point = tuple[float, float]

VERTEX = "void main() { at = uv; gl_Position = matrix * vec4(pos, 0.0, 1.0); }"
# Textures of images are linear, and what is drawn over a view is encoded as sRGB when it is written: as the photo was.
FRAGMENT = "void main() { color = vec4(clamp(texture(photo, at).rgb * gain, 0.0, 1.0), 1.0); }"


class _Drawn:
    """The handler, and the shader once it has been compiled."""

    handler: object = None
    shader: Any = None


def wiped(corners: Sequence[Point], share: float) -> tuple[list[Point], list[Point], list[Point]]:
    """Corners and texture coordinates of the part of a frame that lies left of the line, and the ends of the line.

    Args:
        corners: of the frame, bottom left, bottom right, top right, top left.
        share: of its width, where the line stands.
    """
    left_bottom, right_bottom, right_top, left_top = corners
    bottom, top = _between(left_bottom, right_bottom, share), _between(left_top, right_top, share)
    return [left_bottom, bottom, top, left_top], [(0, 0), (share, 0), (share, 1), (0, 1)], [bottom, top]


def _between(a: Point, b: Point, share: float) -> Point:
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])


def wiped_photo(scene: bpy.types.Scene) -> bpy.types.Image | None:
    """The photo of the active camera, if it fills the frame as it is; else None."""
    behind = None if scene.camera is None else background_of(scene.camera)
    if behind is None or (not behind.image.has_data and not behind.image.size[0]):
        return None
    plain = tuple(behind.offset) == (0, 0) and behind.scale == 1 and behind.rotation == 0
    return behind.image if plain and not (behind.use_flip_x or behind.use_flip_y) else None


def wiped_picture(scene: bpy.types.Scene) -> bpy.types.Image | None:
    """What lies left of the line: the photo, or the chosen look if there is a picture of it from the active camera."""
    if scene.iris.wipe_to in ("", PHOTO):  # empty: a look that is gone
        return wiped_photo(scene)
    before = scene.iris.wipe_before
    here = before is not None and scene.camera is not None and before.get(BEFORE_VIEW) == view_name(scene.camera)
    return before if here else None


def view_name(camera: bpy.types.Object) -> str:
    """What the view of ``camera`` is called in file names: as its photo, else as the camera where it stands now."""
    data = camera.data if camera.type == "CAMERA" else None  # the active camera may be any object
    if data is not None and data.get(VIEW):
        return bpy.path.clean_name(str(data[VIEW]))
    lens = () if data is None else (data.lens, data.sensor_width, data.sensor_height, data.shift_x, data.shift_y)
    stands = struct.pack(f"<{16 + len(lens)}f", *(value for row in camera.matrix_world for value in row), *lens)
    return f"{bpy.path.clean_name(camera.name)}-{zlib.crc32(stands):08x}"


def shown_wipe(context: bpy.types.Context) -> tuple[bpy.types.Image, list[Point]] | None:
    """Picture of a wipe and corners of the frame (:func:`camera_frame`) where this view shows one; else None."""
    scene, view = context.scene, context.region_data
    if scene.iris.wipe <= 0 or view is None or view.view_perspective != "CAMERA":
        return None
    photo = wiped_picture(scene) if context.space_data.camera == scene.camera else None
    frame = None if photo is None else camera_frame(context)
    return None if photo is None or frame is None else (photo, frame)


def _draw() -> None:
    shown = shown_wipe(bpy.context)
    if shown is None:
        return
    (photo, frame), scene = shown, bpy.context.scene
    import gpu  # absent where Blender draws nothing
    from gpu_extras.batch import batch_for_shader

    if _Drawn.shader is None:
        _Drawn.shader = _compile()
    positions, uvs, line = wiped(frame, scene.iris.wipe)
    indices = ((0, 1, 2), (0, 2, 3))
    shader = _Drawn.shader
    batch = batch_for_shader(shader, "TRIS", {"pos": positions, "uv": uvs}, indices=indices)
    gpu.state.blend_set("NONE")
    shader.bind()
    shader.uniform_float("matrix", gpu.matrix.get_projection_matrix() @ gpu.matrix.get_model_view_matrix())
    shader.uniform_float("gain", 2.0**scene.view_settings.exposure if photo.is_float else 1.0)
    shader.uniform_sampler("photo", gpu.texture.from_image(photo))
    batch.draw(shader)
    half = LINE_PIXELS / 2
    edges = [(x + side, y) for (x, y), side in zip((*line, *line[::-1]), (-half, -half, half, half), strict=True)]
    plain = gpu.shader.from_builtin("UNIFORM_COLOR")
    gpu.state.blend_set("ALPHA")
    plain.uniform_float("color", LINE_COLOR)
    batch_for_shader(plain, "TRIS", {"pos": edges}, indices=indices).draw(plain)
    gpu.state.blend_set("NONE")


def camera_frame(context: bpy.types.Context) -> list[Point] | None:
    """Corners of the camera's frame in the region, from the bottom left on; None where one cannot be placed."""
    camera = context.scene.camera
    top_right, bottom_right, bottom_left, top_left = camera.data.view_frame(scene=context.scene)
    rigid = camera.matrix_world.normalized()
    corners = [
        location_3d_to_region_2d(context.region, context.region_data, rigid @ corner)
        for corner in (bottom_left, bottom_right, top_right, top_left)
    ]
    return None if any(corner is None for corner in corners) else [(corner.x, corner.y) for corner in corners]


def _compile() -> Any:
    import gpu

    between = gpu.types.GPUStageInterfaceInfo("iris_wipe_interface")
    between.smooth("VEC2", "at")
    info = gpu.types.GPUShaderCreateInfo()
    info.push_constant("MAT4", "matrix")
    info.push_constant("FLOAT", "gain")
    info.sampler(0, "FLOAT_2D", "photo")
    info.vertex_in(0, "VEC2", "pos")
    info.vertex_in(1, "VEC2", "uv")
    info.vertex_out(between)
    info.fragment_out(0, "VEC4", "color")
    info.vertex_source(VERTEX)
    info.fragment_source(FRAGMENT)
    return gpu.shader.create_from_info(info)


def register() -> None:
    """Start to draw."""
    if not bpy.app.background:
        _Drawn.handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    """Stop drawing."""
    if _Drawn.handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_Drawn.handler, "WINDOW")
    _Drawn.handler = _Drawn.shader = None
