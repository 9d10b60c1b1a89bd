"""The mesh of a capture that has posed depth and no mesh: fused once, and kept beside the photos."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from trimesh import Trimesh
from trimesh.exchange.ply import export_ply

from ..base.errors import BadInput
from ..base.files import atomic_write
from ..model.capture import Mesh
from .colmap import colmap_model
from .depth_fusion import DepthMap, fuse
from .depth_maps import posed_depth
from .fipt import fipt_root
from .listing import FUSED_MESH, is_point_cloud, read_json_object
from .mesh_files import MESH_SUFFIXES

MAX_MAPS = 1500
"""Depth maps that are fused; of more, as many that are spread over the capture."""


@dataclass(frozen=True)
class FusedFile:
    """What was written.

    Attributes:
        maps: how many depth maps were fused.
        voxel: in metres.
    """

    path: Path
    faces: int
    maps: int
    voxel: float


def depth_without_mesh(path: Path) -> list[DepthMap]:
    """The depth maps of a capture that has no mesh; none where it has one, or no depth.

    Raises:
        BadInput: a file that lists them is damaged.
    """
    root = path if path.is_dir() else path.parent
    if not root.is_dir() or fipt_root(path) is not None:
        return []
    transforms = path / "transforms.json" if path.is_dir() else path
    if transforms.suffix.lower() == ".json" and transforms.is_file():
        if "mesh" in read_json_object(transforms):
            return []
    elif colmap_model(path) is not None:
        return []
    if any(entry.suffix.lower() in MESH_SUFFIXES and not is_point_cloud(entry) for entry in root.iterdir()):
        return []
    return posed_depth(path)


def keep_fused(path: Path, maps: Sequence[DepthMap], update: Callable[[float], None]) -> FusedFile:
    """Fuse ``maps`` of the capture ``path`` into a mesh in its folder, where its readers find it from then on."""
    return write_fused(path, maps, (path if path.is_dir() else path.parent) / FUSED_MESH, None, update)


def fuse_capture(path: Path, out: Path, voxel: float | None, update: Callable[[float], None]) -> FusedFile:
    """Fuse the depth of a capture into the PLY file ``out``, whether or not it has a mesh.

    Args:
        voxel: metres, by default as the depth allows.
        update: called with the finished share; may raise, as for a cancel.

    Raises:
        BadInput: no depth, or none that shows anything.
    """
    if not path.exists():
        raise BadInput("no such capture", "give a folder or a transforms.json", path)
    if out.suffix.lower() != ".ply":
        raise BadInput("is no name of a PLY file", "let it end in .ply", out)
    maps = posed_depth(path)
    if not maps:
        raise BadInput(
            "has no posed depth",
            'give frames a "depth_file_path", or a folder of Polycam, Record3D, ARKitScenes, ScanNet, 7-Scenes or TUM '
            "RGB-D with its depth",
            path,
        )
    return write_fused(path, maps, out, voxel, update)


def write_fused(
    path: Path, maps: Sequence[DepthMap], out: Path, voxel: float | None, update: Callable[[float], None]
) -> FusedFile:
    """Fuse ``maps`` of the capture ``path`` into ``out``, which appears whole or not at all.

    Raises:
        BadInput: they show nothing.
    """
    if len(maps) > MAX_MAPS:
        maps = [maps[k] for k in np.linspace(0, len(maps) - 1, MAX_MAPS).round().astype(int)]
    fused = fuse(maps, voxel, update)
    if not len(fused.mesh.faces):
        finer = "" if voxel is None else ", and leave --voxel out: none as fine may be resolved"
        raise BadInput(
            f"the {len(maps)} depth maps of the capture show no surface",
            f"check their unit (depth_unit_scale_factor) and that their poses are in meters{finer}",
            path,
        )
    atomic_write(out, lambda file: file.write_bytes(_ply(fused.mesh)))
    return FusedFile(out, len(fused.mesh.faces), len(maps), fused.voxel)


def _ply(mesh: Mesh) -> bytes:
    return bytes(export_ply(Trimesh(mesh.vertices, mesh.faces, process=False)))
