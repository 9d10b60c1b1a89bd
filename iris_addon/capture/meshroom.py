"""Cameras of Meshroom (AliceVision): views, intrinsics and poses of a .sfm file.

Numbers are strings there. Rotations are stored by columns from world to camera, which read by rows is camera to world,
x right, y down, z forward. The focal length is in millimetres on the sensor; older files have it in pixels.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..base.untrusted import decoding, finite, number_in_text
from .listing import read_json_object
from .metashape import DOWN_FORWARD

_DISTORTION = {
    "pinhole": (),
    "radial1": ("k1",),
    "radialk1": ("k1",),
    "radial3": ("k1", "k2", "k3"),
    "radialk3": ("k1", "k2", "k3"),
    "brown": ("k1", "k2", "k3", "p1", "p2"),
    "fisheye4": ("k1", "k2", "k3", "k4"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
"""Coefficients by the type of an intrinsic, and by the distortion type of newer files."""


def read_meshroom(path: Path) -> list[dict[str, Any]]:
    """The frames of a .sfm file; raises BadInput."""
    content = read_json_object(path)
    with decoding(path, mend="export it again with views, intrinsics and poses"):
        intrinsics = {item["intrinsicId"]: _intrinsics(item) for item in content["intrinsics"]}
        poses = {item["poseId"]: _pose(item["pose"]["transform"]) for item in content.get("poses", ())}
        return [
            {
                "file_path": str(view["path"]),
                "transform_matrix": poses.get(view["poseId"]),
                **intrinsics[view["intrinsicId"]],
            }
            for view in content["views"]
        ]


def _pose(transform: dict[str, Any]) -> list[list[float]] | None:
    """None where its numbers are none, as where a photo was not placed."""
    turn, place = ([float(x) for x in transform[key]] for key in ("rotation", "center"))
    if finite([*turn, *place], (12,)) is None:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.array(turn).reshape(3, 3), place
    return (pose @ DOWN_FORWARD).tolist()


def _intrinsics(item: dict[str, Any]) -> dict[str, Any]:
    width, height = int(item["width"]), int(item["height"])
    if "pxFocalLength" in item:
        given = item["pxFocalLength"]
        focal = _number(given[0] if isinstance(given, list) else given)
    else:
        focal = _number(item["focalLength"]) / _number(item["sensorWidth"]) * width
    x, y = (_number(value) for value in item.get("principalPoint", (0, 0)))
    if abs(x) < width / 4 and abs(y) < height / 4:  # newer files count from the middle of the photo
        x, y = x + width / 2, y + height / 2
    kind = str(item["type"])
    names = _DISTORTION.get(str(item.get("distortionType", kind))) or _DISTORTION.get(kind)
    given = [_number(value) for value in item.get("distortionParams", ())]
    if names is None or (names and len(given) != len(names)):
        if any(given):
            raise ValueError(f"distortion of type {item.get('distortionType', kind)}")
        names = ()
    fisheye = "fisheye" in f"{kind} {item.get('distortionType', '')}"
    return {
        "camera_model": "OPENCV_FISHEYE" if fisheye else "OPENCV",
        **{"w": width, "h": height, "fl_x": focal, "cx": x, "cy": y},
        **dict(zip(names, given, strict=False)),
    }


def _number(value: object) -> float:
    """A usable number, as one or spelled; raises ValueError."""
    return number_in_text(str(value))
