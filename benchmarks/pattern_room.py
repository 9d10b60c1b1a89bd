"""A room with a lamp that is not equally bright everywhere: a small capture with full ground truth, rendered by Cycles.

    python -m benchmarks.pattern_room television --out FOLDER [--resolution 240x180] [--samples 64] [--blend FILE]

``television``: a screen on the wall shows a still picture, brighter than the wall in most places. ``window``: the room
is lit by a translucent window that brightens upwards and has darker trees behind it, of which photos clip the sky.
``panel``: the window is evenly bright, and has no pattern to be found.
"""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from .furnished_room import HEIGHT, box, glow, paint, place, render_room, square, wall_in

SCREEN = ((2.3, 0.04, 0.9), (0.9, 0.04, 1.7))
"""Lower left and upper right corner of the screen on the south wall, as one sees it, metres."""
WINDOW = ((0.8, 0.01, 0.85), (2.6, 0.01, 2.15))
"""The same of the window."""
COLUMNS, ROWS = 160, 90
"""Pixels of the pictures."""
ROOMS = ("television", "window", "panel")


def _walls_and_light(name: str) -> None:
    wall_in()
    if name == "television":
        box("television", (0.87, 0, 0.87), (2.33, 0.039, 1.73), paint("plastic", (0.03,) * 3, 0.4))
        _shining_wall("screen", *SCREEN, _cartoon(), 2.5)
        box("ceiling lamp", (1.9, 1.4, HEIGHT - 0.05), (2.5, 2.0, HEIGHT), glow("lamp", (1.0, 0.86, 0.7), 9.0))
    else:
        sky = _landscape() if name == "window" else np.broadcast_to([0.8, 0.9, 1.0], (ROWS, COLUMNS, 3))
        _shining_wall("window", *WINDOW, sky, 6.0)
        box("wall lamp", (0.0, 1.2, 1.6), (0.08, 1.36, 1.9), glow("bulb", (1.0, 0.7, 0.42), 8.0))


def _cartoon() -> NDArray[np.float64]:
    """(ROWS, COLUMNS, 3) a meadow under a sky with a sun, and a red house; linear, row 0 at the bottom."""
    y, x = np.indices((ROWS, COLUMNS)) / np.array([ROWS, COLUMNS])[:, None, None]
    picture = np.where((y > 0.45 + 0.06 * np.sin(9 * x))[..., None], [0.25, 0.5, 1.0], [0.12, 0.45, 0.08])
    picture = picture * (0.6 + 0.5 * y)[..., None]
    house = (np.abs(x - 0.35) < 0.12) & (y > 0.25) & (y < 0.55)
    picture[house] = [0.6, 0.08, 0.05]
    picture[house & (np.abs(x - 0.35) < 0.04) & (y < 0.45)] = [0.05, 0.03, 0.02]
    picture[np.hypot(x - 0.78, (y - 0.8) * ROWS / COLUMNS) < 0.06] = [1.6, 1.4, 0.7]
    return picture


def _landscape() -> NDArray[np.float64]:
    """(ROWS, COLUMNS, 3) a sky that brightens upwards over dark trees; linear, row 0 at the bottom."""
    y, x = np.indices((ROWS, COLUMNS)) / np.array([ROWS, COLUMNS])[:, None, None]
    sky = np.array([0.7, 0.85, 1.0]) * (0.5 + 0.9 * y)[..., None]
    trees = y < 0.3 + 0.08 * np.sin(11 * x) + 0.05 * np.sin(29 * x)
    return np.where(trees[..., None], np.array([0.05, 0.09, 0.03]) * (0.5 + y)[..., None], sky)


def _shining_wall(
    name: str, left_bottom: tuple[float, ...], right_top: tuple[float, ...], picture: NDArray[np.floating], level: float
) -> None:
    """An upright rectangle that emits ``picture`` times ``level``."""
    (x0, y0, z0), (x1, y1, z1) = left_bottom, right_top
    data = square(name, [(x0, y0, z0), (x1, y1, z0), (x1, y1, z1), (x0, y0, z1)])
    data.uv_layers.new(name="picture").uv.foreach_set("vector", [0, 0, 1, 0, 1, 1, 0, 1])
    image = bpy.data.images.new(name, COLUMNS, ROWS, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(np.dstack([picture, np.ones((ROWS, COLUMNS))]).astype(np.float32).ravel())
    image.pack()
    material = glow(name, (1, 1, 1), level)
    tree = material.node_tree
    shown = tree.nodes.new("ShaderNodeTexImage")
    shown.image, shown.extension = image, "EXTEND"
    light = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")
    tree.links.new(shown.outputs["Color"], light.inputs["Color"])
    place(data, material)


def main() -> None:
    """Command line."""
    render_room(ROOMS, _walls_and_light, __doc__)


if __name__ == "__main__":
    main()
