"""What a capture folder lists: views, cameras, poses and paths, read without trusting the files.

Readers of the formats build a :class:`Listing` from these functions, before any photo or mesh is opened. Sizes, types
and paths are checked here.
"""

from __future__ import annotations

import math
import os
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.image_headers import MAX_PIXELS
from ..base.untrusted import finite, floats, read_json, read_npy
from ..model.capture import Camera, Distortion, FloatArray, View
from ..model.light_states import is_state_name
from .mesh_files import MAX_COORDINATE, MESH_SUFFIXES, ply_counts
from .photo_files import PHOTO_SUFFIXES, UPRIGHT, read_orientation, shown_up

MAX_JSON_BYTES = 64 * 1024 * 1024
MAX_ARRAY_BYTES = 16 * 1024 * 1024
MIN_UP_LENGTH = 0.1
"""Length of the mean of unit up vectors below which the mean has no direction."""

Y_UP, Z_UP = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
UPRIGHT_COSINE = 0.5
"""Cosine between +z and the mean up, or backward, direction of the photos above which +z is up."""
AXIS_COSINE = 0.9
"""Cosine between an axis and that mean from which the axis is up."""

MAX_FIELD_OF_VIEW = math.radians(170.0)
MAX_NAME_BYTES = 200
"""Of the name of a view, which pictures of it are called by."""
MAX_LIGHT_STATES = 16
"""Of a capture: what each is solved from takes memory of its own."""
RIGID_TOLERANCE = 1e-3
"""Deviation from a rotation matrix; files keep three decimals at least."""

PERSPECTIVE_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "FULL_OPENCV", "FOV")
FISHEYE_MODELS = (
    "OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "SIMPLE_FISHEYE", "FISHEYE"
)  # fmt: skip
OTHER_MESHES = (".usdz", ".usd", ".usdc", ".usda", ".fbx", ".gltf", ".stl", ".dae")
"""Suffixes of meshes that Blender imports and that are not read here."""
MIN_OMEGA = 1e-3
"""Radians of the FOV model below which nothing moves by a tenth of a pixel in ten thousand."""
DENOMINATOR = {"k4": "d1", "k5": "d2", "k6": "d3"}
"""Our names of OpenCV's coefficients in the denominator."""

FUSED_MESH = "fused_mesh.ply"
"""Name of the mesh that was made of a capture's own depth, in the frame of its poses."""
LEFT_UP_FORWARD = np.diag([-1.0, 1.0, -1.0, 1.0])
"""Turns a FIPT/Mitsuba pose, with columns x left, y up, z forward, into one of ours: x right, y up, z backward."""


@dataclass(frozen=True)
class Listing:
    """Cameras, paths and recorded exposures of a capture folder.

    Attributes:
        root: folder that all paths lie in.
        source: the file that lists the photos; named by errors.
        views, val_views: training and held-out photos.
        mesh_file: the mesh to read.
        up: unit vector that points away from the floor.
        up_is_stated: whether the format of the poses states ``up``, and not how photos lie.
        unposed: names of photos that the file lists without a pose.
        unit: why one unit of poses and mesh is assumed to be one metre; "" where the source says so.
        points: reads the sparse points (n, 3) of the photos in the frame of the poses, None without any; raises
            BadInput.
        one_frame: poses and mesh are known to be in one frame, because they were written together; none is searched.
    """

    name: str
    root: Path
    source: Path
    views: tuple[View, ...]
    val_views: tuple[View, ...]
    mesh_file: Path
    up: tuple[float, float, float]
    warnings: tuple[str, ...] = ()
    unposed: tuple[str, ...] = ()
    one_frame: bool = False
    up_is_stated: bool = False
    unit: str = ""
    points: Callable[[], FloatArray | None] = lambda: None


# ---- Values and paths -----------------------------------------------------------------------------------------------


def read_json_object(path: Path) -> dict[str, Any]:
    """The JSON object in ``path``; raises BadInput when missing, too large or not an object."""
    return read_json(path, MAX_JSON_BYTES, "export it again, a very large capture in parts")


