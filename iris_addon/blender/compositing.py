"""The compositing tree of a solved room: a slider per lamp, denoising, then the recovered camera."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from numpy.typing import NDArray

from ..response.curve import Response
from .camera_match import show_through_camera
from .light_groups import group_lights, mix_in_compositor
from .version import can_denoise, compositor_denoise, own_compositor_tree


def add_compositing(
    scene: bpy.types.Scene,
    emitters: Sequence[bpy.types.Object],
    response: Response,
    exposure: NDArray[np.floating],
) -> None:
    """Render layers with a light group per emitter → "IRIS Lights" → denoising → "IRIS Camera" → output.

    Replaces the compositing tree that ``scene`` has. The light groups are denoised after they are mixed, guided by the
    render's albedo and normals: before, each dim one would lose detail.

    Args:
        emitters: lamps and other lights, each an object of ``scene``.
        exposure: (3,) of the photo whose look is wanted.
    """
    names = group_lights(scene, emitters)
    layer = scene.view_layers[0]
    denoise = can_denoise()
    layer.cycles.denoising_store_passes = denoise
    tree = own_compositor_tree(scene)
    tree.nodes.clear()
    layers = tree.nodes.new("CompositorNodeRLayers")
    layers.scene = scene
    mixed = mix_in_compositor(tree, layers, names)
    picture = mixed.outputs["Image"]
    if denoise:
        clean = compositor_denoise(tree)
        tree.links.new(picture, clean.inputs["Image"])
        tree.links.new(layers.outputs["Denoising Albedo"], clean.inputs["Albedo"])
        tree.links.new(layers.outputs["Denoising Normal"], clean.inputs["Normal"])
        picture = clean.outputs["Image"]
    show_through_camera(scene, picture, response, exposure)
    for column, node in enumerate(tree.nodes):
        node.location = (320.0 * column, 0.0)
