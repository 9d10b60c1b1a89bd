"""Cameras of an imported capture, moved to the poses that the solve found, and back to the given ones."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Matrix

from ...base.untrusted import finite
from ...model.capture import View
from ...results.result import Result
from ..camera import read_camera, set_lens

GIVEN = "iris_given"
"""Custom property of a camera that was moved: its given pose and lens."""
METRES_PER_UNIT = "iris_metres_per_unit"
"""Custom property of the camera data of a photo: what its pose, as the file has it, was multiplied by."""
LENS = ("sensor_fit", "sensor_width", "lens", "shift_x", "shift_y", "clip_start", "clip_end")


def move_to_solved_poses(result: Result, cameras: Mapping[str, bpy.types.Object], scene: bpy.types.Scene) -> int:
    """Move the cameras of the photos, which are in the space of the capture, to the poses that ``result`` corrected.

    Args:
        cameras: by name of the photo.

    Returns:
        The number of cameras that were moved.
    """
    given = []
    result = _in_units_of(cameras, result)
    for name, thing in cameras.items():
        camera = read_camera(scene, thing)
        camera.c2w[:] = np.array(thing.matrix_basis)
        given.append(View(name, camera, None))
    moved = 0
    for before, after in zip(given, result.as_taken(given), strict=True):
        if after.camera is before.camera:
            continue
        thing, moved = cameras[before.name], moved + 1
        place = [list(row) for row in thing.matrix_basis]
        thing[GIVEN] = json.dumps({"place": place, **{name: getattr(thing.data, name) for name in LENS}})
        set_lens(thing.data, after.camera)
        thing.matrix_basis = Matrix(after.camera.c2w.tolist())
    return moved


def _in_units_of(cameras: Mapping[str, bpy.types.Object], result: Result) -> Result:
    """The result for poses of files that are in the unit in which the cameras stand, which may have been scaled."""
    scale = finite(result.report.get("metres_per_unit", 1.0))
    own = next((thing.data.get(METRES_PER_UNIT, 1.0) for thing in cameras.values()), 1.0)
    if scale is None or own in (0.0, 1.0):
        return result
    return replace(result, report={**result.report, "metres_per_unit": float(scale) / own})


def restore_given_poses(scene: bpy.types.Scene) -> None:
    """Undo :func:`move_to_solved_poses`."""
    for thing in scene.objects:
        if GIVEN in thing:
            given = json.loads(thing[GIVEN])
            thing.matrix_basis = Matrix(given.pop("place"))
            for name, value in given.items():
                setattr(thing.data, name, value)
            del thing[GIVEN]


def forget_given_pose(thing: bpy.types.Object) -> None:
    """Forget the given pose of ``thing``, because it has been given another one."""
    if GIVEN in thing:
        del thing[GIVEN]
