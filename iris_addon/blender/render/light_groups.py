"""One Cycles light group per lamp: a single render holds the share of every lamp, and relighting is a weighted sum.

The shares are mixed by :mod:`iris_addon.edits.light_shares`, or by artists in the compositor with the node group
"IRIS Lights". A light that is off when the room is rendered has no share.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.exr_planes import read_exr_planes
from ...edits.light_shares import LightShares
from ...edits.scene_edit import OUTSIDE, SceneEdit
from ...model.capture import Camera
from ...model.render_settings import RenderSettings
from ...results.result import Result
from ..camera import add_camera, look_through
from ..scene_out.backdrop import is_backdrop
from ..scene_out.build import build_scene
from ..scene_out.lights import STANDS_FOR
from ..version import can_denoise, compositor_denoise, compositor_mix, multilayer_exr
from .cycles import denoise_pictures, render_exr, set_cycles

MIX_GROUP = "IRIS Lights"


def render_light_shares(
    result: Result,
    camera: Camera,
    *,
    edit: SceneEdit | None = None,
    settings: RenderSettings | None = None,
) -> LightShares:
    """Path-trace one view of ``result`` as changed by ``edit``, with the share of every light kept apart.

    Each share is denoised by itself: a light that is dim now may be turned up later.

    Lights are named "IRIS Lamp 00" … by the id of the recovered lamp, "IRIS Outside" for light from outside,
    "IRIS Sun", and as :func:`~iris_addon.blender.scene_out.build.build_scene` names what the edit adds.

    Args:
        settings: None for the defaults.
    """
    settings = settings or RenderSettings()
    built = build_scene(result, edit, lamps_apart=True)
    try:
        set_cycles(built.scene, settings)
        sun = [] if built.sun is None else [built.sun]
        names = group_lights(built.scene, [*built.lamps, *sun, *built.lights, *built.inserted])
        look_through(built.scene, camera, add_camera(camera, "IRIS View", built.scene.collection))
        return grouped_shares(built.scene, names, settings.denoise and can_denoise())
    finally:
        built.free()


def group_lights(scene: bpy.types.Scene, things: Sequence[bpy.types.Object]) -> list[str]:
    """Give each light and emissive object among ``things``, and the world, a light group; returns their names.

    The backdrop belongs to the group of the world.
    """
    layer = scene.view_layers[0]
    names = []
    for thing in filter(_emits, things):
        if is_backdrop(thing):
            continue
        name = _group_name(thing)
        if name not in names:
            layer.lightgroups.add(name=name)
            names.append(name)
        thing.lightgroup = name
    if scene.world is not None:
        layer.lightgroups.add(name=OUTSIDE)
        scene.world.lightgroup = OUTSIDE
        names.append(OUTSIDE)
        for thing in filter(is_backdrop, scene.objects):
            thing.lightgroup = OUTSIDE
    return names


def _group_name(thing: bpy.types.Object) -> str:
    """The object's name, without the number that Blender appends where another scene has an object of that name.

    Names of passes in image files have no dots. A light in place of a lamp is grouped with what cameras see of it.
    """
    lamp = thing.get(STANDS_FOR)
    name = thing.name.removesuffix(" Mesh") if lamp is None else lamp.name
    return re.sub(r"\.\d{3,}$", "", name) if name.startswith("IRIS ") else name.replace(".", "_")


# ---- in the compositor ---------------------------------------------------------------------------------------------


def light_mix_group(names: Sequence[str]) -> bpy.types.NodeTree:
    """The node group "IRIS Lights": a picture, a strength and a colour per light in, their sum out."""
    tree = bpy.data.node_groups.new(MIX_GROUP, "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    source, target = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    total = None
    for row, name in enumerate(names):
        picture = tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor")
        picture.default_value, picture.hide_value = (0.0, 0.0, 0.0, 1.0), True
        strength = tree.interface.new_socket(f"{name} Strength", in_out="INPUT", socket_type="NodeSocketFloat")
        strength.default_value, strength.min_value, strength.max_value = 1.0, 0.0, 100.0
        color = tree.interface.new_socket(f"{name} Color", in_out="INPUT", socket_type="NodeSocketColor")
        color.default_value = (1.0, 1.0, 1.0, 1.0)
        light, tint, tinted = compositor_mix(tree, "MULTIPLY")
        colored, factor, scaled = compositor_mix(tree, "MULTIPLY")
        tree.links.new(source.outputs[name], light)
        tree.links.new(source.outputs[color.name], tint)
        tree.links.new(tinted, colored)
        tree.links.new(source.outputs[strength.name], factor)
        sockets = [tinted, scaled]
        if total is not None:
            before, added, summed = compositor_mix(tree, "ADD")
            tree.links.new(total, before)
            tree.links.new(scaled, added)
            sockets.append(summed)
        total = sockets[-1]
        for column, socket in enumerate(sockets):
            socket.node.location = (250.0 + 200.0 * column, -220.0 * row)
    target.location = (1000.0, 0.0)
    if total is not None:
        tree.links.new(total, target.inputs["Image"])
    return tree


def mixed_picture(scene: bpy.types.Scene, tree: bpy.types.NodeTree, names: Sequence[str]) -> bpy.types.NodeSocket:
    """Add nodes to ``tree`` (render layers, "IRIS Lights", denoising) and return the socket of the mixed picture.

    The light groups are denoised after mixing, guided by the render's albedo and normals: before, dim groups would lose
    detail.
    """
    layers, node = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeGroup")
    layers.scene = scene
    node.node_tree = light_mix_group(names)
    node.name = node.label = MIX_GROUP
    node.width = 260.0
    for name in names:
        tree.links.new(layers.outputs[f"Combined_{name}"], node.inputs[name])
    denoise = can_denoise()
    scene.view_layers[0].cycles.denoising_store_passes = denoise
    if not denoise:
        return node.outputs["Image"]
    clean = compositor_denoise(tree)
    tree.links.new(node.outputs["Image"], clean.inputs["Image"])
    tree.links.new(layers.outputs["Denoising Albedo"], clean.inputs["Albedo"])
    tree.links.new(layers.outputs["Denoising Normal"], clean.inputs["Normal"])
    return clean.outputs["Image"]


# ---- pixels --------------------------------------------------------------------------------------------------------


def grouped_shares(scene: bpy.types.Scene, names: Sequence[str], denoise: bool) -> LightShares:
    """The picture of ``scene`` from its active camera, with the share of each light group of ``names``."""
    scene.view_layers[0].cycles.denoising_store_passes = denoise
    with tempfile.TemporaryDirectory(prefix="iris-") as folder, multilayer_exr(scene.render.image_settings):
        path = Path(folder) / "shares.exr"
        render_exr(scene, path)
        channels = read_exr_planes(path)
    shares = {name: _pick(channels, f"Combined_{name}") for name in names}
    if denoise:
        guides = _pick(channels, "Denoising Albedo"), _pick(channels, "Denoising Normal", "XYZ")
        shares = denoise_pictures(shares, *guides)
    return LightShares(_pick(channels, "Combined"), shares)


def _pick(channels: Mapping[str, NDArray[np.floating]], name: str, letters: str = "RGB") -> NDArray[np.float32]:
    """(H, W, 3) of the pass ``name``, whatever its view layer is called."""
    found = {key.rpartition(".")[2]: pixels for key, pixels in channels.items() if key.split(".")[-2:-1] == [name]}
    return np.stack([found[channel] for channel in letters], -1).astype(np.float32)


def _emits(thing: bpy.types.Object) -> bool:
    """Whether ``thing`` is a light or has an emissive material."""
    if thing.type == "LIGHT":
        return True
    nodes = (
        node
        for slot in thing.material_slots
        if slot.material is not None and slot.material.node_tree is not None
        for node in slot.material.node_tree.nodes
    )
    for node in nodes:
        strength = node.inputs.get("Emission Strength") if node.bl_idname == "ShaderNodeBsdfPrincipled" else None
        if node.bl_idname == "ShaderNodeEmission" or (strength and (strength.is_linked or strength.default_value > 0)):
            return True
    return False
