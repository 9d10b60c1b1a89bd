"""Checks on a whole capture: photos open and fit their cameras, mesh and poses share one frame and one unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base.errors import BadInput
from ..base.images import HDR_SUFFIXES, check_image
from ..model.capture import FloatArray, Mesh, View
from .photos import check_photo_size

GRID = 16
SEES_LITTLE = 0.05
UNIT_MISMATCH = 100.0
FAR_AWAY = 50.0
"""Times its own size from the origin; rays are traced in single precision, whose steps are then felt."""


def check_photos(views: Sequence[View]) -> None:
    """Every photo opens, has the size of its camera, and all are LDR or all HDR; raises BadInput."""
    kinds: dict[bool, View] = {}
    for view in views:
        if view.photo is None:
            continue
        check_photo_size(view, check_image(view.photo))
        kinds.setdefault(view.photo.suffix.lower() in HDR_SUFFIXES, view)
    if len(kinds) == 2:
        raise BadInput(
            f"is EXR while {kinds[False].photo} is not", "give all training photos as EXR or none", kinds[True].photo
        )


def check_units(views: Sequence[View], mesh: Mesh, path: Path) -> None:
    """Raise BadInput when the mesh ``path`` and the poses cannot be in one unit, or lie too far from the origin.

    The size of the mesh is the median distance of its vertices from their median: one far backdrop must not count.
    Cameras that only turn on the spot tell nothing about the unit, so a path below half a metre counts as half a metre.
    """
    center = np.median(mesh.vertices, axis=0)
    extent = float(np.median(np.linalg.norm(mesh.vertices - center, axis=1)))
    positions = np.array([view.camera.position for view in views])
    spread = float(np.linalg.norm(np.ptp(positions, axis=0)))
    ratio = extent / max(spread, 0.5)
    if ratio > UNIT_MISMATCH:
        raise BadInput(
            f"is {ratio:.0f} times as large as the path of the cameras: millimetres against metres?",
            f"scale the mesh to metres (by {_nearest_unit(1 / ratio):g}) or bring the poses to its unit",
            path,
        )
    if spread > UNIT_MISMATCH * max(extent, 1e-9):
        raise BadInput(
            f"is {spread / max(extent, 1e-9):.0f} times smaller than the path of the cameras: poses in millimetres?",
            "bring mesh and poses to metres",
            path,
        )
    _check_origin(center, np.median(positions, axis=0), extent, path)


def _check_origin(center: FloatArray, camera: FloatArray, extent: float, path: Path) -> None:
    distance = float(min(np.linalg.norm(center), np.linalg.norm(camera)))
    times = distance / max(extent, 1e-9)
    if times > FAR_AWAY:
        shift = ", ".join(f"{-round(value):d}" for value in center.tolist())
        raise BadInput(
            f"lies {distance:.3g} from the origin, {times:.0f} times its own size: map coordinates?",
            f"move mesh and poses together to the origin, by ({shift})",
            path,
        )


def _nearest_unit(scale: float) -> float:
    """The factor between usual units (mm, cm, m) nearest to ``scale``."""
    units = np.array([0.001, 0.01])
    return float(units[np.argmin(np.abs(np.log(units / scale)))])


def check_sees_mesh(views: Sequence[View], mesh: Mesh, path: Path) -> tuple[str, ...]:
    """Raise BadInput when no photo sees the mesh ``path``; return a warning for photos that see little of it."""
    shares = seen_shares(views, mesh)
    if not (shares > 0).any():
        raise BadInput(
            "no photo sees the mesh", "bring mesh and poses into one frame (axes, unit, origin) and one capture", path
        )
    blind = [view.name for view, share in zip(views, shares, strict=True) if share < SEES_LITTLE]
    if not blind:
        return ()
    names = ", ".join(blind[:5]) + (" …" if len(blind) > 5 else "")
    return (f"{len(blind)} of {len(views)} photos see less than {SEES_LITTLE:.0%} of the mesh: {names}",)


def seen_shares(views: Sequence[View], mesh: Mesh) -> FloatArray:
    """(n,) share of a 16x16 grid of rays through each view that meets the mesh."""
    from ..rays.tracer import Tracer  # the tracer needs this package's types: a cycle at import time

    coarse = [
        replace(
            view.camera,
            width=GRID,
            height=GRID,
            fx=view.camera.fx * GRID / view.camera.width,
            fy=view.camera.fy * GRID / view.camera.height,
            cx=view.camera.cx * GRID / view.camera.width,
            cy=view.camera.cy * GRID / view.camera.height,
        )
        for view in views
    ]
    rays = [camera.rays() for camera in coarse]
    hits = Tracer(mesh).closest(np.concatenate([o for o, _ in rays]), np.concatenate([d for _, d in rays]))
    return (hits.face >= 0).reshape(len(views), -1).mean(1)
