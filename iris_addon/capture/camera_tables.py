"""Cameras in plain tables: Bundler's .out with its list of photos, and RealityScan's CSV."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import BadInput
from ..base.untrusted import finite, number_in_text, open_text

MAX_TABLE_BYTES = 1 << 30
MAX_CAMERAS = 100_000
LIST_FILES = ("{stem}.list.txt", "list.txt", "image_list.txt", "{stem}.txt")
"""Where programs write the names of the photos of a Bundler file."""
MAX_BUNDLER_BYTES = 4 << 30
FULL_FRAME_MM = 36.0
"""Width of the film that RealityScan's focal lengths refer to."""


def read_bundler(path: Path) -> list[dict[str, Any]]:
    """Frames of a Bundler file, version 0.3; raises BadInput.

    Poses are world to camera, x right, y up, z backward. A focal length of 0 marks a photo that was not aligned. The
    principal point is the middle of the photo.
    """
    names = _bundler_names(path)
    frames = []
    with open_text(path, MAX_BUNDLER_BYTES, mend="export the cameras and the list of photos again") as file:
        words = (word for line in file if not line.startswith("#") for word in line.split())
        count = int(next(words, ""))
        next(words, "")
        if not 0 <= count <= MAX_CAMERAS:
            raise ValueError(f"{count} cameras")
        if len(names) != count:
            raise ValueError(f"{count} cameras for {len(names)} photos in its list")
        for name in names:
            values = np.array([float(next(words, "")) for _ in range(15)])
            focal, k1, k2 = values[:3].tolist()
            own = {"file_path": name, "transform_matrix": None, "fl_x": focal, "k1": k1, "k2": k2}
            if focal > 0 and finite(values, (15,)) is not None:
                pose = np.eye(4)
                pose[:3, :3] = values[3:12].reshape(3, 3).T
                pose[:3, 3] = -pose[:3, :3] @ values[12:]
                own["transform_matrix"] = pose.tolist()
            frames.append(own)
    return frames


def _bundler_names(path: Path) -> list[str]:
    candidates = [path.with_name(name.format(stem=path.stem)) for name in LIST_FILES]
    found = next((candidate for candidate in candidates if candidate.is_file()), None)
    if found is None:
        raise BadInput("has no list of its photos beside it", "export list.txt too", path)
    with open_text(found, MAX_TABLE_BYTES, mend="export it again") as file:
        lines = file.read().splitlines()
    # A line may go on with the focal length that EXIF tells.
    return [line.split(" 0 ")[0].strip() for line in lines if line.strip()]


def read_reality_scan(path: Path) -> list[dict[str, Any]]:
    """Frames of RealityScan's (RealityCapture's) table of internal and external camera parameters; raises BadInput.

    Angles are degrees. The focal length is that of a film 36 millimetres wide, the principal point a share of it.
    """
    frames = []
    mend = "export Internal/External camera parameters again"
    with open_text(path, MAX_TABLE_BYTES, mend=mend, newline="") as file:
        for row in csv.DictReader(file):
            name = row.get("#name") or row["name"]
            value = {key: number_in_text(row[key]) for key in row if key not in ("#name", "name") and row[key]}
            pose = np.eye(4)
            pose[:3, :3] = _rotation(-value["heading"], value["pitch"], value["roll"])
            pose[:3, 3] = value["x"], value["y"], value["alt"]
            lens = {key: value.get(key, 0.0) for key in ("k1", "k2", "k3", "k4")}
            lens |= {"p1": value.get("t1", 0.0), "p2": value.get("t2", 0.0)}
            relative = tuple(value.get(key, 0.0) / FULL_FRAME_MM for key in ("f", "px", "py"))
            frames.append({"file_path": name, "transform_matrix": pose.tolist(), "relative": relative, **lens})
    return frames


def _rotation(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """(3, 3) turn by ``roll`` about y, ``pitch`` about x, then ``yaw`` about z, degrees."""
    (cz, sz), (cx, sx), (cy, sy) = ((np.cos(a), np.sin(a)) for a in np.radians([yaw, pitch, roll]))
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return about_z @ about_x @ about_y
