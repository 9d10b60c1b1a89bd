"""A light meter on the surfaces of a solved room: where it lies, and where it faces."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Quaternion, Vector
from numpy.typing import NDArray

from ...base.errors import BadInput
from ...model.response import LUMINANCE
from ..apply.on_objects import MADE, ORIGINAL
from ..scene_out.backdrop import is_backdrop
from ..scene_out.lights import RECOVERED, RECOVERED_TURN, is_recovered_sun

ON_SURFACE, METER_HEIGHT = 0.01, 1e-3
"""Of the room's diagonal: a point so near is on a surface; and what is nearer to the surface shades no meter."""


def meter_at(scene: bpy.types.Scene, at: Vector, eyes: Sequence[Vector]) -> tuple[Vector, Vector]:
    """Place and direction of a meter that lies on the room's surface at the point ``at``, or on the first one below.

    Args:
        eyes: where the photos were taken: of a surface that ``at`` lies on exactly, they see the side that counts.

    Returns:
        A point just off the surface, and the unit normal there, in the axes of ``scene``.

    Raises:
        BadInput: there is no surface at the point nor below it.
    """
    room, diagonal = _room(scene), float(np.linalg.norm(_box(scene)))
    found = _nearest(room, at)
    if found is None or (found[0] - at).length > ON_SURFACE * diagonal:
        found = _first_along(room, at, Vector((0.0, 0.0, -1.0)))
    if found is None:
        raise BadInput("there is no surface at the 3D cursor or below it", "put the cursor where the meter lay")
    place, normal = found
    above = (at - place) @ normal
    if abs(above) <= METER_HEIGHT * diagonal:
        above = sum(1.0 if (eye - place) @ normal > 0 else -1.0 for eye in eyes) or normal.z or 1.0
    normal = normal if above > 0 else -normal
    return place + METER_HEIGHT * diagonal * normal, normal


def sunlight_at(scene: bpy.types.Scene, at: Vector, normal: Vector) -> float:
    """What the recovered sun gives to a meter there, as :func:`~...edits.light_units.illuminance`, which does not see
    it: a panorama shows no lights that are none for cameras."""
    arriving = 0.0
    for sun in filter(is_recovered_sun, scene.objects):
        toward = Quaternion(sun.get(RECOVERED_TURN, sun.matrix_world.to_quaternion())) @ Vector((0.0, 0.0, 1.0))
        cosine = toward.dot(normal)
        if cosine > 0 and _first_along(_room(scene), at, toward) is None:
            arriving += cosine * float(LUMINANCE @ np.array(sun[RECOVERED], float))
    return arriving


def box_area(scene: bpy.types.Scene) -> float:
    """Surface of the box around the room, square metres."""
    x, y, z = _box(scene) * scene.unit_settings.scale_length
    return float(2 * (x * y + y * z + z * x))


def _room(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The objects of the room, and what stands in for some of them; those that are disabled have no surface."""
    graph = bpy.context.evaluated_depsgraph_get()
    shown = {thing.original for thing in graph.objects}
    return [
        thing
        for thing in scene.objects
        if thing.type == "MESH"
        and (ORIGINAL in thing or MADE in thing)
        and thing in shown
        and not is_backdrop(thing)
        and len(thing.evaluated_get(graph).data.polygons)
    ]


def _box(scene: bpy.types.Scene) -> NDArray[np.float64]:
    """(3,) extent of the room; 0 without one."""
    corners = [tuple(thing.matrix_world @ Vector(corner)) for thing in _room(scene) for corner in thing.bound_box]
    return np.ptp(np.array(corners or [(0.0, 0.0, 0.0)], np.float64), axis=0)


_Found = tuple[Vector, Vector]
"""A point on a surface, and its unit normal, in the axes of the scene."""


def _nearest(room: Sequence[bpy.types.Object], at: Vector) -> _Found | None:
    graph = bpy.context.evaluated_depsgraph_get()
    found = []
    for thing in room:
        hit, place, normal, _ = thing.closest_point_on_mesh(thing.matrix_world.inverted() @ at, depsgraph=graph)
        if hit:
            found.append(_in_scene(thing, place, normal))
    return min(found, key=lambda each: (each[0] - at).length, default=None)


def _first_along(room: Sequence[bpy.types.Object], at: Vector, direction: Vector) -> _Found | None:
    graph = bpy.context.evaluated_depsgraph_get()
    found = []
    for thing in room:
        inward = thing.matrix_world.inverted()
        hit, place, normal, _ = thing.ray_cast(inward @ at, inward.to_3x3() @ direction, depsgraph=graph)
        if hit:
            found.append(_in_scene(thing, place, normal))
    return min(found, key=lambda each: (each[0] - at).length, default=None)


def _in_scene(thing: bpy.types.Object, place: Vector, normal: Vector) -> _Found:
    turned = thing.matrix_world.to_3x3().inverted().transposed() @ normal
    return thing.matrix_world @ place, turned.normalized()
