"""A Blender scene as one triangle mesh, like a scan, with material and emitter of each face as ground truth."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.errors import BadInput
from ...model.capture import Mesh
from ...model.response import linear_of_srgb
from ..scene_out.materials import below_profile

PATTERN_STEPS = 64
"""Points along the side of a triangle at which the picture on a lamp is averaged."""


@dataclass(frozen=True)
class SceneEmitter:
    """One lamp: the faces of one object that have one emissive material. Faces [first, last) of the mesh.

    Its ``radiance`` (3,) is the mean over its area.
    """

    name: str
    material: bpy.types.Material
    radiance: NDArray[np.float64]
    first: int
    last: int


@dataclass(frozen=True)
class SceneGeometry:
    """The evaluated scene in world space.

    Attributes:
        mesh: triangles; faces of emitters come last, emitter by emitter.
        material: (F,) uint16 index into ``materials``, counted from 1 as the IndexMA maps do.
        emitter: (F,) int16 index into ``emitters``, −1 for other faces.
    """

    mesh: Mesh
    material: NDArray[np.uint16]
    emitter: NDArray[np.int16]
    materials: tuple[bpy.types.Material, ...]
    emitters: tuple[SceneEmitter, ...]

    def areas(self) -> NDArray[np.float64]:
        """(F,) square metres."""
        a, b, c = self.mesh.vertices[self.mesh.faces].transpose(1, 0, 2)
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def prepare(scene: bpy.types.Scene) -> None:
    """Make the evaluated mesh equal to what Cycles renders, and fill empty material slots."""
    default = None
    for thing in scene.objects:
        thing.hide_viewport = thing.hide_render
        for modifier in thing.modifiers:
            modifier.show_viewport = modifier.show_render
            if modifier.type in ("SUBSURF", "MULTIRES"):
                modifier.levels = modifier.render_levels
        if thing.type != "MESH" or (thing.data.materials and all(slot.material for slot in thing.material_slots)):
            continue
        default = default or bpy.data.materials.new("default")
        if default.node_tree is None:  # before Blender 5.0
            default.use_nodes = True
        if not thing.data.materials:
            thing.data.materials.append(default)
        for slot in thing.material_slots:
            slot.material = slot.material or default


@dataclass
class _Region:
    """The triangles of one object instance that share a material."""

    name: str
    material: bpy.types.Material
    radiance: NDArray[np.float64]
    corners: NDArray[np.float64]  # (n, 3) vertices in world space
    faces: NDArray[np.int64]


def read_geometry(scene: bpy.types.Scene) -> SceneGeometry:
    """Triangulate what ``scene`` renders, in an order that depends only on names.

    Raises:
        BadInput: there is nothing to render, or an emission is neither constant nor a picture.
    """
    regions = sorted(_regions(scene), key=lambda region: bool(region.radiance.any()))  # stable: lamps go last
    if not regions:
        raise BadInput(
            "the scene has no visible mesh", "make its objects visible in renders", bpy.data.filepath or None
        )
    materials = tuple({region.material.name: region.material for region in regions}.values())
    index = {material.name: k + 1 for k, material in enumerate(materials)}
    emitters: list[SceneEmitter] = []
    vertices, faces, material, emitter = [], [], [], []
    n_vertices = n_faces = 0
    for region in regions:
        n = len(region.faces)
        vertices.append(region.corners)
        faces.append(region.faces + n_vertices)
        material.append(np.full(n, index[region.material.name], np.uint16))
        emitter.append(np.full(n, len(emitters) if region.radiance.any() else -1, np.int16))
        if region.radiance.any():
            emitters.append(
                SceneEmitter(
                    name=region.name,
                    material=region.material,
                    radiance=region.radiance,
                    first=n_faces,
                    last=n_faces + n,
                )
            )
        n_vertices, n_faces = n_vertices + len(region.corners), n_faces + n
    mesh = Mesh(np.concatenate(vertices).astype(np.float32).astype(np.float64), np.concatenate(faces))
    return SceneGeometry(
        mesh=mesh,
        material=np.concatenate(material),
        emitter=np.concatenate(emitter),
        materials=materials,
        emitters=tuple(emitters),
    )


def _regions(scene: bpy.types.Scene) -> list[_Region]:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found: list[tuple[str, tuple[int, ...], list[_Region]]] = []
    for instance in depsgraph.object_instances:
        thing = instance.object
        if not instance.show_self or thing.type not in ("MESH", "CURVE", "SURFACE", "META", "FONT"):
            continue
        mesh = thing.to_mesh()
        if mesh is None:
            continue
        key = tuple(instance.persistent_id) if instance.is_instance else ()
        found.append((thing.name, key, _split_by_material(thing, mesh, np.array(instance.matrix_world))))
        thing.to_mesh_clear()
    return [region for _name, _key, regions in sorted(found, key=lambda f: f[:2]) for region in regions]


def _split_by_material(thing: bpy.types.Object, mesh: bpy.types.Mesh, to_world: NDArray[np.float64]) -> list[_Region]:
    mesh.calc_loop_triangles()
    n = len(mesh.loop_triangles)
    faces, slots = np.empty(3 * n, np.int32), np.empty(n, np.int32)
    mesh.loop_triangles.foreach_get("vertices", faces)
    mesh.loop_triangles.foreach_get("material_index", slots)
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    world = points.reshape(-1, 3) @ to_world[:3, :3].T + to_world[:3, 3]
    slots = np.minimum(slots, len(thing.material_slots) - 1)
    uv = _corners_on_pictures(mesh)
    regions = []
    for slot in np.unique(slots):
        used, renumbered = np.unique(faces.reshape(-1, 3)[slots == slot], return_inverse=True)
        material = thing.material_slots[slot].material.original
        corners, own = world[used], renumbered.reshape(-1, 3)
        regions.append(
            _Region(
                name=thing.name,
                material=material,
                radiance=emitted_radiance(material, corners[own], None if uv is None else uv[slots == slot]),
                corners=corners,
                faces=own,
            )
        )
    return regions


def surface_shader(material: bpy.types.Material) -> bpy.types.Node | None:
    """The shader node at the surface of the active output, or None."""
    output = material.node_tree.get_output_node("CYCLES") or material.node_tree.get_output_node("ALL")
    if output is None or not output.inputs["Surface"].is_linked:
        return None
    return output.inputs["Surface"].links[0].from_node


def emitted_radiance(
    material: bpy.types.Material, triangles: NDArray[np.floating], uv: NDArray[np.floating] | None
) -> NDArray[np.float64]:
    """(3,) mean radiance of a material over ``triangles`` (n, 3, 3) in world space, zero if it does not emit.

    Args:
        uv: (n, 3, 2) where the corners lie on pictures; None without texture coordinates.

    Raises:
        BadInput: nodes other than a picture drive the emission, so that there is no radiance to write down.
    """
    pending, radiance = [surface_shader(material)], np.zeros(3)
    while pending:
        node = pending.pop()
        if node is None:
            continue
        if node.bl_idname in ("ShaderNodeMixShader", "ShaderNodeAddShader"):
            pending += [link.from_node for socket in node.inputs if socket.type == "SHADER" for link in socket.links]
        names = {
            "ShaderNodeEmission": ("Color", "Strength"),
            "ShaderNodeBsdfPrincipled": ("Emission Color", "Emission Strength"),
        }
        if node.bl_idname not in names:
            continue
        color, strength = (node.inputs[name] for name in names[node.bl_idname])
        color = below_profile(color)  # which changes where light goes, not how much there is
        if not strength.is_linked and strength.default_value == 0:
            continue
        image = _picture_of(color)
        driven = color.is_linked and (image is None or uv is None)
        if driven or strength.is_linked or node != surface_shader(material):
            raise BadInput(
                f"the emission of material '{material.name}' is mixed or driven by nodes",
                "give it a plain Emission or Principled surface with a constant strength, and for color a constant or "
                "the Color of an Image Texture that has its picture, on the UV map of the object",
                bpy.data.filepath or None,
            )
        mean = np.array(color.default_value[:3]) if image is None or uv is None else _mean_of(image, triangles, uv)
        radiance = radiance + mean * strength.default_value
    return radiance


def _corners_on_pictures(mesh: bpy.types.Mesh) -> NDArray[np.float32] | None:
    """(n, 3, 2) texture coordinates of the corners of all triangles, of the map that renders use."""
    layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
    if layer is None:
        return None
    loops, uv = np.empty(3 * len(mesh.loop_triangles), np.int32), np.empty(2 * len(mesh.loops), np.float32)
    mesh.loop_triangles.foreach_get("loops", loops)
    layer.uv.foreach_get("vector", uv)
    return uv.reshape(-1, 2)[loops].reshape(-1, 3, 2)


def _picture_of(socket: bpy.types.NodeSocket) -> bpy.types.Image | None:
    """The picture of an Image Texture behind ``socket`` that lies on the default UV map."""
    link = socket.links[0] if socket.is_linked else None
    if link is None or link.from_node.bl_idname != "ShaderNodeTexImage" or link.from_socket.name != "Color":
        return None
    image = link.from_node.image
    if image is None or link.from_node.inputs["Vector"].is_linked:
        return None
    return image if min(image.size) > 0 and len(image.pixels) > 0 else None


def _mean_of(image: bpy.types.Image, triangles: NDArray[np.floating], uv: NDArray[np.floating]) -> NDArray[np.float64]:
    """(3,) scene-linear mean of ``image`` over ``triangles`` (n, 3, 3) whose corners lie at ``uv`` (n, 3, 2) on it."""
    width, height = image.size
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    color = pixels.reshape(height, width, image.channels)[..., :3].astype(np.float64)
    if not image.is_float and image.colorspace_settings.name == "sRGB":
        color = linear_of_srgb(color)
    a, b = (np.indices((PATTERN_STEPS, PATTERN_STEPS)).reshape(2, -1) + 1 / 3) / PATTERN_STEPS
    inside = a + b < 1
    shares = np.stack([1 - a - b, a, b], -1)[inside]
    means = np.empty((len(uv), 3))
    for k, corners in enumerate(uv):
        at = (shares @ corners) % 1.0
        column, row = (np.clip((at[:, j] * side).astype(int), 0, side - 1) for j, side in ((0, width), (1, height)))
        means[k] = color[row, column].mean(0)
    edges = triangles[:, 1:] - triangles[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return np.average(means, axis=0, weights=np.maximum(areas, 1e-12))
