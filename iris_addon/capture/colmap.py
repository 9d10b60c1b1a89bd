"""Captures in COLMAP's format: a sparse model of cameras and images, text or binary, beside a folder of photos.

Format: https://colmap.github.io/format.html. Poses there are world to camera with x right, y down, z forward; pixel
centres lie at half integers, as here. The room is the mesh; points are read where it is in another frame only.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.untrusted import decoding, finite, number_in_text, open_file, open_text
from ..model.capture import FloatArray, View
from .listing import (
    Listing,
    check_unique,
    find_image,
    mean_up,
    only_mesh,
    read_camera,
    read_distortion,
    up_axis,
    view_names,
)
from .mesh_files import MAX_COORDINATE, MESH_SUFFIXES
from .photo_files import PHOTO_SUFFIXES

MODEL_FOLDERS = (".", "sparse", "sparse/*", "colmap/sparse", "colmap/sparse/*")
"""Where sparse models may lie below a capture. COLMAP writes one for each group of photos that it could connect."""
MAX_ENTRIES = 100_000
MAX_NAME = 4096
MAX_BYTES = 4 << 30
MAX_KEPT_POINTS = 200_000
"""Every second, third … point is read of a model that has more."""
AGAIN = "export the model from COLMAP again"
_FOCAL, _FOCALS = ("fl_x", "cx", "cy"), ("fl_x", "fl_y", "cx", "cy")
PARAMETERS = {
    "SIMPLE_PINHOLE": _FOCAL,
    "PINHOLE": _FOCALS,
    "SIMPLE_RADIAL": (*_FOCAL, "k1"),
    "RADIAL": (*_FOCAL, "k1", "k2"),
    "OPENCV": (*_FOCALS, "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": (*_FOCALS, "k1", "k2", "k3", "k4"),
    "FULL_OPENCV": (*_FOCALS, "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "FOV": (*_FOCALS, "omega"),
    "SIMPLE_RADIAL_FISHEYE": (*_FOCAL, "k1"),
    "RADIAL_FISHEYE": (*_FOCAL, "k1", "k2"),
    "THIN_PRISM_FISHEYE": (*_FOCALS, "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"),
    "RAD_TAN_THIN_PRISM_FISHEYE": (),
    "SIMPLE_DIVISION": (),
    "DIVISION": (),
    "SIMPLE_FISHEYE": _FOCAL,
    "FISHEYE": _FOCALS,
}
"""Parameters of each camera model in COLMAP's order, by the names of a transforms file; none: it is not supported."""
MODEL_NAMES = tuple(PARAMETERS)
"""By the number in a binary file; higher numbers are models that are not supported."""
DOWN_FORWARD = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turns a pose of COLMAP's axes, x right, y down, z forward, into one of ours."""

Cameras = dict[int, dict[str, Any]]
"""Keys of a transforms file by camera id."""
Posed = tuple[str, int, tuple[float, ...]]
"""Photo's name, camera id, and quaternion (w, x, y, z) with translation, world to camera."""


def colmap_model(path: Path) -> Path | None:
    """The folder of the sparse model in or under ``path`` with most photos, None where there is none."""
    return max(_models(path), key=_count_images, default=None)


def _models(path: Path) -> list[Path]:
    """The folders of all sparse models in or under ``path``."""
    if not path.is_dir():
        return []
    places = [
        folder for name in MODEL_FOLDERS for folder in (sorted(path.glob(name)) if "*" in name else [path / name])
    ]
    return [folder for folder in places if _is_model(folder)]


def _is_model(folder: Path) -> bool:
    return any(all((folder / f"{part}.{kind}").is_file() for part in ("cameras", "images")) for kind in ("bin", "txt"))


def _count_images(model: Path) -> int:
    """Photos of a model; 0 for one that cannot be read."""
    source = _source(model)
    try:
        if source.suffix == ".txt":
            return len(_text_images(source))
        with open_file(source, MAX_BYTES, mend=AGAIN) as file, decoding(source, mend=AGAIN):
            return _count(file)
    except BadInput:
        return 0


def read_colmap(path: Path, model: Path) -> Listing:
    """List the capture ``path`` whose sparse model lies in ``model``; raises BadInput."""
    root, source = _root(path), _source(model)
    views = read_colmap_views(path, model)
    warnings = []
    others = [other for other in _models(path) if other != model]
    if others:
        counts = ", ".join(f"{other.relative_to(path).as_posix()} has {_count_images(other)}" for other in others)
        warnings.append(
            f"{model.relative_to(path).as_posix()} is used, with {len(views)} photos, as the largest of "
            f"{len(others) + 1} models ({counts}): what COLMAP could not connect is left out"
        )
    warnings += _unregistered(root, views)
    return Listing(
        name=root.resolve().name or "capture",
        root=root,
        source=source,
        views=views,
        val_views=(),
        mesh_file=_mesh_file(root, source),
        up=up_axis(root, mean_up(views) or (0.0, 0.0, 1.0)),
        warnings=tuple(warnings),
        unit="a COLMAP model has no unit",
        points=partial(read_colmap_points, model),
    )


