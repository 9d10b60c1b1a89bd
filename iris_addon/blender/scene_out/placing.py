"""Inserted shapes and objects: made or imported, set upright, scaled in metres and placed on a surface.

Objects come from .blend, .glb, .gltf, .obj and .usd files.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import Any, TypeAlias

import bmesh
import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector
from mathutils.bvhtree import BVHTree
from numpy.typing import NDArray

from ...base.errors import BadInput
from ...base.glb_chunks import check_announced, read_chunks
from ...base.untrusted import decoding, open_file
from ...edits.scene_edit import ObjectFile, Placement, Primitive
from ...model.capture import Mesh
from ..stepwise import Steps, finish
from ..version import require_build_option, require_gltf
from .materials import sphere_material

CONTACT_GAP = 2e-4
"""Distance between an object and the surface it stands on, metres: coplanar faces flicker."""
NORMAL_RADIUS, NORMAL_MIN_COSINE = 0.06, 0.7
"""The normal of the surface at a point is the mean over faces within this radius, metres, whose normals have at least
this cosine with that of the face hit."""
DROP_LIFT = 1e-2
"""Distance by which an object is lifted before it drops, metres: it may have been placed just below a surface."""
TREE_FACES = 100_000
"""Faces of one search tree, which is built in a fifth of a second; a scan has a million."""

Found: TypeAlias = tuple[Any, Any, Any, Any]
"""What a search tree finds: point, normal, face and distance, or four times None."""


class Room:
    """The surface on which objects are placed.

    Attributes:
        up: unit up vector.
    """

    def __init__(self, mesh: Mesh, up: tuple[float, float, float]) -> None:
        self.mesh, self.up = mesh, Vector(up)
        self._trees: list[BVHTree] = []  # each of TREE_FACES faces, in their order

    def search_trees(self) -> Steps[None]:
        """Build now what is searched, which takes seconds for a million triangles, and not with the first ray."""
        for start in range(len(self._trees) * TREE_FACES, len(self.mesh.faces), TREE_FACES):
            yield "reading the room"
            used, corners = np.unique(self.mesh.faces[start : start + TREE_FACES], return_inverse=True)
            faces = corners.reshape(-1, 3).tolist()
            self._trees.append(BVHTree.FromPolygons(self.mesh.vertices[used].tolist(), faces, all_triangles=True))

    def along(self, origin: Vector, direction: Vector) -> tuple[Vector, Vector] | None:
        """Point and normal (towards ``origin``) of the first surface along a ray, or None."""
        hit = _first(tree.ray_cast(origin, direction) for tree in self._searched())
        if hit is None:
            return None
        point, normal = hit
        return point, self._mean_normal(point, -normal if normal.dot(direction) > 0 else normal)

    def nearest(self, at: Vector) -> tuple[Vector, Vector]:
        """Nearest point of the room and the normal there, towards ``at``; the room must have a face."""
        found = _first(tree.find_nearest(at) for tree in self._searched())
        assert found is not None
        point, normal = found
        return point, self._mean_normal(point, -normal if normal.dot(at - point) < 0 else normal)

    def _mean_normal(self, at: Vector, normal: Vector) -> Vector:
        """The mean normal of the surface around ``at``: single faces of a scan are noisy."""
        mean = normal * 1e-9  # an isolated face keeps its own normal
        for k, tree in enumerate(self._searched()):
            for _point, other, face, _distance in tree.find_nearest_range(at, NORMAL_RADIUS):
                a, b, c = (Vector(self.mesh.vertices[v]) for v in self.mesh.faces[k * TREE_FACES + face])
                other = -other if other.dot(normal) < 0 else other
                if other.dot(normal) > NORMAL_MIN_COSINE:
                    mean += other * (b - a).cross(c - a).length
        return mean.normalized()

    def _searched(self) -> list[BVHTree]:
        finish(self.search_trees())
        return self._trees


def _first(found: Iterable[Found]) -> tuple[Vector, Vector] | None:
    """Point and normal of the nearest of what search trees have found; None where none found anything."""
    nearest = min((one for one in found if one[3] is not None), key=lambda one: one[3], default=None)
    return None if nearest is None else (nearest[0], nearest[1])


def add_object(
    thing: Primitive | ObjectFile, name: str, room: Room, collection: bpy.types.Collection
) -> list[bpy.types.Object]:
    """Add ``thing`` to ``collection`` under an empty that places it; returns all objects.

    Raises:
        BadInput: the file cannot be used, or there is no surface where one is required.
    """
    if isinstance(thing, Primitive):
        objects = [_add_primitive(thing, name, collection)]
    else:
        objects = import_objects(thing, collection)
        if thing.material is not None:
            _use_material(objects, sphere_material(name, thing.material))
    bpy.context.evaluated_depsgraph_get()  # world matrices of what was just imported
    for layer in collection.id_data.view_layers if isinstance(collection.id_data, bpy.types.Scene) else ():
        layer.update()
    anchor = bpy.data.objects.new(name, None)
    corners = corners_of(objects)
    anchor.matrix_world = placement_matrix(thing.placement, room, corners)
    anchor.empty_display_size = max(0.5 * float(np.ptp(corners, axis=0).max()), 1e-3)  # as wide as what it holds
    collection.objects.link(anchor)
    for child in objects:
        if child.parent is None:
            child.parent = anchor
    return [anchor, *objects]


def placement_matrix(placed: Placement, room: Room, corners: NDArray[np.floating]) -> Matrix:
    """The matrix from an object's axes (+Z up) to the room.

    Args:
        corners: (n, 3) points of the object in its own axes; the lowest one touches the surface it snaps to.
    """
    at, normal = _support(placed, room)
    upright = Vector((0.0, 0.0, 1.0)).rotation_difference(normal).to_matrix().to_4x4()
    turned = Euler(np.radians(placed.rotation)).to_matrix().to_4x4() @ Matrix.Diagonal((*placed.scale, 1.0))
    heights = corners @ np.array(turned)[2, :3] if len(corners) else np.zeros(1)
    extent = float(np.ptp(heights))
    scale = 1.0
    if placed.height is not None:
        if extent <= 0:
            raise BadInput("an object without height cannot be scaled to one", "give 'scale' in place of 'height'")
        scale = placed.height / extent
    lift = CONTACT_GAP - scale * float(heights.min()) if placed.snap != "none" else 0.0
    return Matrix.Translation(at) @ upright @ Matrix.Translation((0.0, 0.0, lift)) @ Matrix.Scale(scale, 4) @ turned


def _support(placed: Placement, room: Room) -> tuple[Vector, Vector]:
    """Where the object stands, and its up direction."""
    at, normal = Vector(placed.location), room.up
    if placed.ray is not None:
        hit = room.along(*map(Vector, placed.ray))
        if hit is None:
            raise BadInput("there is no surface behind 'pixel'", "point at the room, or give 'location'")
        at, normal = hit
    elif placed.snap == "surface":
        at, normal = room.nearest(at)
    if placed.snap != "down":
        return at, normal if placed.snap == "surface" else room.up
    if placed.ray is not None and normal.dot(room.up) > 0.5:
        return at, room.up  # the ray points at the surface it is to stand on
    hit = room.along(at + DROP_LIFT * (room.up + normal), -room.up)
    if hit is None:
        raise BadInput(
            f"there is nothing below {[round(v, 3) for v in at]} to stand on", "move the object, or use snap 'surface'"
        )
    return hit[0], room.up


def _add_primitive(thing: Primitive, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """A mesh of the shape's ``size`` around the origin."""
    data = bpy.data.meshes.new(name)
    mesh = bmesh.new()
    if thing.shape == "card":
        bmesh.ops.create_grid(mesh, x_segments=1, y_segments=1, size=0.5)
    elif thing.shape == "box":
        bmesh.ops.create_cube(mesh, size=1.0)
    elif thing.shape == "sphere":
        bmesh.ops.create_uvsphere(mesh, u_segments=128, v_segments=64, radius=0.5)
    else:
        top = 0.5 if thing.shape == "cylinder" else 0.0
        bmesh.ops.create_cone(mesh, cap_ends=True, segments=96, radius1=0.5, radius2=top, depth=1.0)
    size = thing.size if thing.shape != "card" else (*thing.size[:2], 1.0)
    bmesh.ops.scale(mesh, vec=size, verts=mesh.verts)
    mesh.to_mesh(data)
    mesh.free()
    if thing.shape == "sphere":
        data.shade_smooth()
    elif thing.shape in ("cylinder", "cone"):
        for polygon in data.polygons:
            polygon.use_smooth = len(polygon.vertices) < 5  # the side is smooth, the caps are flat
        data.set_sharp_from_angle(angle=np.radians(40.0))
    data.materials.append(sphere_material(name, thing.material))
    shape = bpy.data.objects.new(f"{name} Mesh", data)
    collection.objects.link(shape)
    return shape


