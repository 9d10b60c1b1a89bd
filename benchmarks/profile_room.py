"""A room whose lamps do not shine alike in all directions: a small capture with full ground truth, rendered by Cycles.

    python -m benchmarks.profile_room downlights --out FOLDER [--resolution 240x180] [--samples 64] [--blend FILE]

``downlights``: four small lamps in the ceiling with narrow beams. ``panel``: a large panel as above desks, which is
dark from the side. ``even``: the lamps of the first without a profile, so that there is none to be found.
"""

from __future__ import annotations

import bpy
import numpy as np

from iris_addon.blender.scene_out.materials import lamp_material
from iris_addon.model.lamp_profile import LampProfile

from .furnished_room import HEIGHT, box, glow, paint, place, render_room, square, wall_in

ROOMS = ("downlights", "panel", "even")
NARROW = (1.0, 0.85, 0.45, 0.12, 0.03, 0.01)
"""Radiance of a downlight at 0, 15 ... 75 degrees off its axis."""
SHIELDED = (1.0, 1.05, 1.1, 0.9, 0.4, 0.12)
"""The same of a panel that does not dazzle at desks."""


def _walls_and_light(name: str) -> None:
    wall_in()
    box("wall lamp", (0.0, 1.2, 1.6), (0.08, 1.36, 1.9), glow("bulb", (1.0, 0.7, 0.42), 4.0))
    if name == "panel":
        _facing_down("panel", (2.1, 1.8), 0.6, lamp_material("panel", (6.0, 6.6, 7.2), profile=_profile(SHIELDED)))
        return
    profile = None if name == "even" else _profile(NARROW)
    spot = lamp_material("spot", (30.0, 25.5, 19.5), profile=profile)
    for k, middle in enumerate(((1.0, 0.9), (3.2, 0.9), (1.0, 2.7), (3.2, 2.7))):
        _facing_down(f"spot {k}", middle, 0.14, spot)


def _profile(relative: tuple[float, ...]) -> LampProfile:
    return LampProfile.of(np.array(relative))


def _facing_down(name: str, middle: tuple[float, float], side: float, material: bpy.types.Material) -> None:
    """A square lamp below the ceiling, in a frame."""
    (x, y), half, rim = middle, side / 2, 0.02
    box(f"{name} frame", (x - half - rim, y - half - rim, HEIGHT - 0.02), (x + half + rim, y + half + rim, HEIGHT),
        paint(f"{name} frame", (0.5,) * 3))  # fmt: skip
    corners = [(x + a * half, y + b * half, HEIGHT - 0.025) for a, b in ((-1, -1), (-1, 1), (1, 1), (1, -1))]
    place(square(name, corners), material)


def main() -> None:
    """Command line."""
    render_room(ROOMS, _walls_and_light, __doc__)


if __name__ == "__main__":
    main()