def _unregistered(root: Path, views: Sequence[View]) -> list[str]:
    """A warning for photos in the folder that the model has no pose of."""
    folder = root / "images"
    if not folder.is_dir():
        return []
    used = {view.photo.resolve() for view in views if view.photo is not None}
    photos = [path for path in folder.rglob("*") if path.suffix.lower() in PHOTO_SUFFIXES]
    left = sorted(path.name for path in photos if path.resolve() not in used)
    if not left:
        return []
    names = ", ".join(left[:5]) + (" …" if len(left) > 5 else "")
    return [f"{len(left)} of {len(photos)} photos have no pose in the model and are left out: {names}"]


def read_colmap_views(path: Path, model: Path) -> tuple[View, ...]:
    """Every view of the model, photo or not: cameras to render from; raises BadInput."""
    source = _source(model)
    binary = source.suffix == ".bin"
    cameras = (_binary_cameras if binary else _text_cameras)(source.with_stem("cameras"))
    posed = sorted((_binary_images if binary else _text_images)(source))
    if not posed:
        raise BadInput("has no images", "let COLMAP register the photos first", source)
    views = _views(posed, cameras, _root(path), source)
    check_unique(views, source)
    return views


def read_colmap_points(model: Path) -> FloatArray | None:
    """(n, 3) sparse points of the model in the frame of its poses, None where it has none; raises BadInput."""
    source = next((path for kind in ("bin", "txt") if (path := model / f"points3D.{kind}").is_file()), None)
    if source is None:
        return None
    points = finite(_binary_points(source) if source.suffix == ".bin" else _text_points(source), (None, 3))
    if points is None or not (np.abs(points) <= MAX_COORDINATE).all():
        raise BadInput(f"has NaN, or points beyond {MAX_COORDINATE:g}", AGAIN, source)
    return points if len(points) else None


def _source(model: Path) -> Path:
    binary = (model / "images.bin").is_file() and (model / "cameras.bin").is_file()
    return model / ("images.bin" if binary else "images.txt")


def _root(path: Path) -> Path:
    """The folder of photos and mesh: ``path`` itself, or the one with the images above the folders of a model.

    A folder of another name is not left: the one above holds files that are no part of the capture.
    """
    folder = path.resolve()
    while not (folder / "images").is_dir() and (folder.name in ("sparse", "colmap") or folder.name.isdecimal()):
        folder = folder.parent
    return folder if (folder / "images").is_dir() else path


def _mesh_file(root: Path, source: Path) -> Path:
    """The mesh beside the photos, else the one that COLMAP's dense reconstruction made."""
    folders = (root, root / "dense", root / "dense" / "0")
    has_mesh = [f for f in folders if f.is_dir() and any(path.suffix.lower() in MESH_SUFFIXES for path in f.iterdir())]
    return only_mesh(has_mesh[0] if has_mesh else root, source, "leave one of them in the folder")


def _views(posed: Sequence[Posed], cameras: Cameras, root: Path, source: Path) -> tuple[View, ...]:
    views = []
    names = view_names([name for name, _, _ in posed])
    for (photo_name, camera_id, pose), name in zip(posed, names, strict=True):
        if camera_id not in cameras:
            raise BadInput(f"{name}: no camera {camera_id}", "export cameras and images together", source)
        photo = find_image(root, f"images/{photo_name}", source) or find_image(root, photo_name, source)
        values = {**cameras[camera_id], "transform_matrix": _camera_to_world(pose, name, source)}
        camera = read_camera(values, None, name, source)
        views.append(View(name, camera, photo, distortion=read_distortion(values, name, source)))
    return tuple(views)


def _camera_to_world(pose: Sequence[float], name: str, source: Path) -> np.ndarray:
    given = finite(pose, (7,), MAX_COORDINATE)
    length = 0.0 if given is None else float(np.linalg.norm(given[:4]))
    if given is None or not 0.9 < length < 1.1:
        raise BadInput(f"{name}: pose has NaN, or no unit quaternion", "remove the image from the model", source)
    w, x, y, z = given[:4] / length
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    world_to_camera[:3, 3] = pose[4:]
    return np.linalg.inv(world_to_camera) @ DOWN_FORWARD


def _camera(model: str, width: int, height: int, parameters: Sequence[float], path: Path) -> dict[str, Any]:
    names = PARAMETERS.get(model)
    if not names:
        known = ", ".join(name for name, listed in PARAMETERS.items() if listed)
        raise BadInput(f"camera model {model} is not supported", f"undistort the photos, or use {known}", path)
    if len(parameters) != len(names):
        raise BadInput(f"camera model {model} has {len(parameters)} parameters", "export the model again", path)
    return {"camera_model": model, "w": width, "h": height, **dict(zip(names, parameters, strict=True))}


