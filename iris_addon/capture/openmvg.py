"""Cameras of OpenMVG: views, intrinsics and extrinsics of a sfm_data.json.

Rotations are world to camera, x right, y down, z forward, beside the centre of the camera; lengths are pixels. Which
lens an intrinsic has is told by the name of its coefficients: the name of its class stands at the first of a kind only.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..base.untrusted import decoding, finite
from .listing import read_json_object
from .metashape import DOWN_FORWARD

LENSES = {
    "disto_k1": ("k1",),
    "disto_k3": ("k1", "k2", "k3"),
    "disto_t2": ("k1", "k2", "k3", "p1", "p2"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
"""Coefficients by the key that holds them."""
PINHOLE_KEYS = {"width", "height", "ccdw", "focal_length", "principal_point", "value0"}


def read_openmvg(path: Path) -> list[dict[str, Any]]:
    """The frames of a sfm_data.json; raises BadInput. Views that were not reconstructed have no pose."""
    content = read_json_object(path)
    with decoding(path, mend="export it again with views, intrinsics and extrinsics"):
        intrinsics = {item["key"]: _intrinsics(_fields(item)) for item in content["intrinsics"]}
        poses = {item["key"]: _pose(item["value"]) for item in content["extrinsics"]}
        frames = []
        for view in (_fields(item) for item in content["views"]):
            pose = poses.get(view["id_pose"])
            # Photos that could not be placed may have no intrinsics either.
            lens = {} if pose is None else intrinsics[view["id_intrinsic"]]
            named = f"{view.get('local_path') or ''}/{view['filename']}".lstrip("/")
            frames.append({"file_path": named, "transform_matrix": pose, **lens})
        return frames


def _fields(item: dict[str, Any]) -> dict[str, Any]:
    """What the pointer of an entry leads to, with the fields of its base class, which some versions nest."""
    fields, level = {}, item["value"]["ptr_wrapper"]["data"]
    while isinstance(level, dict):
        fields |= level
        level = level.get("value0")
    return fields


def _pose(value: dict[str, Any]) -> list[list[float]]:
    pose = np.eye(4)
    pose[:3, :3] = _numbers(value["rotation"], (3, 3), "rotation").T
    pose[:3, 3] = _numbers(value["center"], (3,), "center")
    return (pose @ DOWN_FORWARD).tolist()


def _intrinsics(fields: dict[str, Any]) -> dict[str, Any]:
    kinds = [key for key in fields if key not in PINHOLE_KEYS]
    if len(kinds) > 1 or not set(kinds) <= LENSES.keys():
        raise ValueError(f"an intrinsic with {', '.join(map(str, kinds))[:80]}")
    x, y = _numbers(fields["principal_point"], (2,), "principal_point").tolist()
    focal = float(_numbers(fields["focal_length"], (), "focal_length"))
    lens = {}
    for kind in kinds:
        names, given = LENSES[kind], fields[kind]
        values = _numbers(given if isinstance(given, list) else [given], (len(LENSES[kind]),), kind)
        lens = dict(zip(names, values.tolist(), strict=True))
    return {
        "camera_model": "OPENCV_FISHEYE" if kinds == ["fisheye"] else "OPENCV",
        **{"w": int(fields["width"]), "h": int(fields["height"]), "fl_x": focal, "cx": x, "cy": y},
        **lens,
    }


def _numbers(value: object, shape: tuple[int, ...], what: str) -> np.ndarray:
    array = finite(value, shape)
    if array is None:
        raise ValueError(f"{what} of other than {shape} numbers")
    return array
