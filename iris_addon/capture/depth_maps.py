"""Depth beside the photos of a capture, of nerfstudio, of phones and of RGB-D data sets.

::

    nerfstudio   "depth_file_path" of a frame, "depth_unit_scale_factor" (metres per number, 0.001 by default); Polycam
                 and Record3D by ns-process-data
    ScanNet      depth/N.png beside color/N.jpg, millimetres, the camera of intrinsic/intrinsic_depth.txt
    7-Scenes     frame-N.depth.png, millimetres
    TUM RGB-D    depth.txt and depth/, 5000 to a metre
    Polycam      keyframes/depth/N.png, millimetres, without what keyframes/confidence/N.png has as 0
    Record3D     depth/N.exr, metres
    ARKitScenes  lowres_depth/ID_SECONDS.png, millimetres

Depth is that along the view axis; 0, and 65535 in 16 bits, stand for none.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.images import HDR_SUFFIXES, exr_size, read_exr
from ..base.untrusted import decoding, number_in_text, open_text, read_npy
from ..model.capture import Camera, Distortion, View
from .depth_fusion import DepthMap
from .lens import distort
from .listing import frames_of, has_pose, inside, number, read_json_object
from .mesh_files import MAX_COORDINATE
from .nerfstudio import view_of_frame
from .photo_files import open_photo
from .pose_folders import MAX_TUM_BYTES, TUM_CLOCKS, read_matrix
from .programs import find_program, read_program_views

MAX_DEPTH_BYTES = 256 << 20
MILLIMETERS, TUM_UNIT, FULL = 0.001, 1 / 5000, 65535
AGAIN = "export the depth again, as PNG of 16 bits"
SAME_SHAPE = 0.02
"""Relative difference of the shapes of a photo and its depth map, up to which they show the same."""


def posed_depth(path: Path) -> list[DepthMap]:
    """The depth maps of a capture that have a pose; none where the format has no depth. They are read when used.

    Raises:
        BadInput: a file that lists them is damaged.
    """
    transforms = path / "transforms.json" if path.is_dir() else path
    if transforms.suffix.lower() == ".json" and transforms.is_file() and (path.is_dir() or find_program(path) is None):
        return _of_transforms(transforms)
    found = find_program(path)
    if found is None or not path.is_dir():
        return []
    program, source = found
    views = [view for view in read_program_views(path, program, source) if view.photo is not None]
    if program.name == "ScanNet":
        own = path / "intrinsic" / "intrinsic_depth.txt"
        return _beside(views, _of_scannet, MILLIMETERS, read_matrix(own) if own.is_file() else None)
    if program.name == "TUM RGB-D":
        return _of_tum(path, views)
    scale, depth_of = BESIDE.get(program.name, (MILLIMETERS, None))
    return [] if depth_of is None else _beside(views, depth_of, scale)


def _of_transforms(transforms: Path) -> list[DepthMap]:
    meta = read_json_object(transforms)
    scale = number(meta, "depth_unit_scale_factor", transforms) if "depth_unit_scale_factor" in meta else MILLIMETERS
    if "applied_scale" in meta:  # of the poses, not of the depth
        scale *= number(meta, "applied_scale", transforms)
    maps = []
    for frame in frames_of(meta, transforms):
        if not isinstance(frame.get("depth_file_path"), str) or not has_pose(frame.get("transform_matrix")):
            continue
        depth = inside(transforms.parent, frame["depth_file_path"], transforms)
        if depth.is_file():
            view = view_of_frame(meta, frame, transforms)
            maps.append(DepthMap(_camera(view, depth), partial(_read, view, depth, scale)))
    return maps


def _of_scannet(photo: Path) -> Path:
    return photo.parent.parent / "depth" / f"{photo.stem}.png"


def _of_seven_scenes(photo: Path) -> Path:
    return photo.with_name(photo.name.replace(".color.", ".depth."))


def _of_polycam(photo: Path) -> Path:
    return photo.parent.parent / "depth" / f"{photo.stem}.png"


def _of_record3d(photo: Path) -> Path:
    return photo.parent.parent / "depth" / f"{photo.stem}.exr"


def _of_arkit_scenes(photo: Path) -> Path:
    return photo.parent.parent / "lowres_depth" / f"{photo.stem}.png"


BESIDE = {
    "7-Scenes": (MILLIMETERS, _of_seven_scenes),
    "Polycam": (MILLIMETERS, _of_polycam),
    "Record3D": (1.0, _of_record3d),
    "ARKitScenes": (MILLIMETERS, _of_arkit_scenes),
}
"""Metres to a number of the depth maps of a program, and where that of a photo lies."""


def _beside(
    views: list[View], depth_of: Callable[[Path], Path], scale: float, lens: NDArray | None = None
) -> list[DepthMap]:
    """Each photo with the depth map that lies beside it; ``lens`` (4, 4) is that of the depth camera."""
    maps = []
    for view in views:
        assert view.photo is not None
        depth = depth_of(view.photo)
        if depth != view.photo and depth.is_file():
            camera = _camera(view, depth) if lens is None else _camera_of(lens, view, depth)
            maps.append(DepthMap(camera, partial(_read, view, depth, scale)))
    return maps


def _of_tum(root: Path, views: list[View]) -> list[DepthMap]:
    """Each photo with the depth map that was taken next to it."""
    listed = root / "depth.txt"
    if not listed.is_file():
        return []
    with open_text(listed, MAX_TUM_BYTES, mend="download the sequence again") as file:
        rows = [line.partition("#")[0].split(maxsplit=1) for line in file]
    with decoding(listed, mend="download the sequence again"):
        taken = sorted((number_in_text(row[0]), row[1].strip()) for row in rows if len(row) == 2)
    times, maps = [time for time, _ in taken], []
    for view in views:
        assert view.photo is not None
        try:
            time = float(view.photo.stem)
        except ValueError:
            continue
        at = bisect_left(times, time)
        near = min(range(max(at - 1, 0), min(at + 1, len(times))), key=lambda k: abs(times[k] - time), default=None)
        if near is None or abs(times[near] - time) > TUM_CLOCKS:
            continue
        depth = inside(root, taken[near][1], listed)
        if depth.is_file():
            maps.append(DepthMap(_camera(view, depth), partial(_read, view, depth, TUM_UNIT)))
    return maps


# ---- One map --------------------------------------------------------------------------------------------------------


def _camera(view: View, depth: Path) -> Camera:
    """The camera of a photo in the pixels of its depth map, which shows the same."""
    width, height = _size(depth)
    camera = view.camera
    if abs(width * camera.height / (height * camera.width) - 1) > SAME_SHAPE:
        what = f"is {width}x{height} pixels, its photo {camera.width}x{camera.height}: another shape"
        raise BadInput(what, "give depth that is registered to the photos", depth)
    return camera.resized(width, height)


def _camera_of(lens: NDArray[np.float64], view: View, depth: Path) -> Camera:
    width, height = _size(depth)
    fx, fy, cx, cy = lens[0, 0], lens[1, 1], lens[0, 2], lens[1, 2]
    return replace(view.camera, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)


def _size(depth: Path) -> tuple[int, int]:
    if depth.suffix.lower() == ".npy":
        return _stored(depth).shape[1], _stored(depth).shape[0]
    if depth.suffix.lower() in HDR_SUFFIXES:
        return exr_size(depth)
    with open_photo(depth) as image:
        return image.size


def _stored(depth: Path) -> NDArray:
    """(H, W) numbers of a file; raises BadInput where they are none of depth."""
    if depth.suffix.lower() == ".npy":
        found = read_npy(depth, MAX_DEPTH_BYTES, AGAIN)
        found = found[..., 0] if found.ndim == 3 else found
        if found.ndim != 2:
            raise BadInput(f"has the shape {found.shape}", AGAIN, depth)
        return found
    if depth.suffix.lower() in HDR_SUFFIXES:
        return read_exr(depth)[..., 0]
    with open_photo(depth) as image:
        if not image.mode.startswith(("I", "F")):
            raise BadInput("is a picture and no depth map of 16 bits", AGAIN, depth)
        return np.asarray(image)


def _read(view: View, depth: Path, scale: float) -> NDArray[np.float32]:
    """(H, W) metres along the view axis of a pinhole, 0 where nothing is known."""
    numbers = _stored(depth)
    with np.errstate(over="ignore", invalid="ignore"):
        far = numbers.astype(np.float64) * scale
    known = (far > 0) & (far <= MAX_COORDINATE)
    if numbers.dtype.kind in "iu":
        known &= numbers != FULL
    known &= _trusted(depth, known.shape)
    metres = np.where(known, far, 0).astype(np.float32)
    return metres if view.distortion is None else _straight(metres, view.camera, view.distortion)


def _trusted(depth: Path, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(H, W) what a map of confidence beside Polycam's depth does not call low."""
    confidence = depth.parent.parent / "confidence" / f"{depth.stem}.png"
    if depth.parent.name != "depth" or not confidence.is_file():
        return np.ones(shape, bool)
    with open_photo(confidence) as image:
        level = np.asarray(image)
    return level > 0 if level.shape == shape else np.ones(shape, bool)


def _straight(metres: NDArray[np.float32], camera: Camera, lens: Distortion) -> NDArray[np.float32]:
    """The map under a pinhole: each pixel has the depth of that which the lens puts there, and no mean of two."""
    height, width = metres.shape
    pinhole = camera.resized(width, height)
    i, j = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x, y, unique = distort((i - pinhole.cx) / pinhole.fx, (j - pinhole.cy) / pinhole.fy, lens)
    u, v = np.floor(x * pinhole.fx + pinhole.cx), np.floor(y * pinhole.fy + pinhole.cy)
    with np.errstate(invalid="ignore"):
        seen = unique & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    at = np.where(seen, v, 0).astype(int), np.where(seen, u, 0).astype(int)
    return np.where(seen, metres[at], 0).astype(np.float32)
