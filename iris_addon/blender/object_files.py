"""Objects from .blend, .glb/.gltf and .obj files, placed in a room."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

from ..errors import BadInput
from ..result.edits import ObjectFile
from .version import require_build_option


def load_objects(
    placed: ObjectFile, up: tuple[float, float, float], collection: bpy.types.Collection
) -> list[bpy.types.Object]:
    """Everything in the file under one empty at ``placed.location``, standing upright along ``up``; returns all of it.

    Raises:
        BadInput: the file is missing, unreadable, of a kind not known, or has no objects in it.
    """
    if not placed.file.is_file():
        raise BadInput("no such object file", "correct 'file' of the object", placed.file)
    before = set(bpy.data.objects)
    try:
        _import_file(placed)
    except (RuntimeError, OSError) as error:
        raise BadInput(f"cannot be imported ({str(error).strip()})", "export the object again", placed.file) from error
    objects = [thing for thing in bpy.data.objects if thing not in before]
    if not objects:
        raise BadInput("has no objects in it", "choose a file with a mesh", placed.file)

    anchor = bpy.data.objects.new(f"IRIS {placed.file.stem}", None)
    anchor.matrix_world = placement(placed, up)
    collection.objects.link(anchor)
    for thing in objects:
        for owner in tuple(thing.users_collection):
            owner.objects.unlink(thing)
        collection.objects.link(thing)
        if thing.parent is None:
            thing.parent = anchor
    return [anchor, *objects]


def placement(placed: ObjectFile, up: tuple[float, float, float]) -> Matrix:
    """The matrix that carries Blender's axes (+Z up) to where ``placed`` stands in a room whose up vector is ``up``."""
    upright = Vector((0.0, 0.0, 1.0)).rotation_difference(Vector(up)).to_matrix().to_4x4()
    rotation = Euler(np.radians(placed.rotation)).to_matrix().to_4x4()
    return Matrix.Translation(placed.location) @ upright @ rotation @ Matrix.Diagonal((*placed.scale, 1.0))


def _import_file(placed: ObjectFile) -> None:
    path, kind = str(placed.file), placed.file.suffix.lower()
    if kind == ".blend":
        with bpy.data.libraries.load(path) as (source, target):
            target.objects = source.objects
    elif kind in (".glb", ".gltf"):
        bpy.ops.import_scene.gltf(filepath=path)
    elif kind == ".obj":
        require_build_option("io_wavefront_obj", "An .obj file")
        bpy.ops.wm.obj_import(filepath=path)
    else:
        raise BadInput(f"'{kind}' is no kind of object file known here", "use .blend, .glb or .obj", placed.file)
