"""The materials of a solved room: one textured Principled surface, lamps, black, and inserted objects.

The Principled distribution is GGX (single scatter), the lobe the solver fits, rather than Blender's default with
multiple scattering. The dielectric part is that of IOR 1.5 everywhere.

The solver's model adds the two lobes, ``kd / π + specular``; Cycles lays the dielectric over the diffuse base and
attenuates the base by what that layer reflects. :func:`layered_base_color` is the base colour that leaves the diffuse
albedo as recovered; without it a light room becomes a quarter too dark.

Principled's base is Lambertian; where the result has Burley's diffuse lobe, a node group makes the base colour depend
on the view. The solver's lobe is a factor of the light times a factor of the view (:mod:`iris_addon.brdf.diffuse`). A
base colour may depend on the view alone, so it takes the view factor and the mean of the light factor. The next vertex
of a path is "the view" of the surface it leaves, so this holds for bounced light as well. The group also compensates
for the layer, which attenuates more at grazing angles than the mean that :func:`layered_base_color` allows for
(:func:`iris_addon.brdf.ggx.layered_factor`): renderers that have Burley's lobe add the specular one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress

import bpy
import numpy as np
from numpy.typing import NDArray

from ...brdf.diffuse import MEAN_COS2, MEAN_SCHLICK
from ...brdf.ggx import layered_factor
from ...edits.scene_edit import Material, Sphere
from ...model.lamp_profile import LampProfile
from ...model.recovered import DiffuseLobe, Textures
from ...model.seen_classes import coverage_of, seen_colors
from ..images import LINEAR, image_from_array, image_from_pixels, pixels_of
from ..stepwise import Steps, in_thread
from ..version import node_tree
from .lamp_profile_nodes import is_profile, profile_output

SURFACE = "IRIS Surface"
MAKING = "making materials"
UV_MAP = "IRIS"
CONFIDENCE = "IRIS Confidence"
LAMP_ID = "iris_lamp"
"""Custom property of a lamp's material: the id of its emitter in the result."""

PATTERN, TINT = "IRIS Lamp Pattern", "IRIS Lamp Tint"
"""Names of the image of the pattern of lamps, and of the nodes in a lamp's material that multiply it, and the lamp's
profile, by a color."""

RECOVERED = "iris_recovered"
"""Custom property of a lamp's material: the radiance (3,) it was made with."""

LAYER_ROUGHNESS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
LAYER_TRANSMITTANCE = {
    "GGX": (0.9077, 0.9083, 0.9109, 0.9164, 0.9235, 0.9305, 0.9366, 0.9417, 0.9459, 0.9487, 0.9513),
    "MULTI_GGX": (0.9081, 0.9088, 0.9125, 0.9199, 0.9291, 0.9388, 0.9483, 0.9573, 0.9652, 0.9723, 0.9782),
}
"""Share of the base's light that remains under the dielectric (IOR 1.5) of each of Principled's distributions, averaged
over the cosine-weighted hemisphere; measured in Cycles with a ball in a white world (docs/experiments/0008)."""


def layer_transmittance(roughness: NDArray[np.floating] | float, distribution: str = "GGX") -> NDArray[np.float64]:
    """Share (...) of the diffuse base's light that the dielectric layer of Cycles' Principled transmits, in (0, 1]."""
    return np.asarray(np.interp(roughness, LAYER_ROUGHNESS, LAYER_TRANSMITTANCE[distribution]))


