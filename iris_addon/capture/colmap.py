"""Captures in COLMAP's format: a sparse model of cameras and images, text or binary, beside a folder of photos.

Format: https://colmap.github.io/format.html. Poses there are world to camera with x right, y down, z forward; pixel
centres lie at half integers, as here. Points are not read: the room is the mesh.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..base.errors import BadInput
from ..model.capture import View
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
from .mesh_files import MESH_SUFFIXES

MODEL_FOLDERS = (".", "sparse/0", "sparse", "colmap/sparse/0")
"""Where a sparse model may lie below a capture."""
MAX_ENTRIES = 100_000
MAX_NAME = 4096
MAX_TEXT_BYTES = 1 << 30
_FOCAL, _FOCALS = ("fl_x", "cx", "cy"), ("fl_x", "fl_y", "cx", "cy")
PARAMETERS = {
    "SIMPLE_PINHOLE": _FOCAL,
    "PINHOLE": _FOCALS,
    "SIMPLE_RADIAL": (*_FOCAL, "k1"),
    "RADIAL": (*_FOCAL, "k1", "k2"),
    "OPENCV": (*_FOCALS, "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": (*_FOCALS, "k1", "k2", "k3", "k4"),
}
"""Parameters of each camera model in COLMAP's order, by the names of a transforms file."""
MODEL_NAMES = tuple(PARAMETERS)
"""By the number in a binary file; higher numbers are models that are not supported."""
DOWN_FORWARD = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turns a pose of COLMAP's axes, x right, y down, z forward, into one of ours."""

Cameras = dict[int, dict[str, Any]]
"""Keys of a transforms file by camera id."""
Posed = tuple[str, int, tuple[float, ...]]
"""Photo's name, camera id, and quaternion (w, x, y, z) with translation, world to camera."""


def colmap_model(path: Path) -> Path | None:
    """The folder of the sparse model in or under ``path``, None where there is none."""
    for folder in (path / name for name in MODEL_FOLDERS):
        if any(all((folder / f"{part}.{kind}").is_file() for part in ("cameras", "images")) for kind in ("bin", "txt")):
            return folder
    return None


def read_colmap(path: Path, model: Path) -> Listing:
    """List the capture ``path`` whose sparse model lies in ``model``; raises BadInput."""
    root, source = _root(path), _source(model)
    views = read_colmap_views(path, model)
    for view in views:
        if view.photo is None:
            raise BadInput(f"{view.name}: its photo is missing", f"put the photos into {root.name}/images", source)
    return Listing(
        name=root.resolve().name or "capture",
        root=root,
        source=source,
        views=views,
        val_views=(),
        mesh_file=_mesh_file(root, source),
        up=up_axis(root, mean_up(views) or (0.0, 0.0, 1.0)),
        warnings=("a COLMAP model has no unit: one unit of it is taken as one metre",),
    )


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


def _source(model: Path) -> Path:
    binary = (model / "images.bin").is_file() and (model / "cameras.bin").is_file()
    return model / ("images.bin" if binary else "images.txt")


def _root(path: Path) -> Path:
    """The folder of photos and mesh: ``path`` itself, or the one above it that has the images."""
    folder = path.resolve()
    return next((f for f in (folder, *folder.parents[:3]) if (f / "images").is_dir()), path)


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
    w, x, y, z = quaternion = np.array(pose[:4])
    length = float(np.linalg.norm(quaternion))
    if not np.isfinite(pose).all() or not 0.9 < length < 1.1:
        raise BadInput(f"{name}: pose has NaN, or no unit quaternion", "remove the image from the model", source)
    w, x, y, z = quaternion / length
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
    if names is None:
        known = ", ".join(PARAMETERS)
        raise BadInput(f"camera model {model} is not supported", f"undistort the photos, or use {known}", path)
    if len(parameters) != len(names):
        raise BadInput(f"camera model {model} has {len(parameters)} parameters", "export the model again", path)
    return {"camera_model": model, "w": width, "h": height, **dict(zip(names, parameters, strict=True))}


# ---- Text -----------------------------------------------------------------------------------------------------------


def _lines(path: Path) -> Iterator[str]:
    """Lines that are not comments."""
    if path.stat().st_size > MAX_TEXT_BYTES:
        raise BadInput(f"is larger than {MAX_TEXT_BYTES >> 30} GiB", "export the model as binary", path)
    with path.open(encoding="utf-8", errors="replace") as file:
        yield from (line.rstrip("\r\n") for line in file if not line.startswith("#"))


@contextmanager
def _damage_reported(path: Path) -> Iterator[None]:
    """Raise BadInput for the errors of parsing a damaged file."""
    try:
        yield
    except (ValueError, IndexError, struct.error, EOFError) as error:
        raise BadInput(f"is damaged ({error})", "export the model from COLMAP again", path) from error


def _text_cameras(path: Path) -> Cameras:
    cameras: Cameras = {}
    with _damage_reported(path):
        for line in _lines(path):
            if word := line.split():
                parameters = [float(x) for x in word[4:]]
                cameras[int(word[0])] = _camera(word[1], int(word[2]), int(word[3]), parameters, path)
    return cameras


def _text_images(path: Path) -> list[Posed]:
    """Two lines per image; the second, its points, may be empty."""
    images: list[Posed] = []
    lines = _lines(path)
    with _damage_reported(path):
        for line in lines:
            if line.strip():
                word = line.split(maxsplit=9)
                images.append((word[9].strip(), int(word[8]), tuple(float(x) for x in word[1:8])))
                next(lines, None)
    return images


# ---- Binary ---------------------------------------------------------------------------------------------------------


def _unpack(file: BinaryIO, form: str) -> tuple[Any, ...]:
    data = file.read(struct.calcsize(form))
    return struct.unpack(form, data)


def _count(file: BinaryIO) -> int:
    count = int(_unpack(file, "<Q")[0])
    if count > MAX_ENTRIES:
        raise ValueError(f"{count} entries")
    return count


def _binary_cameras(path: Path) -> Cameras:
    cameras: Cameras = {}
    with _damage_reported(path), path.open("rb") as file:
        for _ in range(_count(file)):
            id_, model, width, height = _unpack(file, "<IiQQ")
            name = MODEL_NAMES[model] if 0 <= model < len(MODEL_NAMES) else f"number {model}"
            parameters = _unpack(file, f"<{len(PARAMETERS.get(name, ()))}d")
            cameras[id_] = _camera(name, width, height, parameters, path)
    return cameras


def _binary_images(path: Path) -> list[Posed]:
    images: list[Posed] = []
    size = path.stat().st_size
    with _damage_reported(path), path.open("rb") as file:
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