# ---- Text -----------------------------------------------------------------------------------------------------------


def _lines(path: Path) -> Iterator[str]:
    """Lines that are not comments."""
    with open_text(path, MAX_BYTES, mend=AGAIN) as file:
        yield from (line.rstrip("\r\n") for line in file if not line.startswith("#"))


def _text_cameras(path: Path) -> Cameras:
    cameras: Cameras = {}
    with decoding(path, mend=AGAIN):
        for line in _lines(path):
            if word := line.split():
                parameters = [number_in_text(x) for x in word[4:]]
                cameras[int(word[0])] = _camera(word[1], int(word[2]), int(word[3]), parameters, path)
                _check_count(len(cameras))
    return cameras


def _text_images(path: Path) -> list[Posed]:
    """Two lines per image; the second, its points, may be empty, and some programs leave it out."""
    images: list[Posed] = []
    after_image = False
    with decoding(path, mend=AGAIN):
        for line in _lines(path):
            word = line.split(maxsplit=9)
            if after_image and not (len(word) == 10 and not _is_number(word[9].split()[-1])):
                after_image = False
            elif word:
                images.append((word[9].strip(), int(word[8]), tuple(float(x) for x in word[1:8])))
                _check_count(len(images))
                after_image = True
    return images


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _text_points(path: Path) -> NDArray[np.float64]:
    with decoding(path, mend=AGAIN):
        every, points = 1, []
        for index, line in enumerate(_lines(path)):
            if index % every:
                continue
            word = line.split(maxsplit=4)
            if len(word) > 3:
                points.append([number_in_text(x) for x in word[1:4]])
            if len(points) >= 2 * MAX_KEPT_POINTS:
                every, points = 2 * every, points[::2]
        return np.array(points, np.float64).reshape(-1, 3)


# ---- Binary ---------------------------------------------------------------------------------------------------------


def _unpack(file: BinaryIO, form: str) -> tuple[Any, ...]:
    data = file.read(struct.calcsize(form))
    return struct.unpack(form, data)


def _count(file: BinaryIO) -> int:
    count = int(_unpack(file, "<Q")[0])
    _check_count(count)
    return count


def _check_count(count: int) -> None:
    if count > MAX_ENTRIES:
        raise ValueError(f"more than {MAX_ENTRIES} entries")


def _binary_cameras(path: Path) -> Cameras:
    cameras: Cameras = {}
    with open_file(path, MAX_BYTES, mend=AGAIN) as file, decoding(path, mend=AGAIN):
        for _ in range(_count(file)):
            id_, model, width, height = _unpack(file, "<IiQQ")
            name = MODEL_NAMES[model] if 0 <= model < len(MODEL_NAMES) else f"number {model}"
            parameters = _unpack(file, f"<{len(PARAMETERS.get(name, ()))}d")
            cameras[id_] = _camera(name, width, height, parameters, path)
    return cameras


def _binary_images(path: Path) -> list[Posed]:
    images: list[Posed] = []
    with open_file(path, MAX_BYTES, mend=AGAIN) as file, decoding(path, mend=AGAIN):
        size = os.fstat(file.fileno()).st_size
        for _ in range(_count(file)):
            _, *pose, camera_id = _unpack(file, "<I7dI")
            name = _name(file)
            (points,) = _unpack(file, "<Q")
            if file.tell() + 24 * points > size:
                raise EOFError("it ends within the points of an image")
            file.seek(24 * points, 1)
            images.append((name, camera_id, tuple(pose)))
    return images


def _name(file: BinaryIO) -> str:
    """A null-terminated name."""
    text = bytearray()
    while (byte := file.read(1)) not in (b"\0", b""):
        text += byte
        if len(text) > MAX_NAME:
            raise ValueError("a name without an end")
    return text.decode("utf-8", errors="replace")


def _binary_points(path: Path) -> NDArray[np.float64]:
    points: list[tuple[float, ...]] = []
    with open_file(path, MAX_BYTES, mend=AGAIN) as file, decoding(path, mend=AGAIN):
        size = os.fstat(file.fileno()).st_size
        (count,) = _unpack(file, "<Q")
        every = -(-count // MAX_KEPT_POINTS)
        for index in range(count):
            _, x, y, z, *_, track = _unpack(file, "<Q3d3BdQ")
            if file.tell() + 8 * track > size:
                raise EOFError("it ends within the track of a point")
            file.seek(8 * track, 1)
            if index % every == 0:
                points.append((x, y, z))
    return np.array(points, np.float64).reshape(-1, 3)
