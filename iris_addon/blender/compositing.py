"""The compositing tree of a solved room: a slider per lamp, denoising, then the recovered camera."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from numpy.typing import NDArray

from ..response.curve import Response
from .camera_match import show_through_camera
from .light_groups import group_lights, mixed_picture
from .version import own_compositor_tree


def add_compositing(
    scene: bpy.types.Scene,
    emitters: Sequence[bpy.types.Object],
    response: Response,
    exposure: NDArray[np.floating],
) -> None:
    """Render layers with a light group per emitter → "IRIS Lights" → denoising → "IRIS Camera" → output.

    Replaces the compositing tree that ``scene`` has.

    Args:
        emitters: lamps and other lights, each an object of ``scene``.
        exposure: (3,) of the photo whose look is wanted.
    """
    names = group_lights(scene, emitters)
    tree = own_compositor_tree(scene)
    tree.nodes.clear()
    show_through_camera(scene, mixed_picture(scene, tree, names), response, exposure)
    for column, node in enumerate(tree.nodes):
        node.location = (320.0 * column, 0.0)
