"""Renders of the scene itself: ground-truth maps of its surfaces, and path-traced radiance under changed lamps.

The maps hold the surface parameters at the centre of each pixel. Every material gets AOV outputs for its base colour,
roughness and metallic, and Cycles evaluates them with one sample per pixel through a filter so narrow that the sample
lies at the pixel's centre. Textures and procedural nodes are evaluated by Cycles, and the maps agree with rays through
pixel centres traced against the exported mesh.

Cycles lays the dielectric of a Principled surface over its diffuse base, whereas the metrics' model adds the two lobes.
The diffuse albedo of the maps is what remains of the base under that layer: with the base itself, the true maps would
not reproduce the true pictures.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import OpenEXR
from numpy.typing import NDArray

from ...base.errors import BadInput, IrisError
from ...brdf.ggx import directional_albedo
from ...edits.scene_edit import Quad, Sphere
from ...model.capture import Camera
from ...model.render_settings import RenderSettings
from ..camera import add_camera, look_through
from ..render.cycles import render_linear, set_cycles
from ..scene_out.build import add_sphere
from ..scene_out.lights import add_quad
from ..scene_out.materials import LAYER_ROUGHNESS, black_material, layer_transmittance
from ..scene_out.world import make_world
from ..version import multilayer_exr
from .scene import SceneEmitter, surface_shader

FloatArray = NDArray[np.floating]

AOVS = {
    "iris_base_color": "COLOR",
    "iris_roughness": "VALUE",
    "iris_metallic": "VALUE",
    "iris_layer": "VALUE",
    "iris_base_left": "VALUE",
}


@dataclass(frozen=True)
class Maps:
    """Maps of one view, row 0 on top. Pixels that see nothing are 0.

    Attributes:
        base_color: (H, W, 3) scene-linear Rec.709; 0 on emitters.
        roughness: (H, W) Principled roughness; 1 on emitters.
        metallic: (H, W).
        layer: (H, W) share of the non-metallic surface that has a dielectric over its diffuse base.
        base_left: (H, W) share of the diffuse base's light that this layer transmits.
        emission: (H, W, 3) radiance that the visible surface emits.
        material: (H, W) index of the material, from 1; 0 is nothing.
        normal: (H, W, 3) unit shading normal, world space, towards the viewer.
        depth: (H, W) metres along the ray.
        cosine: (H, W) between normal and direction to the viewer.
        object_index: (H, W) ``pass_index`` of the visible object.
    """

    base_color: FloatArray
    roughness: FloatArray
    metallic: FloatArray
    layer: FloatArray
    base_left: FloatArray
    emission: FloatArray
    material: NDArray[np.int64]
    normal: FloatArray
    depth: FloatArray
    cosine: FloatArray
    object_index: NDArray[np.int64]

    @property
    def diffuse_albedo(self) -> FloatArray:
        """(H, W, 3) kd = a (1 − m), attenuated by the layer."""
        return self.base_color * ((1 - self.metallic) * self.base_left)[..., None]

    @property
    def albedo(self) -> FloatArray:
        """(H, W, 3) directional albedo a' at the view; 0 on emitters and where nothing is seen."""
        seen = (self.material > 0) & ~(self.emission > 0).any(-1)
        black = np.zeros_like(self.base_color)
        dielectric = directional_albedo(black, self.roughness, np.zeros_like(self.metallic), self.cosine)
        metal = directional_albedo(self.base_color, self.roughness, np.ones_like(self.metallic), self.cosine)
        layer, m = ((1 - self.metallic) * self.layer)[..., None], self.metallic[..., None]
        return (self.diffuse_albedo + layer * dielectric + m * metal) * seen[..., None]


# ---- outputs of the materials ---------------------------------------------------------------------------------------

Source = bpy.types.NodeSocket | tuple[float, float, float] | float


def add_outputs(scene: bpy.types.Scene, materials: Sequence[bpy.types.Material]) -> None:
    """Give ``materials`` their AOV outputs and ``pass_index`` 1, 2, …, and switch the passes on.

    Raises:
        BadInput: a surface that the Principled parameters cannot describe.
    """
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_normal = layer.use_pass_emit = True
    layer.use_pass_material_index = layer.use_pass_object_index = True
    for name, kind in AOVS.items():
        aov = layer.aovs.get(name) or layer.aovs.add()
        aov.name, aov.type = name, kind
    for index, material in enumerate(materials, start=1):
        material.pass_index = index
        sources = _principled_inputs(material, surface_shader(material))
        for (name, kind), source in zip(AOVS.items(), sources, strict=True):
            output = material.node_tree.nodes.new("ShaderNodeOutputAOV")
            output.aov_name = name
            _feed(material.node_tree, source, output.inputs["Color" if kind == "COLOR" else "Value"])


