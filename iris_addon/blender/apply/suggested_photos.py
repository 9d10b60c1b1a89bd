"""Suggested photos as cameras in the room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree
from numpy.typing import NDArray

from ...evaluate.next_photos import BadlySeen, SuggestedPhoto, next_photos
from ...model.capture import Camera, HitDistance, Mesh
from ..camera import add_camera
from ..stepwise import Steps, in_thread
from .on_objects import MADE, FaceRun

COLLECTION = "IRIS Next Photos"
DRAWN_SIZE = 0.4
"""Meters, of the drawn frustum."""


def suggest_steps(
    room: tuple[Mesh, NDArray[np.floating], Sequence[float]],
    runs: Sequence[FaceRun],
    scene: bpy.types.Scene,
    taken: Sequence[Camera],
) -> Steps[list[SuggestedPhoto]]:
    """Add cameras from where one sees most of what photos show badly to ``scene``; earlier ones are removed.

    Args:
        room: mesh, coverage and up vector of the result.
        runs: which object the faces of the mesh are.
        taken: the cameras of the photos, in the space of the scene.

    Returns:
        The photos, in the space of the result; none where none would show much.
    """
    mesh, coverage, up = room
    to_scene = np.array(scene.objects[runs[0].object].matrix_world) @ np.linalg.inv(runs[0].to_capture)
    seen_from = [replace(camera, c2w=rigid(np.linalg.inv(to_scene) @ camera.c2w)) for camera in taken]
    found = yield from in_thread(
        lambda: next_photos(BadlySeen.of(mesh, coverage), seen_from, up, hit_distance(mesh)), "looking for places"
    )
    forget_suggested(scene)
    if not found:
        return []
    group = bpy.data.collections.new(COLLECTION)
    group[MADE] = True
    scene.collection.children.link(group)
    for number, photo in enumerate(found, start=1):
        camera = replace(photo.camera, c2w=rigid(to_scene @ photo.camera.c2w))
        thing = add_camera(camera, f"IRIS Next Photo {number}", group)
        thing.data.display_size, thing.show_name, thing.hide_render = DRAWN_SIZE, True, True
        thing[MADE] = thing.data[MADE] = True
    return found


def forget_suggested(scene: bpy.types.Scene) -> None:
    """Remove the suggested cameras."""
    for group in suggested_groups(scene):
        cameras = [thing.data for thing in group.objects if MADE in thing]
        bpy.data.batch_remove([thing for thing in group.objects if MADE in thing])
        bpy.data.batch_remove([camera for camera in cameras if MADE in camera and not camera.users])
        if not group.all_objects:
            bpy.data.collections.remove(group)


def suggested_groups(scene: bpy.types.Scene) -> list[bpy.types.Collection]:
    """The collections of suggested cameras in ``scene``."""
    return [group for group in scene.collection.children if MADE in group and group.name.startswith(COLLECTION)]


def hit_distance(mesh: Mesh) -> HitDistance:
    """Distances along rays to ``mesh``, by Blender's search tree; does not use bpy."""
    return tree_distance(BVHTree.FromPolygons(mesh.vertices.tolist(), mesh.faces.tolist(), all_triangles=True))


def tree_distance(tree: BVHTree) -> HitDistance:
    """Distances along rays to what is in ``tree``."""

    def distance(origins: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.float64]:
        found = np.full(len(origins), np.inf)
        for row, (origin, direction) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
            hit = tree.ray_cast(origin, direction)[3]
            if hit is not None:
                found[row] = hit
        return found

    return distance


def rigid(pose: NDArray[np.floating]) -> NDArray[np.float64]:
    """(4, 4) ``pose`` without scale."""
    pose = np.array(pose, np.float64)
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    return pose
