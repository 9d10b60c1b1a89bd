"""Photometric files of the lamps of a scene, as they are set now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree
from numpy.typing import NDArray

from ...base.errors import IrisError
from ...base.files import atomic_write
from ...edits.ies import HORIZONTAL, ies_file, seen_areas
from ...edits.light_units import LUMENS_PER_WATT
from ...model.capture import HitDistance
from ..scene_out.lamp_profile_nodes import profile_of
from .lamp_faces import lamp_triangles
from .suggested_photos import tree_distance

RELATIVE_LUMENS = 1000.0
"""Of the brightest lamp, where the lumens of none are known."""


@dataclass(frozen=True)
class IesLamp:
    """A lamp of a scene, and its flux in any one unit, the same for all lamps."""

    material: bpy.types.Material
    flux: float


def write_ies_files(
    scene: bpy.types.Scene, lamps: Sequence[IesLamp], folder: Path, lumens_per_unit: float
) -> list[Path]:
    """Write a file for each of ``lamps`` that shines into ``folder``, named as the lamp.

    Args:
        lumens_per_unit: of their flux; 0 where it is not known: then the brightest lamp has 1000 lm.

    Returns:
        The files.

    Raises:
        IrisError: the folder cannot be written.
    """
    shining = [lamp for lamp in lamps if lamp.flux > 0]
    scale, note = lumens_per_unit, ""
    if not scale and shining:
        scale = RELATIVE_LUMENS / max(lamp.flux for lamp in shining)
        note = "Lumens are relative: the brightest lamp of the room was given 1000"
    room, written = _scene_distance(scene), []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for lamp in shining:
            seen = _seen(scene, lamp.material, room)
            if seen is None:
                continue
            areas, size = seen
            text = ies_file(areas, scale * lamp.flux, size, lamp.material.name, note)
            path = folder / f"{bpy.path.clean_name(lamp.material.name)}.ies"
            if path in written:  # "a/b" and "a_b" are two lamps
                path = path.with_stem(f"{path.stem}_{len(written)}")
            atomic_write(path, lambda part, text=text: part.write_bytes(text.encode("ascii")))
            written.append(path)
    except OSError as error:
        what = f"the lamps cannot be written ({error.strerror or error})"
        raise IrisError(what, "free disk space or choose another place", folder) from error
    return written


def cycles_ies(scene: bpy.types.Scene, material: bpy.types.Material) -> str | None:
    """The photometric file of a lamp for Cycles' IES texture on a light of its flux; None where it sends light nowhere.

    Cycles turns candela into watts at LUMENS_PER_WATT, and counts horizontal angles clockwise, seen from above, from -y
    on. With so many lumens in the file, a light of some watts sends these watts.
    """
    seen = _seen(scene, material, _scene_distance(scene))
    if seen is None:
        return None
    areas, size = seen
    steps = len(HORIZONTAL) - 1  # the last is the first again
    column = (3 * steps // 4 - np.arange(steps + 1)) % steps
    return ies_file(areas[:, column], LUMENS_PER_WATT, size, material.name).replace("\r\n", "\n")


def _seen(
    scene: bpy.types.Scene, material: bpy.types.Material, room: HitDistance
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """The seen areas (V, H) of a lamp and its size (3,); None where it is seen from nowhere."""
    corners = lamp_triangles(scene, material)
    if not len(corners):
        return None
    areas = seen_areas(corners, room, _lamp_distance(corners), profile_of(material))
    return (areas, np.ptp(corners.reshape(-1, 3), axis=0)) if areas.any() else None


def _lamp_distance(corners: NDArray[np.floating]) -> HitDistance:
    points = corners.reshape(-1, 3)
    return tree_distance(BVHTree.FromPolygons(points.tolist(), np.arange(len(points)).reshape(-1, 3).tolist()))


def _scene_distance(scene: bpy.types.Scene) -> HitDistance:
    """Distances to all that is visible in ``scene``, by the search trees that Blender keeps."""
    depsgraph = bpy.context.evaluated_depsgraph_get()

    def distance(origins: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.float64]:
        found = np.full(len(origins), np.inf)
        for row, (origin, direction) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
            hit, place, *_ = scene.ray_cast(depsgraph, origin, direction)
            if hit:
                found[row] = (place - Vector(origin)).length
        return found

    return distance
