"""What a reader of one capture format finds before any photo or mesh is opened."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from ..errors import BadInput
from .files import inside, read_json_object
from .meshes import MESH_SUFFIXES, ply_counts
from .types import View

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