def frames_of(meta: Mapping[str, Any], path: Path) -> list[dict[str, Any]]:
    """The "frames" of a transforms file, at least one; raises BadInput."""
    frames = meta.get("frames")
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise BadInput('has no list of "frames"', "export the poses again", path)
    return frames


def number(values: Mapping[str, Any], key: str, path: Path) -> float:
    """``values[key]`` as a finite float; raises BadInput."""
    found = finite(values[key])
    if found is None:
        raise BadInput(f'"{key}" is {values[key]!r}', "give it a finite number", path)
    return float(found)


def inside(root: Path, named: str, source: Path) -> Path:
    """The file that ``source`` calls ``named``, relative to ``root`` or absolute below it.

    A name that differs from the file's in case or Unicode's normal form is matched if one file fits: folders come from
    systems that take these for the same.

    Raises:
        BadInput: the path leaves the capture folder, by ".." or through a symbolic link.
    """
    relative = Path(named.replace("\\", "/"))
    outside = BadInput(f"names {named[:80]!r}, outside the capture folder", "move the file into the folder", source)
    # Before the disk is asked: Windows logs on to the server of a path like //server/share to see whether it exists.
    path = root / relative
    try:
        if not _may_lie_in(root, path):
            raise outside
        if not path.resolve().is_relative_to(root.resolve()):
            raise outside
        path.with_name(path.name + ".jpeg").is_file()  # the longest name anybody will look for
        return path if path.exists() else _spelled_on_disk(root, path)
    except (OSError, ValueError, RuntimeError) as error:  # over-long name, NUL byte, loop of links
        raise BadInput(f"names {named[:80]!r}, which is not a usable path", "correct the path", source) from error


def _may_lie_in(root: Path, path: Path) -> bool:
    """Whether ``path`` lies below ``root`` by its letters, links not looked at."""
    whole = os.path.normpath(path.absolute())
    return any(Path(whole).is_relative_to(os.path.normpath(at)) for at in (root.absolute(), os.path.realpath(root)))


def _spelled_on_disk(root: Path, path: Path) -> Path:
    """``path`` below ``root`` with each part as the disk spells it, where one entry fits; else ``path`` as it is."""
    try:
        parts = path.resolve().relative_to(root.resolve()).parts
    except ValueError:
        return path
    found = root
    for part in parts:
        if not (found / part).exists():
            names = _entries(found).get(_folded(part), [])
            if len(names) != 1:
                return path
            part = names[0]
        found /= part
    return found if found.resolve().is_relative_to(root.resolve()) else path


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def _entries(folder: Path) -> dict[str, list[str]]:
    """Names in a folder by their folded form."""
    entries: dict[str, list[str]] = {}
    if folder.is_dir():
        for entry in folder.iterdir():
            entries.setdefault(_folded(entry.name), []).append(entry.name)
    return entries


def named_like(folder: Path, pattern: str) -> list[Path]:
    """Files of ``folder`` in order of their names, without hidden ones: macOS writes ``._003.json`` beside ``003.json``
    on disks of other systems."""
    return sorted(path for path in folder.glob(pattern) if not path.name.startswith("."))


def find_image(root: Path, named: str, source: Path) -> Path | None:
    """The image called ``named`` with or without its extension, or None when there is none.

    Raises:
        BadInput: it is outside ``root``, or of a format that is not read.
    """
    path = inside(root, named, source)
    if path.suffix.lower() in PHOTO_SUFFIXES:
        return path if path.is_file() else None
    for suffix in PHOTO_SUFFIXES:
        for candidate in (suffix, suffix.upper()):
            with_suffix = path.with_name(path.name + candidate)
            if with_suffix.is_file():
                return inside(root, str(with_suffix.relative_to(root)), source)
    if path.suffix and path.is_file():
        raise BadInput("is of no format that is read", "save it as PNG, JPEG, TIFF, WebP, AVIF, HEIC, EXR or DNG", path)
    return None


def find_mask(frame: Mapping[str, Any], name: str, root: Path, source: Path) -> Path | None:
    """The picture of the "mask_path" of the frame of the view ``name``, None where it has none; raises BadInput."""
    if not frame.get("mask_path"):
        return None
    mask = find_image(root, str(frame["mask_path"]), source)
    if mask is None:
        raise BadInput(f"{name}: mask {frame['mask_path']!r} is missing", "add it or remove its key", source)
    return mask


