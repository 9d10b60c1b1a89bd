"""Recordings of phones and of ARKit as their programs export them: Polycam's raw data, Record3D, and ARKitScenes.

::

    Polycam      keyframes/corrected_cameras/N.json with keyframes/corrected_images/N.jpg, else cameras/ with images/,
                 and raw.glb; mesh_info.json has the turn from the frame of the cameras to that of raw.glb, by columns
    Record3D     metadata.json with rgb/N.jpg, of "EXR + RGB": quaternions (x, y, z, w) and positions, the matrix of the
                 camera by columns, or focal lengths and principal point for each photo
    ARKitScenes  lowres_wide.traj (seconds, turn in radians about an axis, shift; world to camera, y down, z forward)
                 with lowres_wide/ID_SECONDS.png, and lowres_wide_intrinsics/ID_SECONDS.pincam

Poses of the first two are camera to world, x right, y up, z backward, in a world whose y points up; that of ARKitScenes
has z up. Photos lie as the sensor does, on their side where the phone was held upright. All are in metres.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..base.errors import BadInput
from ..base.untrusted import decoding, finite, floats, number_in_text, numbers, open_text, read_bytes
from .listing import named_like, read_json_object
from .photo_files import PHOTO_SUFFIXES
from .pose_folders import MAX_POSE_BYTES, PoseTrack

MESH_INFO, RECORD3D_FILE = "mesh_info.json", "metadata.json"
RECORDING_SUFFIX = ".r3d"
CORRECTED = "corrected_cameras"
CORRECTED_BORDER = 15 / 1024
"""Of the width; a corrected photo is black up to there where the lens saw nothing (nerfstudio leaves out as much)."""
ARKIT_STREAMS = ("wide", "vga_wide", "lowres_wide")
"""Folders of photos, the finest first; of a recording that was loaded in part, one may be empty."""
ARKIT_GAP = 0.25
"""Seconds between two poses, beyond which nothing is known in between; there are ten a second."""
SAME_FRAME = 0.01
"""Seconds between a photo and the intrinsics that are its own."""
MAX_TRAJECTORY_BYTES = 256 << 20
AGAIN = "export the recording again"


# ---- Polycam --------------------------------------------------------------------------------------------------------


def find_polycam(path: Path) -> Path | None:
    """The first camera of Polycam's raw data in ``path``, a folder or its mesh_info.json; None where there is none."""
    if path.is_file():
        return find_polycam(path.parent) if path.name == MESH_INFO else None
    keyframes = path / "keyframes"
    for cameras, images in ((CORRECTED, "corrected_images"), ("cameras", "images")):
        if (keyframes / images).is_dir() and (found := named_like(keyframes / cameras, "*.json")):
            return found[0]
    return None


def read_polycam(first: Path) -> list[dict[str, Any]]:
    """Frames of Polycam's raw data around the ``first`` of its cameras, in the frame of raw.glb; raises BadInput."""
    cameras = first.parent
    corrected = cameras.name == CORRECTED
    images = "keyframes/corrected_images" if corrected else "keyframes/images"
    to_mesh = _to_mesh(cameras.parent.parent / MESH_INFO)
    frames = []
    for path in named_like(cameras, "*.json"):
        values = read_json_object(path)
        with decoding(path, mend=AGAIN):
            given = finite([[values[f"t_{row}{column}"] for column in range(4)] for row in range(3)], (3, 4))
            pose = None if given is None else (to_mesh @ np.vstack([given, [0.0, 0.0, 0.0, 1.0]])).tolist()
            frame = {"file_path": f"{images}/{path.stem}", "transform_matrix": pose}
            frame |= {"w": values["width"], "h": values["height"], "fl_x": values["fx"], "fl_y": values["fy"]}
            frame |= {"cx": values["cx"], "cy": values["cy"]}
            if corrected:
                frame["margins"] = (round(CORRECTED_BORDER * float(values["width"])),) * 4
        frames.append(frame)
    return frames


def _to_mesh(info: Path) -> np.ndarray:
    """(4, 4) from the frame of the cameras to that of raw.glb; none where the file does not tell."""
    if not info.is_file():
        return np.eye(4)
    given = read_json_object(info).get("alignmentTransform")
    if given is None:
        return np.eye(4)
    return numbers(given, (16,), "alignmentTransform", info).reshape(4, 4).T


# ---- Record3D -------------------------------------------------------------------------------------------------------


def find_record3d(path: Path) -> Path | None:
    """The metadata.json of Record3D's export in ``path``, a folder or that file; None where there is none."""
    file = path / RECORD3D_FILE if path.is_dir() else path
    if file.name != RECORD3D_FILE or not file.is_file() or not (file.parent / "rgb").is_dir():
        return None
    return file if "poses" in read_json_object(file) else None


