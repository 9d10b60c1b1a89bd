"""A room with a planar mirror on its wall: a small capture with full ground truth, rendered by Cycles.

    python -m benchmarks.mirror_room wardrobe --out FOLDER [--resolution 240x180] [--samples 64] [--blend FILE]

``wardrobe``: the whole door of a wardrobe is a mirror, opposite a picture on the wall. ``cabinet``: a smaller mirror
hangs on the wall and shows the lamp to some of the photos. ``steel``: the door is polished steel, which is no mirror.
"""

from __future__ import annotations

from .furnished_room import HEIGHT, WIDTH, box, glow, paint, render_room, wall_in

SILVER = (0.9, 0.92, 0.9)
"""Reflectance of the mirrors and of steel."""
DOOR, CABINET = ((0.9, 0.0, 0.05), (2.3, 0.01, 2.15)), ((WIDTH - 0.02, 2.2, 1.0), (WIDTH, 3.2, 1.9))
"""Corners, metres."""
ROOMS = {"wardrobe": (DOOR, 0.0), "cabinet": (CABINET, 0.0), "steel": (DOOR, 0.1)}
"""Where the metal of each room is, and its roughness."""


def _walls_and_light(name: str) -> None:
    wall_in()
    corners, roughness = ROOMS[name]
    box("mirror", *corners, paint("silver", SILVER, roughness, metallic=1.0))
    box("ceiling lamp", (1.9, 1.4, HEIGHT - 0.05), (2.5, 2.0, HEIGHT), glow("lamp", (1.0, 0.86, 0.7), 9.0))
    box("wall lamp", (0.0, 1.2, 1.6), (0.08, 1.36, 1.9), glow("bulb", (1.0, 0.7, 0.42), 14.0))


def main() -> None:
    """Command line."""
    render_room(ROOMS, _walls_and_light, __doc__)


if __name__ == "__main__":
    main()