def layered_base_color(
    base_color: NDArray[np.floating], roughness: NDArray[np.floating], metallic: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Base colour (..., 3) for Cycles' Principled whose diffuse albedo is that of ``base_color`` in the solver's model.

    Metals have no layer and keep theirs. Capped at 1, above which a surface would reflect more than it receives.
    """
    gain = (1 - metallic) / layer_transmittance(roughness) + metallic
    return np.minimum(base_color * gain[..., None], 1.0).astype(np.float32)


def surface_steps(
    textures: Textures, uv_map: str = UV_MAP, diffuse: DiffuseLobe = "lambert"
) -> Steps[bpy.types.Material]:
    """The material of everything that is not a lamp: base colour, roughness and metallic from the atlas."""
    material, shader = _principled(SURFACE)
    with discarded_on_failure([material]):
        tree = material.node_tree
        uv = tree.nodes.new("ShaderNodeUVMap")
        uv.uv_map, uv.location = uv_map, (-700, 0)

        def base_color() -> NDArray[np.float32]:
            return layered_base_color(textures.base_color, textures.roughness, textures.metallic)

        maps = (
            ("Base Color", base_color, {"colorspace": LINEAR, "float_buffer": True}),
            ("Metallic", lambda: textures.metallic, {}),
            ("Roughness", lambda: textures.roughness, {}),
        )
        for row, (socket, values, kind) in enumerate(maps):
            pixels = yield from in_thread(lambda values=values: pixels_of(values()), MAKING)
            node = tree.nodes.new("ShaderNodeTexImage")
            node.image = image_from_pixels(f"IRIS {socket}", pixels, **kind)
            node.extension, node.location = "EXTEND", (-450, 300 - 300 * row)
            tree.links.new(uv.outputs["UV"], node.inputs["Vector"])
            tree.links.new(node.outputs["Color"], shader.inputs[socket])
            yield MAKING
        if diffuse == "burley":
            insert_burley(tree, shader)
    return material


def confidence_steps(material: bpy.types.Material, textures: Textures) -> Steps[None]:
    """An unlinked image node that maps how often photos show each place; the solid view shows it when it is active."""

    def colors() -> NDArray[np.float32]:
        levels = np.round(np.clip(coverage_of(textures), 0, 1) * 255).astype(np.uint8)
        return pixels_of(seen_colors(np.arange(256) / 255)[levels])

    pixels = yield from in_thread(colors, MAKING)
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.name = node.label = CONFIDENCE
    node.image = image_from_pixels(CONFIDENCE, pixels, colorspace="sRGB")
    node.extension, node.location = "EXTEND", (-450, -700)
    uv = next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeUVMap")
    material.node_tree.links.new(uv.outputs["UV"], node.inputs["Vector"])


def images_of(materials: Iterable[bpy.types.Material]) -> list[bpy.types.Image]:
    """The images that nodes of ``materials`` and of their groups have, each once."""
    trees, found = [material.node_tree for material in materials if material.node_tree], {}
    for tree in trees:  # which grows
        for node in tree.nodes:
            inside, image = getattr(node, "node_tree", None), getattr(node, "image", None)
            if inside is not None and inside not in trees:
                trees.append(inside)
            if image is not None:
                found[image] = None
    return list(found)


@contextmanager
def discarded_on_failure(made: Sequence[bpy.types.ID]) -> Iterator[None]:
    """Remove ``made``, materials with their images, where what is inside fails or is given up."""
    try:
        yield
    except BaseException:
        with suppress(ReferenceError):  # another file was opened, or they were undone
            images = images_of(block for block in made if isinstance(block, bpy.types.Material))
            bpy.data.batch_remove({*made, *images})
        raise


def lamp_material(
    name: str,
    radiance: Sequence[float] | np.ndarray,
    pattern: bpy.types.Image | None = None,
    uv_map: str = UV_MAP,
    profile: LampProfile | None = None,
) -> bpy.types.Material:
    """A black surface that emits ``radiance`` (3,) from both sides, as colour of maximum 1 times strength.

    Args:
        pattern: image on ``uv_map`` that multiplies it.
        profile: by angle, which multiplies it too.
    """
    material, shader = _black(name)
    if pattern is not None:
        _multiply(material.node_tree, shader, _pattern_output(material.node_tree, pattern, uv_map))
    if profile is not None:
        _multiply(material.node_tree, shader, profile_output(material.node_tree, profile))
    _emit(shader, radiance)
    material.cycles.emission_sampling = "FRONT_BACK"
    return material


def _pattern_output(tree: bpy.types.NodeTree, pattern: bpy.types.Image, uv_map: str) -> bpy.types.NodeSocket:
    uv, image = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("UVMap", "TexImage"))
    uv.location, image.location = (-900, 0), (-650, 0)
    uv.uv_map, image.image, image.extension = uv_map, pattern, "EXTEND"
    tree.links.new(uv.outputs["UV"], image.inputs["Vector"])
    return image.outputs["Color"]


def _multiply(
    tree: bpy.types.NodeTree, shader: bpy.types.ShaderNodeBsdfPrincipled, share: bpy.types.NodeSocket
) -> None:
    """Multiply the colour that ``shader`` emits by ``share``."""
    color = emission_color(shader)
    tint = tree.nodes.new("ShaderNodeMix")
    tint.name = tint.label = TINT
    tint.data_type, tint.blend_type = "RGBA", "MULTIPLY"
    tint.location = (-300, -250 * sum(node.name.startswith(TINT) for node in tree.nodes) + 250)
    factor, shown, _ = (_socket(tint.inputs, identifier) for identifier in MIX_INPUTS)
    factor.default_value = 1.0
    tree.links.new(share, shown)
    tree.links.new(_socket(tint.outputs, "Result_Color"), color)


def emission_color(shader: bpy.types.Node) -> bpy.types.NodeSocket:
    """The socket that holds the colour of a lamp: that of its ``shader``, or what multiplies pattern and profile."""
    socket = shader.inputs["Emission Color"]
    while socket.is_linked and socket.links[0].from_node.name.startswith(TINT):
        socket = _socket(socket.links[0].from_node.inputs, MIX_INPUTS[2])
    return socket


def below_profile(color: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """The socket whose colour a profile multiplies before it arrives at ``color``; ``color`` itself without one."""
    node = color.links[0].from_node if color.is_linked else None
    if node is None or not node.name.startswith(TINT):
        return color
    share = _socket(node.inputs, MIX_INPUTS[1])
    profiled = share.is_linked and is_profile(share.links[0].from_node)
    return _socket(node.inputs, MIX_INPUTS[2]) if profiled else color


MIX_INPUTS = ("Factor_Float", "A_Color", "B_Color")
"""Sockets of a Mix node of colours; others of the same names are for other types."""


def _socket(sockets: Iterable[bpy.types.NodeSocket], identifier: str) -> bpy.types.NodeSocket:
    return next(socket for socket in sockets if socket.identifier == identifier)


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


def pane_material(name: str = "IRIS Pane") -> bpy.types.Material:
    """A pane of glass as the solve saw through it: light and cameras pass, and its reflection is left out.

    What light loses in the glass is already missing in the recovered sun, sky and backdrop.
    """
    material, shader = _black(name)
    shader.inputs["Alpha"].default_value = 0.0
    material.diffuse_color = (0.8, 0.9, 1.0, 0.1)
    return material


def sphere_material(name: str, sphere: Sphere | Material) -> bpy.types.Material:
    """The Principled material of an inserted object, with values as those of the room."""
    material, shader = _principled(name)
    roughness, metallic = np.array(sphere.roughness), np.array(sphere.metallic)
    base_color = layered_base_color(np.array(sphere.base_color), roughness, metallic)
    shader.inputs["Base Color"].default_value = (*base_color, 1.0)
    shader.inputs["Roughness"].default_value = sphere.roughness
    shader.inputs["Metallic"].default_value = sphere.metallic
    shader.inputs["Specular IOR Level"].default_value = sphere.specular
    if isinstance(sphere, Material) and max(sphere.emission) > 0:
        _emit(shader, sphere.emission)
        material.cycles.emission_sampling = "FRONT_BACK"
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
    emission_color(shader).default_value = (*(radiance / strength if strength > 0 else np.ones(3)), 1.0)
    shader.inputs["Emission Strength"].default_value = strength


# ---- Burley's diffuse lobe -----------------------------------------------------------------------------------------

BURLEY_GROUP = "IRIS Burley Diffuse"
UNLAYERED_IMAGE, UNLAYERED_SIZE = "IRIS Unlayered", (16, 128)
"""Image of the inverse of the layer's factor, over roughness (upwards) and over the cosine to the viewer."""


def insert_burley(tree: bpy.types.NodeTree, shader: bpy.types.ShaderNodeBsdfPrincipled) -> None:
    """Insert the group in front of the base colour of ``shader``."""
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree, node.location = burley_group(), (-180, 200)
    for name, socket in (("Color", "Base Color"), ("Roughness", "Roughness"), ("Metallic", "Metallic")):
        for link in shader.inputs[socket].links:
            tree.links.new(link.from_socket, node.inputs[name])
    tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])


