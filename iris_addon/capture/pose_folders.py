"""Data sets with their poses as text: ScanNet as its reader extracts it, 7-Scenes, TUM's format, ScanNet++.

Poses are camera to world, x right, y down, z forward; frames where tracking was lost have infinite ones. ScanNet++ has
those of nerfstudio, in a world whose axes its tools have exchanged against those of the mesh.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..base.errors import BadInput
from ..base.untrusted import decoding, finite, number_in_text, open_text, read_bytes
from .listing import frames_of, has_pose, named_like, read_json_object
from .metashape import DOWN_FORWARD

MAX_POSE_BYTES = 4096
KINECT = {"w": 640, "h": 480, "fl_x": 585.0, "cx": 320.0, "cy": 240.0}
"""Intrinsics of 7-Scenes, which has no file of them (its web page)."""

MAX_TUM_BYTES = 1 << 30
TUM_GAP = 0.1
"""Seconds between two poses of the motion capture, beyond which nothing is known in between."""
TUM_CLOCKS = 0.02
"""Seconds that a photo may lie outside of the poses; the benchmark's own tool allows as many."""
TUM_LENS = ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
TUM_CAMERAS = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6, 0.0, 0.0, 0.0, 0.0, 0.0),
}
"""Intrinsics by a part of the folder's name: the sequences have no file of them (their web page, "colour camera")."""