def refuse_recording(path: Path) -> None:
    """Raise BadInput where ``path`` is, or its folder holds, a recording in Record3D's own format.

    That is an archive of ``metadata`` and ``rgbd/``, photos as JPEG and depth in Apple's LZFSE, and has no mesh.
    """
    kept = [path] if path.is_file() else named_like(path, "*")
    recording = next((file for file in kept if file.suffix.lower() == RECORDING_SUFFIX), None)
    if recording is not None:
        what = "is a recording in Record3D's own format, whose depth is compressed (LZFSE)"
        raise BadInput(what, 'export it from Record3D as "EXR + RGB" and give that folder', recording)


def read_record3d(path: Path) -> list[dict[str, Any]]:
    """Frames of Record3D's ``metadata.json``; raises BadInput."""
    meta = read_json_object(path)
    poses = numbers(meta["poses"], (None, 7), "poses", path)
    per_photo = floats(meta.get("perFrameIntrinsicCoeffs"), (len(poses), 4))
    frames = []
    with decoding(path, mend=AGAIN):
        size = {"w": int(meta["w"]), "h": int(meta["h"])}
        if per_photo is None:
            matrix = numbers(meta.get("K"), (9,), "K", path)
            per_photo = np.tile(matrix[[0, 4, 6, 7]], (len(poses), 1))
        for number, (row, (fx, fy, cx, cy)) in enumerate(zip(poses, per_photo.tolist(), strict=True)):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = Rotation.from_quat(row[:4]).as_matrix(), row[4:]
            lens = {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
            frames.append({"file_path": f"rgb/{number}", "transform_matrix": pose.tolist(), **size, **lens})
    return frames


# ---- ARKitScenes ----------------------------------------------------------------------------------------------------


def find_arkit_scenes(path: Path) -> Path | None:
    """The trajectory of a recording of ARKitScenes in the folder ``path``; None where there is none."""
    if not path.is_dir():
        return None
    places = [path / "lowres_wide.traj", *sorted(path.glob("*_frames/lowres_wide.traj"))]
    return next((file for file in places if file.is_file()), None)


def read_arkit_scenes(trajectory: Path) -> list[dict[str, Any]]:
    """Frames of a recording of ARKitScenes around its ``lowres_wide.traj``; raises BadInput."""
    folder = trajectory.parent
    track = _trajectory(trajectory)
    found = {name: _photos(folder / name) for name in ARKIT_STREAMS}
    stream = next((name for name, photos in found.items() if photos), ARKIT_STREAMS[-1])
    below = f"{folder.name}/{stream}" if folder.name.endswith("_frames") else stream
    lenses = sorted((_seconds(path), path) for path in named_like(folder / f"{stream}_intrinsics", "*.pincam"))
    times, frames = [time for time, _ in lenses], []
    for photo in found[stream]:
        time = _seconds(photo)
        pose = track.at(time, ARKIT_GAP)
        lens = {}
        if pose is not None and (nearest := _nearest(times, time)) is not None:
            lens = _pincam(lenses[nearest][1])
        frames.append({"file_path": f"{below}/{photo.name}", "transform_matrix": pose if lens else None, **lens})
    return frames


def _photos(folder: Path) -> list[Path]:
    return [path for path in named_like(folder, "*") if path.suffix.lower() in PHOTO_SUFFIXES]


def _trajectory(path: Path) -> PoseTrack:
    rows = []
    with open_text(path, MAX_TRAJECTORY_BYTES, mend=AGAIN) as file:
        for line in file:
            if words := line.split():
                rows.append([number_in_text(word) for word in words])
        table = finite(rows, (None, 7))
        if table is None or len(table) < 2:
            raise ValueError("no list of times with a turn and a shift")
        to_world = Rotation.from_rotvec(table[:, 1:4]).inv()
        return PoseTrack(table[:, 0], -to_world.apply(table[:, 4:]), to_world)


def _seconds(path: Path) -> float:
    """The time in a name, after the number of the recording."""
    with decoding(path, "has no time in its name", "keep the names of the data set"):
        return number_in_text(path.stem.rpartition("_")[2])


def _nearest(times: Sequence[float], time: float) -> int | None:
    at = bisect_left(times, time)
    near = [k for k in (at - 1, at) if 0 <= k < len(times) and abs(times[k] - time) < SAME_FRAME]
    return min(near, key=lambda k: abs(times[k] - time), default=None)


def _pincam(path: Path) -> dict[str, float]:
    with decoding(path, "is not a size, two focal lengths and a principal point", AGAIN):
        values = [number_in_text(word.decode()) for word in read_bytes(path, MAX_POSE_BYTES, mend=AGAIN).split()]
        return dict(zip(("w", "h", "fl_x", "fl_y", "cx", "cy"), values, strict=True))