def remove_burley(tree: bpy.types.NodeTree) -> None:
    """Undo :func:`insert_burley`; a tree without the group stays as it is."""
    for node in [
        n for n in tree.nodes if n.bl_idname == "ShaderNodeGroup" and n.node_tree.name.startswith(BURLEY_GROUP)
    ]:
        source = node.inputs["Color"].links[0].from_socket
        for link in list(node.outputs["Color"].links):
            tree.links.new(source, link.to_socket)
        tree.nodes.remove(node)


def burley_group() -> bpy.types.NodeTree:
    """The node group: Color, Roughness and Metallic in, the base colour as seen from the incoming direction out."""
    group = bpy.data.node_groups.new(BURLEY_GROUP, "ShaderNodeTree")
    for name, kind in (("Color", "NodeSocketColor"), ("Roughness", "NodeSocketFloat"), ("Metallic", "NodeSocketFloat")):
        group.interface.new_socket(name, in_out="INPUT", socket_type=kind)
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    source, sink = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    geometry = group.nodes.new("ShaderNodeNewGeometry")
    source.location, geometry.location, sink.location = (-900, 0), (-900, -250), (900, 0)

    facing = group.nodes.new("ShaderNodeVectorMath")
    facing.operation, facing.location = "DOT_PRODUCT", (-700, -250)
    group.links.new(geometry.outputs["Incoming"], facing.inputs[0])
    group.links.new(geometry.outputs["Normal"], facing.inputs[1])
    cosine = _math(group, "ABSOLUTE", facing.outputs["Value"], at=(-520, -250))
    schlick = _math(group, "POWER", _math(group, "SUBTRACT", 1.0, cosine, at=(-340, -250)), 5.0, at=(-160, -250))
    kappa = _math(group, "MULTIPLY_ADD", source.outputs["Roughness"], 2 * MEAN_COS2, -0.5, at=(-340, -50))
    view = _math(group, "MULTIPLY_ADD", kappa, schlick, 1.0, at=(20, -250))
    light = _math(group, "MULTIPLY_ADD", kappa, MEAN_SCHLICK, 1.0, at=(20, -50))
    lobe = _math(group, "MULTIPLY", view, light, at=(200, -150))
    unlayered = _unlayered(group, cosine, source.outputs["Roughness"])
    excess = _math(group, "MULTIPLY_ADD", lobe, unlayered, -1.0, at=(380, -150))
    # A metal has no diffuse lobe: its base colour is that of its highlight.
    dielectric = _math(group, "SUBTRACT", 1.0, source.outputs["Metallic"], at=(380, -350))
    gain = _math(group, "MULTIPLY_ADD", excess, dielectric, 1.0, at=(560, -150))
    scaled = group.nodes.new("ShaderNodeVectorMath")
    scaled.operation, scaled.location = "SCALE", (720, 0)
    group.links.new(source.outputs["Color"], scaled.inputs[0])
    group.links.new(gain, scaled.inputs["Scale"])
    group.links.new(scaled.outputs["Vector"], sink.inputs["Color"])
    return group


