"""Light shares of a room as an artist's scene has it, seen by its camera: what pictures of looks are mixed from."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.files import write_arrays
from ...edits.scene_edit import OUTSIDE
from ...model.render_settings import RenderSettings
from ..apply.camera_look import stop_matching
from ..apply.look_gains import OUTSIDE_SHARE, OVERCAST_SHARE, SUN_SHARE, lamp_share
from ..render.cycles import set_cycles
from ..render.light_groups import grouped_shares
from ..render.light_mixing import APART, start_mixing
from ..scene_out.lights import is_recovered_sun
from ..scene_out.world import is_gray, set_gray
from ..version import can_denoise
from .photo_composite import open_scene


def render_look_shares(scene: bpy.types.Scene, width: int, settings: RenderSettings) -> dict[str, NDArray[np.float32]]:
    """The share of every light of ``scene``, a copy of a room by its recovered light (``write_room_copy``).

    Changes ``scene``: pass a copy.

    Returns:
        (H, W, 3) radiance by the names of :mod:`iris_addon.blender.apply.look_gains`, from the active camera, about
        ``width`` pixels wide where its frame is not smaller.

    Raises:
        BadInput: nothing in the scene emits light.
        IrisError: Cycles gave no picture.
    """
    stop_matching(scene)
    names = start_mixing(scene)
    of_group = {OUTSIDE: OUTSIDE_SHARE}
    for thing in scene.objects:
        if APART in thing:
            of_group[thing.lightgroup] = lamp_share(thing.data.materials[0])
        elif is_recovered_sun(thing):
            of_group[thing.lightgroup] = SUN_SHARE
    render = scene.render
    render.resolution_percentage = max(1, min(100, round(100 * width / render.resolution_x)))
    render.use_border, render.film_transparent = False, False
    set_cycles(scene, settings)
    denoise = settings.denoise and can_denoise()
    light = grouped_shares(scene, names, denoise)
    shares: dict[str, NDArray[np.float32]] = {}
    for name, share in light.shares.items():
        if name in of_group:  # a lamp that lies on several objects has several groups
            shares[of_group[name]] = shares.get(of_group[name], 0) + share
    set_gray(scene.world, True)
    if is_gray(scene.world):
        shares[OVERCAST_SHARE] = grouped_shares(scene, [OUTSIDE], denoise).shares[OUTSIDE]
    return shares


def look_shares_file(blend: Path, out: Path, *, width: int, settings: RenderSettings) -> None:
    """Write :func:`render_look_shares` of the scene in ``blend`` as the archive ``out``, in half precision. Opens
    ``blend``.

    Raises:
        BadInput: ``blend`` cannot be read, or has no light.
        IrisError: ``out`` cannot be written.
    """
    shares = render_look_shares(open_scene(blend), width, settings)
    highest = float(np.finfo(np.float16).max)
    halves = {name: np.clip(share, 0.0, highest).astype(np.float16) for name, share in shares.items()}
    write_arrays(out, halves, compressed=True)
