"""COLMAP's sparse model of a capture's cameras, written as text and as binary."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from iris_addon.capture.colmap import MODEL_NAMES
from iris_addon.model.capture import Capture

Model = tuple[str, int, int, tuple[float, ...]]
"""COLMAP's name of a camera model, width, height, parameters."""


def poses(capture: Capture) -> list[tuple[str, list[float]]]:
    """Photo's name, and COLMAP's quaternion and translation, per view."""
    rows = []
    for view in capture.views:
        world_to_camera = np.linalg.inv(view.camera.c2w @ np.diag([1.0, -1.0, -1.0, 1.0]))
        x, y, z, w = Rotation.from_matrix(world_to_camera[:3, :3]).as_quat()
        assert view.photo is not None
        rows.append((view.photo.name, [w, x, y, z, *world_to_camera[:3, 3]]))
    return rows


def camera_of(capture: Capture) -> Model:
    camera = capture.views[0].camera
    return "PINHOLE", camera.width, camera.height, (camera.fx, camera.fy, camera.cx, camera.cy)


def write_text(folder: Path, camera: Model, images: list[tuple[str, list[float]]]) -> None:
    model, width, height, parameters = camera
    numbers = " ".join(str(x) for x in parameters)
    (folder / "cameras.txt").write_text(f"# Camera list\n3 {model} {width} {height} {numbers}\n")
    lines = ["# Image list with two lines of data per image:"]
    for index, (name, pose) in enumerate(images):
        # The points of an image may be missing: then its second line is empty.
        lines += [f"{index + 1} {' '.join(str(x) for x in pose)} 3 {name}", "" if index % 2 else "1.5 2.5 -1 3 4 7"]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")


def write_binary(folder: Path, camera: Model, images: list[tuple[str, list[float]]]) -> None:
    model, width, height, parameters = camera
    head = struct.pack("<QIiQQ", 1, 3, MODEL_NAMES.index(model), width, height)
    (folder / "cameras.bin").write_bytes(head + struct.pack(f"<{len(parameters)}d", *parameters))
    data = struct.pack("<Q", len(images))
    for index, (name, pose) in enumerate(images):
        points = struct.pack("<ddq", 1.5, 2.5, -1) * index
        data += struct.pack("<I7dI", index + 1, *pose, 3) + name.encode() + b"\0" + struct.pack("<Q", index) + points
    (folder / "images.bin").write_bytes(data)
