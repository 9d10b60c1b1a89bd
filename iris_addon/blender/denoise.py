"""OpenImageDenoise on pictures that are not Cycles' combined pass, through the compositor's node."""

from __future__ import annotations

from collections.abc import Mapping

import bpy
import numpy as np
from numpy.typing import NDArray

from .images import DATA, image_from_array
from .render import render_linear
from .version import compositor_denoise, compositor_output, own_compositor_tree

Picture = NDArray[np.float32]


def denoise_pictures(pictures: Mapping[str, Picture], albedo: Picture, normal: Picture) -> dict[str, Picture]:
    """Each of ``pictures`` (H, W, 3) of linear radiance denoised, guided by the albedo and normals of the same view."""
    before = {kind: set(getattr(bpy.data, kind)) for kind in ("scenes", "cameras", "objects", "images", "node_groups")}
    try:
        scene = _empty_scene(albedo.shape[1], albedo.shape[0])
        tree = own_compositor_tree(scene)
        clean = compositor_denoise(tree)
        source = _image_node(tree, "picture", albedo)
        for socket, node in (
            ("Image", source),
            ("Albedo", _image_node(tree, "albedo", albedo)),
            ("Normal", _image_node(tree, "normal", normal)),
        ):
            tree.links.new(node.outputs["Image"], clean.inputs[socket])
        tree.links.new(clean.outputs["Image"], compositor_output(tree))
        done = {}
        for name, pixels in pictures.items():
            _set_pixels(source.image, pixels)  # one image for all: the compositor keeps what it cached of each
            done[name] = render_linear(scene)
        return done
    finally:
        for kind, kept in before.items():
            bpy.data.batch_remove(set(getattr(bpy.data, kind)) - kept - {bpy.data.images.get("Render Result")})


def _empty_scene(width: int, height: int) -> bpy.types.Scene:
    scene = bpy.data.scenes.new("IRIS Denoise")
    eye = bpy.data.objects.new("IRIS Denoise", bpy.data.cameras.new("IRIS Denoise"))
    scene.collection.objects.link(eye)
    scene.camera = eye
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    scene.render.use_compositing = True
    return scene


def _image_node(tree: bpy.types.NodeTree, name: str, pixels: Picture) -> bpy.types.Node:
    node = tree.nodes.new("CompositorNodeImage")
    node.image = _float_image(name, pixels)
    return node


def _float_image(name: str, pixels: Picture) -> bpy.types.Image:
    image = image_from_array(f"IRIS {name}", pixels, colorspace=DATA, float_buffer=True)
    image.use_half_precision = False
    return image


def _set_pixels(image: bpy.types.Image, pixels: Picture) -> None:
    opaque = np.ones((*pixels.shape[:2], 4), np.float32)
    opaque[..., :3] = pixels[::-1]
    image.pixels.foreach_set(opaque.ravel())
    image.update()