SCANNETPP_FOLDERS = {
    "transforms.json": ("resized_images", "resized_anon_masks"),
    "transforms_undistorted.json": ("resized_undistorted_images", "resized_undistorted_masks"),
}
"""Photos and masks of each file of poses."""
SCANNETPP_MESH = "scans/mesh_aligned_0.05.ply"
SCANNETPP_TURN = np.array([[0.0, 1.0, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
"""From the axes of the poses to those of the mesh: nerfstudio's converter took COLMAP's x, y, z for y, x, -z."""


def read_scannet(intrinsics: Path) -> list[dict[str, Any]]:
    """Frames of an extracted ScanNet scan around ``intrinsic/intrinsic_color.txt``; raises BadInput."""
    matrix = read_matrix(intrinsics)
    lens = {"fl_x": matrix[0, 0], "fl_y": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}
    poses = named_like(intrinsics.parent.parent / "pose", "*.txt")
    return [{"file_path": f"color/{path.stem}", "transform_matrix": _pose(path), **lens} for path in poses]


def scannetpp_scene(path: Path) -> Path:
    """The folder of the scene of ScanNet++ whose ``dslr/nerfstudio`` is ``path``, or the whole path of a file there;
    else ``path``."""
    whole = Path(os.path.normpath(path.absolute()))  # "." tells no folder; where a link leads has other names
    folder = whole if path.is_dir() else whole.parent
    if folder.name != "nerfstudio" or folder.parent.name != "dslr" or not (folder.parents[1] / "scans").is_dir():
        return path
    return folder.parents[1] if path.is_dir() else whole


def find_scannetpp(path: Path) -> Path | None:
    """The poses of the photos of a scene of ScanNet++, ``path`` being its folder or that file; None where there are
    none."""
    if path.is_file():
        return path if path.name in SCANNETPP_FOLDERS and scannetpp_scene(path.parent) != path.parent else None
    for name, (photos, _) in SCANNETPP_FOLDERS.items():
        if (path / "dslr" / photos).is_dir() and (path / "dslr" / "nerfstudio" / name).is_file():
            return path / "dslr" / "nerfstudio" / name
    return None


def read_scannetpp(transforms: Path) -> list[dict[str, Any]]:
    """Frames of the DSLR of a scene of ScanNet++, in the frame of its mesh; those for tests are held out.

    Raises:
        BadInput: damaged.
    """
    meta, (photos, masks) = read_json_object(transforms), SCANNETPP_FOLDERS[transforms.name]
    shared = {key: value for key, value in meta.items() if not isinstance(value, list)}
    listed = [(frame, "train") for frame in frames_of(meta, transforms)]
    if meta.get("test_frames"):
        listed += [(frame, "val") for frame in frames_of({"frames": meta["test_frames"]}, transforms)]
    frames = []
    with decoding(transforms, mend="download the scene again"):
        for frame, split in listed:
            pose = frame["transform_matrix"]
            if has_pose(pose):
                pose = (SCANNETPP_TURN @ np.array(pose, np.float64)).tolist()
            values = {**shared, **frame, "transform_matrix": pose, "split": split}
            values["file_path"] = f"dslr/{photos}/{frame['file_path']}"
            if frame.get("mask_path"):
                values["mask_path"] = f"dslr/{masks}/{frame['mask_path']}"
            frames.append(values)
    return frames


def read_seven_scenes(first: Path) -> list[dict[str, Any]]:
    """Frames of a sequence of 7-Scenes around the ``first`` of its pose files; raises BadInput."""
    poses = sorted(first.parent.glob("frame-*.pose.txt"))
    names = [path.name.removesuffix(".pose.txt") + ".color.png" for path in poses]
    return [
        {"file_path": name, "transform_matrix": _pose(path), **KINECT} for name, path in zip(names, poses, strict=True)
    ]


def read_tum(photos: Path) -> list[dict[str, Any]]:
    """Frames of a sequence in TUM's format around its ``rgb.txt``; raises BadInput.

    ``groundtruth.txt`` has poses at times of its own, between which those of the photos are interpolated. The camera is
    that of ``calibration.txt`` (fx fy cx cy, then k1 k2 p1 p2 k3 where there are any), as ETH3D's sequences have, or
    one of the three that the name of the folder tells.
    """
    lens = _tum_lens(photos.parent)
    truth = photos.with_name("groundtruth.txt")
    rows = []
    with open_text(truth, MAX_TUM_BYTES, mend="download the sequence again") as file:
        for line in file:
            if (words := line.partition("#")[0].split()) and len(words) != 8:
                raise ValueError(f"{len(words)} numbers for a time, a position and a quaternion")
            if words:
                rows.append([number_in_text(word) for word in words])
        table = finite(rows, (None, 8))
        if table is None or len(table) < 2:
            raise ValueError("fewer than two poses")
        track = PoseTrack(table[:, 0], table[:, 1:4], Rotation.from_quat(table[:, 4:]))
    frames = []
    with open_text(photos, MAX_TUM_BYTES, mend="download the sequence again") as file:
        for line in file:
            if words := line.partition("#")[0].split(maxsplit=1):
                pose = track.at(number_in_text(words[0]), TUM_GAP)
                frames.append({"file_path": words[1].strip(), "transform_matrix": pose, **lens})
    return frames


@dataclass(frozen=True)
class PoseTrack:
    """Poses at times of their own, between which those of photos are interpolated.

    Attributes:
        times: (n,) seconds, in any order, doubles allowed.
        places: (n, 3) positions of the camera.
        turns: n rotations, camera to world, x right, y down, z forward.
    """

    times: np.ndarray
    places: np.ndarray
    turns: Rotation
    _between: Slerp = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times, kept = np.unique(self.times, return_index=True)
        turns = Rotation.from_quat(self.turns.as_quat()[kept])
        values = {"times": times, "places": self.places[kept], "turns": turns, "_between": Slerp(times, turns)}
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def at(self, time: float, gap: float) -> list[list[float]] | None:
        """The pose at a time, x right, y up, z backward; None where no pose lies within ``gap`` seconds around it."""
        times = self.times
        inside = float(np.clip(time, times[0], times[-1]))
        after = min(max(int(np.searchsorted(times, inside)), 1), len(times) - 1)
        at_one = np.abs(times[after - 1 : after + 1] - time).min() < TUM_CLOCKS
        if abs(time - inside) > TUM_CLOCKS or (times[after] - times[after - 1] > gap and not at_one):
            return None
        pose = np.eye(4)
        pose[:3, :3] = self._between(inside).as_matrix()
        pose[:3, 3] = [np.interp(inside, times, self.places[:, axis]) for axis in range(3)]
        return (pose @ DOWN_FORWARD).tolist()


def _tum_lens(folder: Path) -> dict[str, float]:
    own = folder / "calibration.txt"
    if own.is_file():
        with decoding(own, "is not fx fy cx cy, and five numbers of distortion at most", "write them into one line"):
            text = read_bytes(own, MAX_POSE_BYTES).split(b"#")[0]
            values = [number_in_text(word.decode()) for word in text.split()]
            if not 4 <= len(values) <= len(TUM_LENS):
                raise ValueError(f"{len(values)} numbers")
            return dict(zip(TUM_LENS, values, strict=False))
    name = folder.resolve().name.lower()
    for part, known in TUM_CAMERAS.items():
        if part in name:
            return dict(zip(TUM_LENS, known, strict=True))
    raise BadInput(
        "does not tell its camera: its name has none of " + ", ".join(TUM_CAMERAS),
        "write fx fy cx cy in pixels into calibration.txt there",
        folder,
    )


def _pose(path: Path) -> list[list[float]]:
    matrix = read_matrix(path)
    return (matrix @ DOWN_FORWARD if np.isfinite(matrix).all() else matrix).tolist()


def read_matrix(path: Path) -> np.ndarray:
    """(4, 4) numbers of a text file; lost frames have infinite ones."""
    mend = "extract the data set again"
    with decoding(path, "is not a matrix of 4x4 numbers", mend):
        values = [float(word) for word in read_bytes(path, MAX_POSE_BYTES, mend=mend).split()]
        return np.array(values).reshape(4, 4)