def _principled_inputs(material: bpy.types.Material, node: bpy.types.Node | None) -> tuple[Source, ...]:
    """Base colour, roughness, metallic, layer and its transmittance, of the shader tree below ``node``."""
    if node is None or node.bl_idname == "ShaderNodeEmission":
        return (0.0, 0.0, 0.0), 1.0, 0.0, 0.0, 1.0
    inputs = node.inputs

    def source(name: str) -> Source:
        socket = inputs[name]
        if socket.is_linked:
            return socket.links[0].from_socket
        return tuple(socket.default_value[:3]) if socket.type == "RGBA" else socket.default_value

    if node.bl_idname == "ShaderNodeBsdfPrincipled":
        level, roughness = inputs["Specular IOR Level"], source("Roughness")
        layered = level.is_linked or level.default_value > 0
        left = _base_left(material.node_tree, roughness, node.distribution) if layered else 1.0
        return source("Base Color"), roughness, source("Metallic"), float(layered), left
    if node.bl_idname == "ShaderNodeBsdfTransparent":  # adds nothing to the outputs of what lies behind
        return (0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0
    if node.bl_idname == "ShaderNodeBsdfDiffuse":
        return source("Color"), 1.0, 0.0, 0.0, 1.0
    if node.bl_idname == "ShaderNodeBsdfAnisotropic":  # the Glossy BSDF
        return source("Color"), source("Roughness"), 1.0, 1.0, 1.0
    if node.bl_idname == "ShaderNodeMixShader":
        one, other = (_principled_inputs(material, s.links[0].from_node if s.is_linked else None) for s in inputs[1:3])
        return tuple(_mix(material.node_tree, inputs[0], *pair) for pair in zip(one, other, strict=True))
    raise BadInput(
        f"material '{material.name}' has a {node.bl_label} surface, for which there is no ground truth",
        "use a Principled BSDF there",
        bpy.data.filepath or None,
    )


def _base_left(tree: bpy.types.NodeTree, roughness: Source, distribution: str) -> Source:
    """The transmittance of a Principled layer of constant or textured roughness."""
    if isinstance(roughness, float):
        return float(layer_transmittance(roughness, distribution))
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    stops = ramp.color_ramp.elements
    while len(stops) < len(LAYER_ROUGHNESS):
        stops.new(1.0)
    for stop, at in zip(stops, LAYER_ROUGHNESS, strict=True):
        stop.position = at
        stop.color = (*[float(layer_transmittance(at, distribution))] * 3, 1.0)
    _feed(tree, roughness, ramp.inputs[0])
    return ramp.outputs["Color"]


def _mix(tree: bpy.types.NodeTree, factor: bpy.types.NodeSocket, a: Source, b: Source) -> Source:
    mix = tree.nodes.new("ShaderNodeMixRGB")
    _feed(tree, factor.links[0].from_socket if factor.is_linked else factor.default_value, mix.inputs[0])
    _feed(tree, a, mix.inputs[1])
    _feed(tree, b, mix.inputs[2])
    return mix.outputs[0]


def _feed(tree: bpy.types.NodeTree, source: Source, target: bpy.types.NodeSocket) -> None:
    if isinstance(source, bpy.types.NodeSocket):
        tree.links.new(source, target)
    elif target.type == "RGBA":
        target.default_value = (*source, 1.0) if isinstance(source, tuple) else (source, source, source, 1.0)
    else:
        target.default_value = source


# ---- maps -----------------------------------------------------------------------------------------------------------


def render_maps(scene: bpy.types.Scene, camera: Camera, camera_object: bpy.types.Object) -> Maps:
    """Maps of ``scene``, whose materials went through :func:`add_outputs`, as ``camera`` sees it."""
    set_cycles(scene, RenderSettings(samples=1, max_bounces=0, denoise=False))
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    look_through(scene, camera, camera_object)
    passes = render_passes(scene)

    _, directions = camera.rays()
    directions = directions.reshape(camera.height, camera.width, 3)
    material = np.rint(passes["Material Index"][..., 0]).astype(int)
    seen = material > 0
    forward = -camera.c2w[:3, 2]
    depth = np.where(seen, passes["Depth"][..., 0] / (directions @ forward), 0.0)
    normal = passes["Normal"] * seen[..., None]
    cosine = -np.sum(normal * directions, -1)
    emission = passes["Emission"][..., :3]
    lit = (emission > 0).any(-1)
    return Maps(
        base_color=np.where(lit[..., None], 0.0, passes["iris_base_color"][..., :3]),
        roughness=np.where(lit, 1.0, passes["iris_roughness"][..., 0]),
        metallic=np.where(lit, 0.0, passes["iris_metallic"][..., 0]),
        layer=np.where(lit, 0.0, passes["iris_layer"][..., 0]),
        base_left=np.where(lit, 1.0, passes["iris_base_left"][..., 0]),
        emission=emission,
        material=material,
        normal=normal * np.where(cosine < 0, -1, 1)[..., None],
        depth=depth,
        cosine=np.abs(cosine),
        object_index=np.rint(passes["Object Index"][..., 0]).astype(int),
    )


PASS_ALIASES = {"IndexMA": "Material Index", "IndexOB": "Object Index", "Emit": "Emission"}  # names before Blender 5.0


def render_passes(scene: bpy.types.Scene) -> dict[str, NDArray[np.float32]]:
    """Render ``scene`` from its active camera; (H, W, C) per pass by the pass's name in Blender 5."""
    with tempfile.TemporaryDirectory(prefix="iris-") as folder, multilayer_exr(scene.render.image_settings):
        path = Path(folder) / "passes.exr"
        scene.render.filepath = str(path)
        bpy.ops.render.render(scene=scene.name, write_still=True)
        if not path.is_file():
            raise IrisError("Cycles gave no image", "look at Blender's console for the reason, often memory")
        channels: dict[str, dict[str, NDArray]] = {}
        for part in OpenEXR.File(str(path), separate_channels=True).parts:
            for name, channel in part.channels.items():
                *_layer, pass_name, component = name.split(".")
                channels.setdefault(PASS_ALIASES.get(pass_name) or pass_name, {})[component] = channel.pixels
    order = "RGBAXYZWV"
    return {
        name: np.stack([found[c] for c in sorted(found, key=order.index)], -1).astype(np.float32)
        for name, found in channels.items()
    }


# ---- radiance -------------------------------------------------------------------------------------------------------


class Studio:
    """The scene with a movable camera, changeable lamps and inserted balls."""

    def __init__(self, scene: bpy.types.Scene, settings: RenderSettings) -> None:
        self.scene, self.settings = scene, settings

    def radiance(self, camera: Camera) -> NDArray[np.float32]:
        """(H, W, 3) denoised linear radiance, scene-linear Rec.709."""
        set_cycles(self.scene, self.settings)
        with self._camera(camera) as thing:
            look_through(self.scene, camera, thing)
            return render_linear(self.scene)

    def maps(self, camera: Camera) -> Maps:
        """Ground-truth maps of the scene as it stands."""
        with self._camera(camera) as thing:
            return render_maps(self.scene, camera, thing)

    @contextmanager
    def _camera(self, camera: Camera) -> Iterator[bpy.types.Object]:
        thing = add_camera(camera, "synth view", self.scene.collection)
        data = thing.data
        try:
            yield thing
        finally:
            bpy.data.batch_remove([thing, data])

    @contextmanager
    def only_lit_by(
        self, kept: SceneEmitter | None, emitters: Sequence[SceneEmitter], lights: Sequence[Quad] = ()
    ) -> Iterator[None]:
        """Inside, emitters but ``kept`` are black, light objects and the world are off, and ``lights`` are added."""
        black = black_material("synth black")
        swapped = []
        for emitter in emitters:
            if emitter is kept:
                continue
            for slot in self.scene.objects[emitter.name].material_slots:
                if slot.material == emitter.material:
                    swapped.append((slot, slot.material))
                    slot.material = black
        lamps = [thing for thing in self.scene.objects if thing.type == "LIGHT" and not thing.hide_render]
        for lamp in lamps:
            lamp.hide_render = True
        world, self.scene.world = self.scene.world, make_world(None, 1.0, np.eye(3))
        added = [add_quad(quad, f"synth light {k}", self.scene.collection) for k, quad in enumerate(lights)]
        try:
            yield
        finally:
            _remove(added)
            for slot, material in swapped:
                slot.material = material
            for lamp in lamps:
                lamp.hide_render = False
            dark, self.scene.world = self.scene.world, world
            bpy.data.batch_remove([black, dark])

    @contextmanager
    def with_spheres(self, spheres: Sequence[Sphere]) -> Iterator[None]:
        """Inside, ``spheres`` are in the scene; their ``pass_index`` counts from 1, that of everything else is 0."""
        others = {thing: thing.pass_index for thing in self.scene.objects}
        for thing in others:
            thing.pass_index = 0
        added = [add_sphere(sphere, f"synth ball {k}", self.scene.collection) for k, sphere in enumerate(spheres)]
        for k, thing in enumerate(added):
            thing.pass_index = k + 1
        try:
            yield
        finally:
            _remove(added)
            for thing, index in others.items():
                thing.pass_index = index


def _remove(things: Sequence[bpy.types.Object]) -> None:
    meshes = [thing.data for thing in things]
    materials = [material for mesh in meshes for material in mesh.materials]
    bpy.data.batch_remove([*things, *meshes, *materials])
