"""Objects in the open scene of Blender, and a result for them as a solve would give it."""

from dataclasses import replace

import bpy
import numpy as np

from iris_addon.blender.scene_in.scene_capture import read_scene_mesh
from iris_addon.model.capture import Mesh
from iris_addon.model.recovered import Emitter, OutsideLight
from iris_addon.results.result import Result
from tests.blender_room import room

QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def cube(name: str, material: str | None = "paint", **placed) -> bpy.types.Object:
    """A cube of quads from -1 to 1 with one material, a UV map of its own and a transform."""
    data = bpy.data.meshes.new(name)
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    data.from_pydata(corners, [], QUADS)
    data.uv_layers.new(name="Own")
    if material:
        data.materials.append(bpy.data.materials.get(material) or bpy.data.materials.new(material))
    thing = bpy.data.objects.new(name, data)
    for attribute, value in placed.items():
        setattr(thing, attribute, value)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def solve(lamp_faces=(), uv=None, scale=1.0) -> tuple[Result, list]:
    """A result for the open scene as the solver would give it, and its face runs."""
    bpy.context.view_layer.update()
    seen = read_scene_mesh(bpy.context.evaluated_depsgraph_get())
    n = len(seen.mesh.faces)
    if uv is None:  # every pair of triangles that is one quad in a cell of its own
        cells = np.arange(n) // 2
        u, v = (cells % 16) / 16, (cells // 16) / 16
        corner = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]]) / 16
        uv = (np.stack([u, v], -1)[:, None] + corner[np.arange(n) % 2]).astype(np.float32)
    mesh = Mesh(seen.mesh.vertices * scale, seen.mesh.faces, uv, seen.mesh.regions)
    base = room(albedo=(0.8, 0.4, 0.2), mesh=mesh, roughness=0.6)
    emitters = (
        (Emitter(id=7, faces=np.array(lamp_faces), radiance=np.array([3.0, 6.0, 1.5]), area=1.5, confidence=0.75),)
        if len(lamp_faces)
        else ()
    )
    exposures = {"a": np.full(3, 0.25)}
    return replace(base, emitters=emitters, outside=OutsideLight(np.full((1, 3), 0.5)), exposures=exposures), seen.runs
