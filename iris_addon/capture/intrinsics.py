"""Intrinsics, lens distortion and poses out of the dictionaries of a transforms file, each checked for sanity."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import BadInput
from ..base.images import MAX_PIXELS
from ..model.capture import Camera, Distortion, FloatArray
from .listing import number

MAX_FIELD_OF_VIEW = math.radians(170.0)
RIGID_TOLERANCE = 1e-3  # files keep three decimals at least

PERSPECTIVE_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
FISHEYE_MODELS = ("OPENCV_FISHEYE",)

# Columns of a FIPT/Mitsuba pose are x left, y up, z forward; ours are x right, y up, z backward.
LEFT_UP_FORWARD = np.diag([-1.0, 1.0, -1.0, 1.0])


def read_camera(values: Mapping[str, Any], size: tuple[int, int] | None, label: str, path: Path) -> Camera:
    """Camera of one frame.

    Args:
        values: keys of the frame over those of the file: fl_x, fl_y, cx, cy, w, h, camera_angle_x, camera_angle_y and
            transform_matrix, (4, 4) or (3, 4), columns x right, y up, z backward.
        size: (width, height) of the photo, used where the file gives none.
        label: how errors call the frame.
        path: the file the values come from.

    Raises:
        BadInput: something is missing, not finite, or no camera could be like that.
    """
    if "w" in values and "h" in values:
        width, height = (int(number(values, key, path)) for key in ("w", "h"))
    elif size is not None:
        width, height = size
    else:
        raise BadInput(f'{label}: no image size ("w", "h")', "add both to the file", path)
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise BadInput(f"{label}: image size {width}x{height}", 'correct "w" and "h"', path)

    if "fl_x" in values:
        fx = number(values, "fl_x", path)
    elif "camera_angle_x" in values:
        fx = _focal(width, number(values, "camera_angle_x", path), label, path)
    else:
        raise BadInput(f'{label}: no focal length ("fl_x" or "camera_angle_x")', "add it to the file", path)
    if "fl_y" in values:
        fy = number(values, "fl_y", path)
    elif "fl_x" not in values and "camera_angle_y" in values:
        fy = _focal(height, number(values, "camera_angle_y", path), label, path)
    else:
        fy = fx
    cx = number(values, "cx", path) if "cx" in values else width / 2
    cy = number(values, "cy", path) if "cy" in values else height / 2

    _check_intrinsics(width, height, fx, fy, cx, cy, label, path)
    return Camera(
        width=width,
        height=height,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        c2w=read_pose(values.get("transform_matrix"), label, path),
    )


def _focal(pixels: int, angle: float, label: str, path: Path) -> float:
    if not 0 < angle < math.pi:
        raise BadInput(f"{label}: field of view {angle} rad", "give camera_angle_x in radians", path)
    return 0.5 * pixels / math.tan(0.5 * angle)


def _check_intrinsics(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float, label: str, path: Path
) -> None:
    for pixels, focal, center, axis in ((width, fx, cx, "x"), (height, fy, cy, "y")):
        if focal <= 0 or 2 * math.atan(0.5 * pixels / focal) > MAX_FIELD_OF_VIEW:
            raise BadInput(
                f"{label}: focal length {focal:g} px in {axis} for {pixels} pixels cannot be",
                "give it in pixels of the photo",
                path,
            )
        if not -0.5 * pixels <= center <= 1.5 * pixels:
            raise BadInput(
                f"{label}: principal point {center:g} px in {axis} is far outside {pixels} pixels",
                "give it in pixels of the photo",
                path,
            )


def read_pose(matrix: Any, label: str, path: Path) -> FloatArray:
    """(4, 4) rigid camera-to-world matrix from nested lists, (4, 4) or (3, 4); raises BadInput."""
    try:
        given = np.array(matrix, np.float64)
    except (TypeError, ValueError):
        given = np.empty(0)
    if given.shape not in ((3, 4), (4, 4)):
        raise BadInput(f"{label}: transform_matrix is not 4x4", "export the poses again", path)
    if not np.isfinite(given).all():
        raise BadInput(f"{label}: pose has NaN or infinite numbers", "remove the photo or export its pose again", path)
    pose = np.eye(4)
    pose[: len(given)] = given
    rotation = pose[:3, :3]
    deviation = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if deviation > RIGID_TOLERANCE or np.linalg.det(rotation) < 0 or not np.allclose(pose[3], (0, 0, 0, 1)):
        raise BadInput(
            f"{label}: pose is not a rotation and a translation",
            "export camera-to-world matrices without scale, shear or mirror",
            path,
        )
    return pose


def read_distortion(values: Mapping[str, Any], label: str, path: Path) -> Distortion | None:
    """Lens distortion of one frame, None for a pinhole; raises BadInput for a camera model not handled here."""
    model = str(values.get("camera_model", "OPENCV")).upper()
    if model not in PERSPECTIVE_MODELS + FISHEYE_MODELS:
        known = ", ".join(PERSPECTIVE_MODELS + FISHEYE_MODELS)
        raise BadInput(f"{label}: camera model {model} is not supported", f"undistort the photos, or use {known}", path)
    fisheye = model in FISHEYE_MODELS or values.get("is_fisheye") is True
    keys = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "k3", "k4", "p1", "p2")
    coefficients = {key: number(values, key, path) for key in keys if key in values}
    if not fisheye and not any(coefficients.values()):
        return None
    return Distortion(**coefficients, fisheye=fisheye)
