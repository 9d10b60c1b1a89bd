"""Meshes and poses in map coordinates: brought near the origin in double precision, before anything is single.

A georeferenced mesh lies 10⁵ to 10⁷ m from the origin, where single precision, in which rays are traced, has steps of
8 mm to a metre. Its photos may lie there too, or in a frame that their program has shifted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import BadInput
from ..base.untrusted import floats
from ..model.capture import FloatArray, Mesh, View
from .common_frame import extent

MAX_ORIGIN_RATIO = 50.0
"""Distance of mesh or cameras from the origin over the extent of the mesh. Rays are traced in single precision, whose
steps would be felt beyond."""
MAX_STEP_SHARE = 1e-3
"""Of the extent of a mesh, that the steps of the numbers in its file may be wide."""

Points = Callable[[], FloatArray | None]


@dataclass(frozen=True)
class MapOrigin:
    """Where on a map a capture lies, in the unit of its files.

    Attributes:
        mesh, poses: (3,) whole numbers that are taken off the vertices, and off the positions of cameras.
    """

    mesh: FloatArray
    poses: FloatArray

    @property
    def apart(self) -> bool:
        """Whether mesh and poses were moved differently, so that nothing is known of how they fit."""
        return not np.array_equal(self.mesh, self.poses)

    def views(self, views: Sequence[View]) -> list[View]:
        """The views of the capture's own files."""
        return [_shifted(view, self.poses) for view in views]

    def of_mesh(self, mesh: Mesh) -> Mesh:
        """The mesh of the file."""
        return replace(mesh, vertices=mesh.vertices - self.mesh) if self.mesh.any() else mesh

    def points(self, points: Points) -> Points:
        """Those that ``points`` reads in the frame of the poses."""
        return partial(_points, points, self.poses)

    def record(self) -> dict[str, list[float]] | None:
        """What report.json keeps; None where nothing is moved."""
        if not self.mesh.any() and not self.poses.any():
            return None
        return {"mesh": self.mesh.tolist(), "poses": self.poses.tolist()}

    def require_none(self, mesh_file: Path) -> None:
        """Require that nothing is moved: a Blender scene gets its result back where it stands.

        Raises:
            BadInput: the capture lies on a map.
        """
        if self.record() is not None:
            what = f"lies {np.linalg.norm(self.mesh if self.mesh.any() else self.poses):.3g} from the origin"
            shift = _text(-self.mesh if self.mesh.any() else -self.poses)
            raise BadInput(what, f"move mesh and cameras together to the origin, by ({shift})", mesh_file)

    def warnings(self, mesh_file: Path) -> list[str]:
        """What is done, as one warning or none."""
        if not self.mesh.any() and not self.poses.any():
            return []
        what = [f"{mesh_file.name} by ({_text(-self.mesh)})"] if self.mesh.any() else []
        what += [f"the poses by ({_text(-self.poses)})"] if self.poses.any() else []
        return [f"map coordinates: {' and '.join(what)} are moved to the origin, where the result stands"]


def map_origin(views: Sequence[View], mesh: Mesh, mesh_file: Path) -> MapOrigin:
    """What brings the mesh of ``mesh_file`` and the cameras of ``views`` near the origin.

    Both are moved alike where they lie together, else each by itself: how they fit is then looked for.

    Raises:
        BadInput: the file holds numbers too coarse for its mesh so far out.
    """
    positions = np.array([view.camera.position for view in views])
    center, cameras = np.median(mesh.vertices, axis=0), np.median(positions, axis=0)
    far = MAX_ORIGIN_RATIO * max(extent(mesh), 1e-9)
    path = float(np.median(np.linalg.norm(positions - cameras, axis=1)))  # poses in millimetres are far and apart
    of_mesh = np.round(center) if np.linalg.norm(center) > far else np.zeros(3)
    if np.linalg.norm(cameras - center) <= far:
        of_poses = of_mesh
    else:
        is_far = np.linalg.norm(cameras) > max(far, MAX_ORIGIN_RATIO * path)
        of_poses = np.round(cameras) if is_far else np.zeros(3)
    if of_mesh.any():
        _check_steps(mesh, mesh_file)
    return MapOrigin(of_mesh, of_poses)


def off_the_map(report: Mapping[str, Any], views: Sequence[View], *, frame: str) -> tuple[View, ...]:
    """The ``views`` of a file where the result of ``report`` stands; those that stand there are left.

    Args:
        frame: "mesh" or "poses", in whose frame the file is.
    """
    record = report.get("map_origin")
    origin = floats(record.get(frame), (3,)) if isinstance(record, Mapping) else None
    if origin is None or not np.isfinite(origin).all() or not views:
        return tuple(views)
    place = np.median([view.camera.position for view in views], axis=0)
    if np.linalg.norm(place) < np.linalg.norm(place - origin):
        return tuple(views)
    return tuple(_shifted(view, origin) for view in views)


def _check_steps(mesh: Mesh, mesh_file: Path) -> None:
    single = mesh.vertices.astype(np.float32)
    step = float(np.spacing(np.abs(single).max(0)).max())
    if step > MAX_STEP_SHARE * extent(mesh) and np.array_equal(single, mesh.vertices):
        shift = _text(-np.round(np.median(mesh.vertices, axis=0)))
        raise BadInput(
            f"is in map coordinates, and its numbers are single, in steps of {step:.2g} there",
            f"export mesh and poses moved to the origin, by ({shift}), or the mesh as OBJ or as PLY of doubles",
            mesh_file,
        )


def _shifted(view: View, origin: FloatArray) -> View:
    if not origin.any():
        return view
    pose = view.camera.c2w.copy()
    pose[:3, 3] -= origin
    return replace(view, camera=replace(view.camera, c2w=pose))


def _points(points: Points, origin: FloatArray) -> FloatArray | None:
    found = points()
    return None if found is None else found - origin


def _text(values: FloatArray) -> str:
    return ", ".join(f"{value:.0f}" for value in (values + 0.0).tolist())