def load_array(path: Path, length: int, what: str) -> NDArray[np.float64]:
    """(length,) float64 from a .npy file; raises BadInput for another length or content."""
    values = read_npy(path, MAX_ARRAY_BYTES, f"write one number per {what} with numpy.save").astype(np.float64).ravel()
    if len(values) != length:
        raise BadInput(f"has {len(values)} values for {length} {what}s", f"give one number per {what}", path)
    return values


# ---- Names, mesh and up vector --------------------------------------------------------------------------------------


def safe_name(text: str) -> str:
    """``text`` as a file name: letters, digits, dots, dashes and underscores."""
    name = re.sub(r"[^\w.-]+", "_", text).encode(errors="replace")[:MAX_NAME_BYTES].decode(errors="ignore")
    return name.strip("._") or "view"


def view_names(photos: Sequence[str]) -> list[str]:
    """A name per photo, given relative paths: file stems where they are unique, otherwise whole paths."""
    paths = [PurePosixPath(photo.replace("\\", "/")) for photo in photos]
    stems = [safe_name(path.stem) for path in paths]
    if len(set(stems)) == len(stems):
        return stems
    return [safe_name(str(path.with_suffix("") if path.name else path)) for path in paths]


def light_states(frames: Sequence[Mapping[str, Any]], names: Sequence[str], source: Path) -> list[str]:
    """The "light_state" of each frame, "" for all where none has one.

    Raises:
        BadInput: one is no short text, some frames have one and others do not, or there are too many.
    """
    found = [frame.get("light_state") for frame in frames]
    if all(state is None for state in found):
        return [""] * len(found)
    for name, state in zip(names, found, strict=True):
        if state is None:
            fix = "give every frame the name of its light state, or none"
            raise BadInput(f'{name} has no "light_state" although other frames have one', fix, source)
        if not is_state_name(state):
            fix = "name it by up to 40 letters, digits, spaces and - . _ + (63 bytes of UTF-8), no space or - first"
            raise BadInput(f'{name} has the "light_state" {state!r}', fix, source)
    if len(set(found)) > MAX_LIGHT_STATES:
        what = f"names {len(set(found))} light states, more than {MAX_LIGHT_STATES}"
        raise BadInput(what, "give all photos under one set of lamps one name", source)
    return [str(state) for state in found]


def check_unique(views: Iterable[View], source: Path) -> None:
    """Raise BadInput when two views have one name."""
    seen: set[str] = set()
    for view in views:
        if view.name in seen:
            raise BadInput(f"lists the view {view.name} twice", "remove one of the two frames", source)
        seen.add(view.name)


def only_mesh(root: Path, source: Path, mend: str = 'name one with "mesh" in {}') -> Path:
    """The one mesh file in ``root``; raises BadInput when there is none or a choice, for which ``mend`` is advice."""
    files = [path for path in root.iterdir() if path.suffix.lower() in MESH_SUFFIXES and path.name[0] != "."]
    found = sorted([path for path in files if not is_point_cloud(path)] or files)
    if not found:
        other = next((path.name for path in sorted(root.iterdir()) if path.suffix.lower() in OTHER_MESHES), None)
        mend = "add the scan of the room" if other is None else f"import {other} into Blender and export it as GLB"
        raise BadInput("no mesh (PLY, OBJ or GLB) in the folder", mend, root)
    if len(found) > 1:
        names = ", ".join(path.name for path in found[:6])
        raise BadInput(f"several meshes ({names})", mend.format(source.name), root)
    return inside(root, found[0].name, source)


def is_point_cloud(path: Path) -> bool:
    """Whether a PLY file announces vertices and no faces."""
    return path.suffix.lower() == ".ply" and path.is_file() and not ply_counts(path).get("face", 0)


def mean_up(views: Sequence[View]) -> tuple[float, float, float] | None:
    """Unit mean of the up directions of photos, which people hold upright; None where those cancel out.

    A photo stored on its side, as EXIF tells, has its up there too.
    """
    up = np.mean([view.camera.c2w[:3, :3] @ _up_in_camera(view) for view in views], axis=0)
    length = float(np.linalg.norm(up))
    if length < MIN_UP_LENGTH:
        return None
    x, y, z = (up / length).tolist()
    return (x, y, z)


