"""RGB-D data sets with a text file per pose: ScanNet as its reader extracts it, and 7-Scenes.

Poses are camera to world, x right, y down, z forward; frames where tracking was lost have infinite ones.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..base.untrusted import decoding, read_bytes
from .metashape import DOWN_FORWARD

MAX_POSE_BYTES = 4096
KINECT = {"w": 640, "h": 480, "fl_x": 585.0, "cx": 320.0, "cy": 240.0}
"""Intrinsics of 7-Scenes, which has no file of them (its web page)."""


def read_scannet(intrinsics: Path) -> list[dict[str, Any]]:
    """Frames of an extracted ScanNet scan around ``intrinsic/intrinsic_color.txt``; raises BadInput."""
    matrix = _matrix(intrinsics)
    lens = {"fl_x": matrix[0, 0], "fl_y": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}
    poses = sorted((intrinsics.parent.parent / "pose").glob("*.txt"))
    return [{"file_path": f"color/{path.stem}", "transform_matrix": _pose(path), **lens} for path in poses]


def read_seven_scenes(first: Path) -> list[dict[str, Any]]:
    """Frames of a sequence of 7-Scenes around the ``first`` of its pose files; raises BadInput."""
    poses = sorted(first.parent.glob("frame-*.pose.txt"))
    names = [path.name.removesuffix(".pose.txt") + ".color.png" for path in poses]
    return [
        {"file_path": name, "transform_matrix": _pose(path), **KINECT} for name, path in zip(names, poses, strict=True)
    ]


def _pose(path: Path) -> list[list[float]]:
    return (_matrix(path) @ DOWN_FORWARD if np.isfinite(_matrix(path)).all() else _matrix(path)).tolist()


def _matrix(path: Path) -> np.ndarray:
    """(4, 4) numbers of a text file; lost frames have infinite ones."""
    mend = "extract the data set again"
    with decoding(path, "is not a matrix of 4x4 numbers", mend):
        values = [float(word) for word in read_bytes(path, MAX_POSE_BYTES, mend=mend).split()]
        return np.array(values).reshape(4, 4)
