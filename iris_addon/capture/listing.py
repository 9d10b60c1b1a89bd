"""Reading what a capture folder names, without trusting it: sizes, types and paths are checked here."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.files import read_json
from ..base.images import IMAGE_SUFFIXES
from ..model.capture import View
from .mesh_files import MESH_SUFFIXES, ply_counts

MAX_JSON_BYTES = 64 * 1024 * 1024
MAX_ARRAY_BYTES = 16 * 1024 * 1024


def read_json_object(path: Path) -> dict[str, Any]:
    """The JSON object in ``path``; raises BadInput when missing, too large or anything else than an object."""
    if not path.is_file():
        raise BadInput("no such file", "check the path of the capture", path)
    return read_json(path, MAX_JSON_BYTES, "export it again, a very large capture in parts")


def frames_of(meta: Mapping[str, Any], path: Path) -> list[dict[str, Any]]:
    """The "frames" of a transforms file, at least one; raises BadInput."""
    frames = meta.get("frames")
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise BadInput('has no list of "frames"', "export the poses again", path)
    return frames


def number(values: Mapping[str, Any], key: str, path: Path) -> float:
    """``values[key]`` as a finite float; raises BadInput."""
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise BadInput(f'"{key}" is {value!r}', "give it a finite number", path)
    return float(value)


def inside(root: Path, named: str, source: Path) -> Path:
    """The file that ``source`` calls ``named``, relative to ``root``.

    Raises:
        BadInput: the path is absolute or leaves the capture folder, by ".." or through a symbolic link.
    """
    relative = Path(named.replace("\\", "/"))
    path = root / relative
    try:
        escapes = relative.is_absolute() or not path.resolve().is_relative_to(root.resolve())
        path.with_name(path.name + ".jpeg").is_file()  # the longest name anybody will look for
    except (OSError, ValueError, RuntimeError) as error:  # over-long name, NUL byte, loop of links
        raise BadInput(f"names {named[:80]!r}, which is not a usable path", "correct the path", source) from error
    if escapes:
        raise BadInput(f"names {named[:80]!r}, outside the capture folder", "move the file into the folder", source)
    return path


def find_image(root: Path, named: str, source: Path) -> Path | None:
    """The image called ``named`` with or without its extension, or None when there is none.

    Raises:
        BadInput: it is outside ``root``, or of a format that is not read.
    """
    path = inside(root, named, source)
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return path if path.is_file() else None
    for suffix in IMAGE_SUFFIXES:
        for candidate in (suffix, suffix.upper()):
            with_suffix = path.with_name(path.name + candidate)
            if with_suffix.is_file():
                return inside(root, str(with_suffix.relative_to(root)), source)
    if path.suffix and path.is_file():
        raise BadInput("is no PNG, JPEG or EXR", "save it as one of them", path)
    return None


def load_array(path: Path, length: int, what: str) -> NDArray[np.float64]:
    """(length,) float64 from a .npy file; raises BadInput for another length or content."""
    if not path.is_file():
        raise BadInput("no such file", "check the path", path)
    if path.stat().st_size > MAX_ARRAY_BYTES:
        raise BadInput(f"is larger than {MAX_ARRAY_BYTES >> 20} MiB", f"give one number per {what}", path)
    try:
        values = np.asarray(np.load(path, allow_pickle=False), np.float64).ravel()
    except (ValueError, TypeError, OSError, EOFError) as error:
        raise BadInput(f"is not a .npy file of numbers ({error})", "write it again with numpy.save", path) from error
    if len(values) != length:
        raise BadInput(f"has {len(values)} values for {length} {what}s", f"give one number per {what}", path)
    return values


# ---- What a reader of one capture format finds before any photo or mesh is opened -----------------------------------


LEAST_UP = 0.1
"""Length of the mean of unit up vectors below which they say nothing."""


@dataclass(frozen=True)
class Listing:
    """Cameras, paths and recorded exposures of a capture folder.

    Attributes:
        mesh_file: the mesh to read.
    """

    name: str
    root: Path
    source: Path
    views: tuple[View, ...]
    val_views: tuple[View, ...]
    mesh_file: Path
    up: tuple[float, float, float]
    warnings: tuple[str, ...] = ()


def safe_name(text: str) -> str:
    """``text`` as a file name: letters, digits, dots, dashes and underscores."""
    return re.sub(r"[^\w.-]+", "_", text).strip("._") or "view"


def view_names(photos: Sequence[str]) -> list[str]:
    """A name per photo, given relative paths: file stems where they are unique, otherwise whole paths."""
    paths = [PurePosixPath(photo.replace("\\", "/")) for photo in photos]
    stems = [safe_name(path.stem) for path in paths]
    return stems if len(set(stems)) == len(stems) else [safe_name(str(path.with_suffix(""))) for path in paths]


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
        raise BadInput("no mesh (PLY, OBJ or GLB) in the folder", "add the scan of the room", root)
    if len(found) > 1:
        names = ", ".join(path.name for path in found[:6])
        raise BadInput(f"several meshes ({names})", mend.format(source.name), root)
    return inside(root, found[0].name, source)


def is_point_cloud(path: Path) -> bool:
    """Whether a PLY file announces vertices and no faces."""
    return path.suffix.lower() == ".ply" and path.is_file() and not ply_counts(path).get("face", 0)


def mean_up(views: Sequence[View]) -> tuple[float, float, float] | None:
    """Unit mean of the up directions of photos, which people hold upright; None where those cancel out."""
    up = np.mean([view.camera.c2w[:3, 1] for view in views], axis=0)
    length = float(np.linalg.norm(up))
    if length < LEAST_UP:
        return None
    x, y, z = (up / length).tolist()
    return (x, y, z)


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
