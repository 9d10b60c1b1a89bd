"""A room photographed with different lamps on: a small capture with full ground truth, rendered by Cycles.

    python -m benchmarks.switched_room switched --out FOLDER [--resolution 240x180] [--samples 64] [--blend FILE]

``switched``: a panel below the ceiling, a lamp on the wall and one on the table; a third of the photos show all on, a
third the panel alone, and a third the other two. ``steady``: all photos show all lamps on. ``mixed``: the photos of the
first without a word on which lamps are on.
"""

from __future__ import annotations

import bpy

from iris_addon.blender.synth.lamp_switches import LIGHT_STATE, ON_IN, UNLIT

from .furnished_room import HEIGHT, box, glow, paint, render_room, wall_in

ROOMS = ("switched", "steady", "mixed")
ALL, CEILING, LOW = "all", "ceiling", "low"
STATES = (ALL, CEILING, LOW)
"""Light states of the photos, in turns."""
UNLIT_ALBEDO = 0.7


def _walls_and_light(name: str) -> None:
    wall_in()
    unlit = paint("unlit", (UNLIT_ALBEDO,) * 3)
    box("panel frame", (1.75, 1.45, HEIGHT - 0.03), (2.45, 2.15, HEIGHT), paint("panel frame", (0.5,) * 3))
    lamps = [
        box("panel", (1.8, 1.5, HEIGHT - 0.05), (2.4, 2.1, HEIGHT - 0.03), glow("panel", (0.9, 0.95, 1.0), 8.0)),
        box("wall lamp", (0.0, 1.2, 1.6), (0.08, 1.36, 1.9), glow("bulb", (1.0, 0.7, 0.42), 24.0)),
        box("table lamp", (2.45, 2.4, 0.78), (2.6, 2.55, 0.98), glow("shade", (1.0, 0.8, 0.55), 9.0)),
    ]
    box("table lamp foot", (2.49, 2.44, 0.74), (2.56, 2.51, 0.78), paint("foot", (0.2,) * 3))
    if name != "steady":
        for lamp, states in zip(lamps, ((ALL, CEILING), (ALL, LOW), (ALL, LOW)), strict=True):
            lamp[ON_IN], lamp[UNLIT] = ",".join(states), unlit


def _photographed(name: str) -> None:
    """Photos in turns under each light state."""
    if name == "steady":
        return
    cameras = [thing for thing in bpy.context.scene.objects if thing.type == "CAMERA"]
    for number, camera in enumerate(sorted(cameras, key=lambda camera: camera.name)):
        camera[LIGHT_STATE] = STATES[number % len(STATES)]


def main() -> None:
    """Command line."""
    render_room(ROOMS, _walls_and_light, __doc__, _photographed, hidden_states=("mixed",))


if __name__ == "__main__":
    main()
