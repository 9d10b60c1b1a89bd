"""Objects of .blend, .glb/.gltf, .obj and .usd files as Blender data."""

from __future__ import annotations

import bpy

from ..errors import BadInput
from ..result.edits import ObjectFile
from .version import require_build_option, require_gltf

KINDS = ".blend, .glb, .gltf, .obj, .usd, .usda, .usdc or .usdz"


def import_objects(source: ObjectFile, collection: bpy.types.Collection) -> list[bpy.types.Object]:
    """Everything in the file as objects of ``collection`` alone, where the file has them.

    Raises:
        BadInput: the file is missing, unreadable, of a kind not known, or has no objects in it.
    """
    if not source.file.is_file():
        raise BadInput("no such object file", "correct 'file' of the object", source.file)
    before = set(bpy.data.objects)
    try:
        _import_file(source)
    except (RuntimeError, OSError) as error:
        raise BadInput(f"cannot be imported ({str(error).strip()})", "export the object again", source.file) from error
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
        bpy.ops.import_scene.gltf(filepath=path)
    elif kind == ".obj":
        require_build_option("io_wavefront_obj", "An .obj file")
        bpy.ops.wm.obj_import(filepath=path)
    elif kind in (".usd", ".usda", ".usdc", ".usdz"):
        require_build_option("usd", "A .usd file")
        # The world of the file would replace that of the open scene.
        bpy.ops.wm.usd_import(filepath=path, create_world_material=False, import_cameras=False)
    else:
        raise BadInput(f"'{kind}' is no kind of object file known here", f"use {KINDS}", source.file)