def upright(views: Sequence[View]) -> tuple[float, float, float]:
    """+z, unless photos clearly lie on their side under it; then an axis, or their mean up.

    RGB-D recorders take their axes from the first photo, with y down. An axis near the mean is more likely than the
    mean itself, which leans where all photos look down in one direction.
    """
    if not views:
        return Z_UP
    mean = mean_up(views)
    down = float(np.mean([view.camera.c2w[:3, 2] for view in views], axis=0) @ Z_UP)
    if mean is None or max(float(np.dot(mean, Z_UP)), down) > UPRIGHT_COSINE:  # upright, or looking down from above
        return Z_UP
    return axis_near(mean)


def axis_near(mean: tuple[float, float, float]) -> tuple[float, float, float]:
    """The axis next to a mean up direction, or that itself where none is."""
    axis = np.rint(mean) + 0.0  # no negative zeros
    if float(axis @ mean) < AXIS_COSINE or np.abs(axis).sum() != 1:
        return mean
    x, y, z = axis.tolist()
    return (x, y, z)


def _up_in_camera(view: View) -> FloatArray:
    held = view.photo is not None and view.photo.is_file() and view.orientation == UPRIGHT
    return np.array(shown_up(read_orientation(view.photo) if held and view.photo is not None else UPRIGHT))


def up_axis(root: Path, default: tuple[float, float, float]) -> tuple[float, float, float]:
    """Up vector by "up_axis" ("+y", "-z" ...) of meta.json in ``root``, else ``default``; raises BadInput."""
    meta_file = root / "meta.json"
    if not meta_file.is_file():
        return default
    text = read_json_object(meta_file).get("up_axis")
    if text is None:
        return default
    match = re.fullmatch(r"([+-]?)([xyz])", str(text).strip().lower())
    if match is None:
        raise BadInput(f'"up_axis" is {text!r}', "give one of +x, -x, +y, -y, +z, -z", meta_file)
    sign = -1.0 if match[1] == "-" else 1.0
    x, y, z = (sign if axis == match[2] else 0.0 for axis in "xyz")
    return (x, y, z)


# ---- Cameras --------------------------------------------------------------------------------------------------------


def read_camera(values: Mapping[str, Any], size: tuple[int, int] | None, label: str, path: Path) -> Camera:
    """Camera of one frame.

    Args:
        values: keys of the frame over those of the file: fl_x, fl_y, cx, cy, w, h, camera_angle_x, camera_angle_y and
            transform_matrix, (4, 4) or (3, 4), columns x right, y up, z backward.
        size: (width, height) of the photo, used where the file gives none.
        label: how errors call the frame.
        path: the file the values come from.

    Raises:
        BadInput: something is missing, not finite, or no camera could be like that.
    """
    if "w" in values and "h" in values:
        width, height = (int(number(values, key, path)) for key in ("w", "h"))
    elif size is not None:
        width, height = size
    else:
        raise BadInput(f'{label}: no image size ("w", "h")', "add both to the file", path)
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise BadInput(f"{label}: image size {width}x{height}", 'correct "w" and "h"', path)

    if "fl_x" in values:
        fx = number(values, "fl_x", path)
    elif "camera_angle_x" in values:
        fx = _focal(width, number(values, "camera_angle_x", path), label, path)
    else:
        raise BadInput(f'{label}: no focal length ("fl_x" or "camera_angle_x")', "add it to the file", path)
    if "fl_y" in values:
        fy = number(values, "fl_y", path)
    elif "fl_x" not in values and "camera_angle_y" in values:
        fy = _focal(height, number(values, "camera_angle_y", path), label, path)
    else:
        fy = fx
    cx = number(values, "cx", path) if "cx" in values else width / 2
    cy = number(values, "cy", path) if "cy" in values else height / 2

    _check_intrinsics(width, height, fx, fy, cx, cy, label, path)
    return Camera(
        width=width,
        height=height,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        c2w=read_pose(values.get("transform_matrix"), label, path),
    )