def _unlayered(
    tree: bpy.types.NodeTree, cosine: bpy.types.NodeSocket, roughness: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """One over the factor of the layer, from a table."""
    rows, columns = UNLAYERED_SIZE
    factor = layered_factor(np.linspace(0, 1, rows)[:, None], np.linspace(0, 1, columns)[None])
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image_from_array(UNLAYERED_IMAGE, 1 / factor[::-1], float_buffer=True)
    node.extension, node.location = "EXTEND", (-160, -500)
    at = tree.nodes.new("ShaderNodeCombineXYZ")
    at.location = (-340, -500)
    # Values lie at the centres of texels.
    for axis, value, size, height in (("X", cosine, columns, -430), ("Y", roughness, rows, -600)):
        placed = _math(tree, "MULTIPLY_ADD", value, (size - 1) / size, 0.5 / size, at=(-520, height))
        tree.links.new(placed, at.inputs[axis])
    tree.links.new(at.outputs["Vector"], node.inputs["Vector"])
    return node.outputs["Color"]


def _math(
    tree: bpy.types.NodeTree, operation: str, *values: bpy.types.NodeSocket | float, at: tuple[float, float]
) -> bpy.types.NodeSocket:
    node = tree.nodes.new("ShaderNodeMath")
    node.operation, node.location = operation, at
    for socket, value in zip(node.inputs, values, strict=False):
        if isinstance(value, float):
            socket.default_value = value
        else:
            tree.links.new(value, socket)
    return node.outputs["Value"]