def _use_material(objects: Iterable[bpy.types.Object], material: bpy.types.Material) -> None:
    for thing in objects:
        if thing.type == "MESH":
            thing.data.materials.clear()
            thing.data.materials.append(material)


def corners_of(objects: Iterable[bpy.types.Object]) -> NDArray[np.float64]:
    """Points (n, 3) in world space: vertices of meshes, and corners of the bounding boxes of other geometry."""
    found = [np.empty((0, 3))]
    for thing in objects:
        if thing.type == "MESH":
            points = np.empty((len(thing.data.vertices), 3), np.float32)  # the type that foreach_get copies fastest
            thing.data.vertices.foreach_get("co", points.ravel())
        elif thing.type in ("CURVE", "SURFACE", "FONT", "META"):
            points = np.array(thing.bound_box)
        else:
            continue
        matrix = np.array(thing.matrix_world)
        found.append(np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3])
    return np.concatenate(found)


# ---- files ---------------------------------------------------------------------------------------------------------

MAX_OBJECT_BYTES = 4 << 30
OBJECT_FILES = ".blend, .glb, .gltf, .obj, .usd, .usda, .usdc or .usdz"


def import_objects(source: ObjectFile, collection: bpy.types.Collection) -> list[bpy.types.Object]:
    """Import everything in the file as objects of ``collection`` only, at their positions in the file.

    Raises:
        BadInput: the file is missing, unreadable, of an unknown kind, or has no objects in it.
    """
    mend = "correct 'file' of the object, or export it again"
    open_file(source.file, MAX_OBJECT_BYTES, mend=mend).close()
    if source.file.suffix.lower() == ".glb":
        document, _ = read_chunks(source.file, MAX_OBJECT_BYTES, mend)
        check_announced(document, source.file.stat().st_size, source.file, mend)
    before = set(bpy.data.objects)
    with decoding(source.file, "cannot be imported", mend):
        _import_file(source)
    objects = [thing for thing in bpy.data.objects if thing not in before]
    if not objects:
        raise BadInput("has no objects in it", "choose a file with a mesh", source.file)
    for thing in objects:
        for owner in tuple(thing.users_collection):
            owner.objects.unlink(thing)
        collection.objects.link(thing)
    return objects


def _import_file(source: ObjectFile) -> None:
    path, kind = str(source.file), source.file.suffix.lower()
    if kind == ".blend":
        with bpy.data.libraries.load(path) as (found, wanted):
            wanted.objects = found.objects
    elif kind in (".glb", ".gltf"):
        require_gltf()
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):  # tracebacks of a file that is damaged
            bpy.ops.import_scene.gltf(filepath=path)
    elif kind == ".obj":
        require_build_option("io_wavefront_obj", "An .obj file")
        bpy.ops.wm.obj_import(filepath=path)
    elif kind in (".usd", ".usda", ".usdc", ".usdz"):
        require_build_option("usd", "A .usd file")
        # The world of the file would replace that of the open scene.
        bpy.ops.wm.usd_import(filepath=path, create_world_material=False, import_cameras=False)
    else:
        raise BadInput(f"'{kind}' is not a known kind of object file", f"use {OBJECT_FILES}", source.file)
