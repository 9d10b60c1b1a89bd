"""The materials of a solved room: one textured Principled surface, lamps, black, and the balls put in.

The Principled distribution is GGX (single scatter), the lobe the solver fits, rather than Blender's default with
multiple scattering. The dielectric part is that of IOR 1.5 everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ..result.edits import Sphere
from ..result.types import Textures
from .images import LINEAR, image_from_array
from .version import node_tree

SURFACE = "IRIS Surface"
UV_MAP = "IRIS"


def surface_material(textures: Textures) -> bpy.types.Material:
    """The material of everything that is not a lamp: base colour, roughness and metallic from the atlas."""
    material, shader = _principled(SURFACE)
    tree = material.node_tree
    uv = tree.nodes.new("ShaderNodeUVMap")
    uv.uv_map, uv.location = UV_MAP, (-700, 0)
    maps = (
        ("Base Color", image_from_array("IRIS Base Color", textures.base_color, colorspace=LINEAR, float_buffer=True)),
        ("Metallic", image_from_array("IRIS Metallic", textures.metallic)),
        ("Roughness", image_from_array("IRIS Roughness", textures.roughness)),
    )
    for row, (socket, image) in enumerate(maps):
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image, node.extension, node.location = image, "EXTEND", (-450, 300 - 300 * row)
        tree.links.new(uv.outputs["UV"], node.inputs["Vector"])
        tree.links.new(node.outputs["Color"], shader.inputs[socket])
    return material


def lamp_material(name: str, radiance: Sequence[float] | np.ndarray) -> bpy.types.Material:
    """A black surface that emits ``radiance`` (3,) from both sides, as colour of maximum 1 times strength."""
    material, shader = _black(name)
    _emit(shader, radiance)
    material.cycles.emission_sampling = "FRONT_BACK"
    return material


def one_sided_lamp_material(name: str, radiance: Sequence[float] | np.ndarray) -> bpy.types.Material:
    """A black surface that emits ``radiance`` (3,) from the side its normal points to and nothing from the other."""
    material, shader = _black(name)
    _emit(shader, radiance)
    tree = material.node_tree
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    front = tree.nodes.new("ShaderNodeMath")
    geometry.location, front.location = (-450, -200), (-250, -200)
    front.operation = "MULTIPLY_ADD"  # strength · (1 − backfacing)
    strength = shader.inputs["Emission Strength"].default_value
    front.inputs[1].default_value, front.inputs[2].default_value = -strength, strength
    tree.links.new(geometry.outputs["Backfacing"], front.inputs[0])
    tree.links.new(front.outputs["Value"], shader.inputs["Emission Strength"])
    material.cycles.emission_sampling = "FRONT"
    return material


def black_material(name: str = "IRIS Black") -> bpy.types.Material:
    """A surface that neither reflects nor emits."""
    return _black(name)[0]


def sphere_material(name: str, sphere: Sphere) -> bpy.types.Material:
    """The Principled material of an inserted ball."""
    material, shader = _principled(name)
    shader.inputs["Base Color"].default_value = (*sphere.base_color, 1.0)
    shader.inputs["Roughness"].default_value = sphere.roughness
    shader.inputs["Metallic"].default_value = sphere.metallic
    shader.inputs["Specular IOR Level"].default_value = sphere.specular
    return material


def _principled(name: str) -> tuple[bpy.types.Material, bpy.types.ShaderNodeBsdfPrincipled]:
    material = bpy.data.materials.new(name)
    tree = node_tree(material)
    shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location = (350, 0)
    shader.distribution = "GGX"
    shader.inputs["IOR"].default_value = 1.5
    shader.inputs["Specular IOR Level"].default_value = 0.5
    tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    return material, shader


def _black(name: str) -> tuple[bpy.types.Material, bpy.types.ShaderNodeBsdfPrincipled]:
    material, shader = _principled(name)
    shader.inputs["Base Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    return material, shader


def _emit(shader: bpy.types.ShaderNodeBsdfPrincipled, radiance: Sequence[float] | np.ndarray) -> None:
    radiance = np.asarray(radiance, float)
    strength = float(radiance.max())
    shader.inputs["Emission Color"].default_value = (*(radiance / strength), 1.0)
    shader.inputs["Emission Strength"].default_value = strength
