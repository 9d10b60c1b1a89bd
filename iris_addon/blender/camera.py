"""Pinhole cameras to and from Blender, exactly: fx ≠ fy is pixel aspect, cx and cy are lens shift.

Blender projects a pixel i of W onto the sensor as ``(sensor / lens) · (i − W/2 + shift_x · fit) / fit`` where ``fit``
is the fitted side in pixels, and does the same vertically with pixels ``aspect_y / aspect_x`` as high as they are wide.
"""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ..base.errors import BadInput
from ..model.capture import Camera

SENSOR_MM = 36.0


def add_camera(camera: Camera, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """A camera object whose rays are ``camera.rays()`` once :func:`look_through` has set the frame for it."""
    camera_object = bpy.data.objects.new(name, bpy.data.cameras.new(name))
    set_lens(camera_object.data, camera)
    camera_object.matrix_world = Matrix(camera.c2w.tolist())
    collection.objects.link(camera_object)
    return camera_object


def set_lens(data: bpy.types.Camera, camera: Camera) -> None:
    """Set focal length and shift of ``camera``; the aspect of its pixels belongs to the frame."""
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = SENSOR_MM
    data.lens = camera.fx * SENSOR_MM / camera.width
    data.shift_x = (0.5 * camera.width - camera.cx) / camera.width
    data.shift_y = (camera.cy - 0.5 * camera.height) * camera.fx / camera.fy / camera.width
    data.clip_start, data.clip_end = 1e-3, 1e4


def look_through(scene: bpy.types.Scene, camera: Camera, camera_object: bpy.types.Object) -> None:
    """Make ``camera_object`` the active camera and give the frame the size and pixel aspect of ``camera``."""
    scene.camera = camera_object
    scene.render.resolution_percentage = 100
    set_frame(scene, camera.width, camera.height, camera.fx / camera.fy)


def set_frame(scene: bpy.types.Scene, width: int, height: int, aspect: float) -> None:
    """Set the pixels of the frame, and ``aspect`` = fx / fy of its cameras."""
    scene.render.resolution_x, scene.render.resolution_y = width, height
    # Blender takes each side of the ratio only from 1 up.
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = max(1.0, 1.0 / aspect), max(1.0, aspect)


def read_camera(scene: bpy.types.Scene, camera_object: bpy.types.Object) -> Camera:
    """The pinhole camera of ``camera_object`` with the frame size and pixel aspect of ``scene``.

    Raises:
        BadInput: the camera is orthographic or panoramic.
    """
    data, render = camera_object.data, scene.render
    if data.type != "PERSP":
        raise BadInput(
            f"camera '{camera_object.name}' is of type {data.type}", "use perspective cameras for the photos"
        )
    width = int(render.resolution_x * render.resolution_percentage / 100)
    height = int(render.resolution_y * render.resolution_percentage / 100)
    aspect = render.pixel_aspect_y / render.pixel_aspect_x
    landscape = width * render.pixel_aspect_x >= height * render.pixel_aspect_y
    horizontal = data.sensor_fit == "HORIZONTAL" or (data.sensor_fit == "AUTO" and landscape)
    fit = width if horizontal else aspect * height
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    fx = data.lens * fit / sensor

    c2w = np.array(camera_object.matrix_world, dtype=np.float64)
    c2w[:3, :3] /= np.linalg.norm(c2w[:3, :3], axis=0)  # Blender ignores the scale of a camera
    return Camera(
        width=width,
        height=height,
        fx=fx,
        fy=fx / aspect,
        cx=0.5 * width - data.shift_x * fit,
        cy=0.5 * height + data.shift_y * fit / aspect,
        c2w=c2w,
    )