def _focal(pixels: int, angle: float, label: str, path: Path) -> float:
    if not 0 < angle < math.pi:
        raise BadInput(f"{label}: field of view {angle} rad", "give camera_angle_x in radians", path)
    return 0.5 * pixels / math.tan(0.5 * angle)


def _check_intrinsics(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float, label: str, path: Path
) -> None:
    for pixels, focal, center, axis in ((width, fx, cx, "x"), (height, fy, cy, "y")):
        if focal <= 0 or 2 * math.atan(0.5 * pixels / focal) > MAX_FIELD_OF_VIEW:
            raise BadInput(
                f"{label}: focal length {focal:g} px in {axis} for {pixels} pixels cannot be",
                "give it in pixels of the photo",
                path,
            )
        if not -0.5 * pixels <= center <= 1.5 * pixels:
            raise BadInput(
                f"{label}: principal point {center:g} px in {axis} is far outside {pixels} pixels",
                "give it in pixels of the photo",
                path,
            )


def has_pose(matrix: Any) -> bool:
    """Whether there is a matrix, right or wrong, and not a frame that was never posed: none, NaN or infinite."""
    try:
        return matrix is not None and bool(np.isfinite(np.array(matrix, np.float64)).all())
    except (TypeError, ValueError):
        return True


def read_pose(matrix: Any, label: str, path: Path) -> FloatArray:
    """(4, 4) rigid camera-to-world matrix from nested lists, (4, 4) or (3, 4); raises BadInput."""
    given = floats(matrix, (None, 4))
    if given is None or len(given) not in (3, 4):
        raise BadInput(f"{label}: transform_matrix is not 4x4", "export the poses again", path)
    if not (np.abs(given) <= MAX_COORDINATE).all():
        what = f"{label}: pose has NaN, or numbers beyond {MAX_COORDINATE:g}"
        raise BadInput(what, "remove the photo or export its pose again", path)
    pose = np.eye(4)
    pose[: len(given)] = given
    rotation = pose[:3, :3]
    deviation = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if deviation > RIGID_TOLERANCE or np.linalg.det(rotation) < 0 or not np.allclose(pose[3], (0, 0, 0, 1)):
        raise BadInput(
            f"{label}: pose is not a rotation and a translation",
            "export camera-to-world matrices without scale, shear or mirror",
            path,
        )
    return pose


def read_distortion(values: Mapping[str, Any], label: str, path: Path) -> Distortion | None:
    """Lens distortion of one frame, None for a pinhole; raises BadInput for a camera model not handled here."""
    model = str(values.get("camera_model", "OPENCV")).upper()
    if model not in PERSPECTIVE_MODELS + FISHEYE_MODELS:
        known = ", ".join(PERSPECTIVE_MODELS + FISHEYE_MODELS)
        raise BadInput(f"{label}: camera model {model} is not supported", f"undistort the photos, or use {known}", path)
    if model == "FOV":
        return _fov(number(values, "omega", path) if "omega" in values else 0.0, label, path)
    fisheye = model in FISHEYE_MODELS or values.get("is_fisheye") is True
    keys = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "sx1", "sy1")
    if model == "OPENCV_FISHEYE":
        keys = keys[:4]
    coefficients = {key: number(values, key, path) for key in keys if key in values}
    rational = model == "FULL_OPENCV" or coefficients.get("k5") or coefficients.get("k6")
    if rational and fisheye:
        raise BadInput(f"{label}: a fisheye with k5 or k6 is not supported", "undistort the photos", path)
    names = DENOMINATOR if rational else {}
    coefficients = {
        names.get(key, key): coefficients[key] for key in coefficients if key in names or key[1] not in "56"
    }
    if not fisheye and not any(coefficients.values()):
        return None
    return Distortion(**coefficients, fisheye=fisheye)


def _fov(omega: float, label: str, path: Path) -> Distortion | None:
    """The FOV model; COLMAP keeps the perspective for 0, and any sign gives the same lens."""
    if abs(omega) >= math.pi:
        raise BadInput(f"{label}: omega is {omega:g}", "give the field of view of the FOV model in radians", path)
    return None if abs(omega) < MIN_OMEGA else Distortion(omega=abs(omega))
