"""Rooms lit by the sun and the sky through a window: a small capture with full ground truth, rendered by Cycles.

    python -m benchmarks.sunlit_room blind --out FOLDER [--resolution 240x180] [--samples 64] [--blend FILE]

Three rooms have no lamp of their own. ``blind``: the window is a hole in the mesh behind the slats of a blind, and the
sun draws stripes. ``pane``: a pane of glass stands in the window, beside a curtain. ``scan``: a hole behind muntins,
and a low sun that reaches the wall opposite. gt/meta_gt.json names the true direction and irradiance of the sun.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
from mathutils import Vector

from iris_addon.blender.version import node_tree

from .furnished_room import DEPTH, HEIGHT, WALL, WIDTH, box, paint, render_room

WINDOW = (1.1, 2.8, 0.85, 2.25)
"""The opening in the wall y = 0: from x to x and from z to z, metres."""
SKY, GROUND = ((0.25, 0.45, 0.95), (0.85, 0.92, 1.0)), (0.16, 0.14, 0.11)
"""Radiance at the zenith and at the horizon, and of the ground."""
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class SunlitRoom:
    """What tells one room from another.

    Attributes:
        azimuth, elevation: degrees of the sun, counted from the axis of the window towards +x, and above the horizon.
        irradiance: of the sun on a surface that faces it; the sky at the horizon has a radiance of about 1.
        glass: whether a pane stands in the window.
        shade: what hangs before it.
        wall, floor: their colours.
    """

    azimuth: float
    elevation: float
    irradiance: Triple
    glass: bool
    shade: str
    wall: Triple
    floor: Triple


ROOMS = {
    "blind": SunlitRoom(
        azimuth=24,
        elevation=33,
        irradiance=(21, 19, 15.5),
        glass=False,
        shade="blind",
        wall=(0.76, 0.74, 0.68),
        floor=(0.42, 0.27, 0.16),
    ),
    "pane": SunlitRoom(
        azimuth=-31,
        elevation=41,
        irradiance=(24, 22, 19),
        glass=True,
        shade="curtain",
        wall=(0.62, 0.68, 0.66),
        floor=(0.5, 0.46, 0.4),
    ),
    "scan": SunlitRoom(
        azimuth=14,
        elevation=21,
        irradiance=(16, 13, 9),
        glass=False,
        shade="muntins",
        wall=(0.8, 0.7, 0.55),
        floor=(0.3, 0.22, 0.17),
    ),
}


def _walls_and_light(name: str) -> None:
    room = ROOMS[name]
    _shell(room)
    _window(room)
    _sun_and_sky(room)


def direction_to_sun(room: SunlitRoom) -> Triple:
    """Unit vector towards the sun."""
    azimuth, elevation = math.radians(room.azimuth), math.radians(room.elevation)
    level = math.cos(elevation)
    return level * math.sin(azimuth), -level * math.cos(azimuth), math.sin(elevation)


# ---- the room ------------------------------------------------------------------------------------------------------


def _shell(room: SunlitRoom) -> None:
    wall = paint("wall", room.wall)
    trim = paint("white", (0.8, 0.8, 0.78))
    box("floor", (-WALL, -WALL, -WALL), (WIDTH + WALL, DEPTH + WALL, 0), paint("floor", room.floor))
    box("ceiling", (-WALL, -WALL, HEIGHT), (WIDTH + WALL, DEPTH + WALL, HEIGHT + WALL), trim)
    box("wall west", (-WALL, -WALL, 0), (0, DEPTH + WALL, HEIGHT), wall)
    box("wall east", (WIDTH, -WALL, 0), (WIDTH + WALL, DEPTH + WALL, HEIGHT), wall)
    box("wall north", (0, DEPTH, 0), (WIDTH, DEPTH + WALL, HEIGHT), paint("feature wall", (0.25, 0.4, 0.42)))
    left, right, low, high = WINDOW
    around = (
        ((0, 0), (left, HEIGHT)),
        ((right, 0), (WIDTH, HEIGHT)),
        ((left, 0), (right, low)),
        ((left, high), (right, HEIGHT)),
    )
    for k, ((x0, z0), (x1, z1)) in enumerate(around):
        box(f"wall south {k}", (x0, -WALL, z0), (x1, 0, z1), wall)
    box("sill", (left - 0.05, -0.05, low - 0.04), (right + 0.05, 0.12, low), trim)
    for name, low_corner, high_corner in (
        ("skirting west", (0, 0.02, 0), (0.015, DEPTH, 0.09)),
        ("skirting east", (WIDTH - 0.015, 0.02, 0), (WIDTH, DEPTH, 0.09)),
    ):
        box(name, low_corner, high_corner, trim)


def _window(room: SunlitRoom) -> None:
    left, right, low, high = WINDOW
    white = paint("window frame", (0.75, 0.75, 0.73))
    y0, y1, bar = -0.13, -0.07, 0.05
    for k, (x0, z0, x1, z1) in enumerate(
        (
            (left, low, left + bar, high),
            (right - bar, low, right, high),
            (left, low, right, low + bar),
            (left, high - bar, right, high),
        )
    ):
        box(f"frame {k}", (x0, y0, z0), (x1, y1, z1), white)
    if room.glass:
        box("pane", (left + bar, -0.102, low + bar), (right - bar, -0.098, high - bar), _glass())
    if room.shade == "blind":
        slat, count = paint("slat", (0.7, 0.66, 0.58)), 10
        for k in range(count):
            z = high - 0.06 - 0.065 * k
            blade = box(f"slat {k}", (left + 0.03, -0.025, -0.001), (right - 0.03, 0.025, 0.001), slat)
            blade.location, blade.rotation_euler = (0, -0.02, z), (math.radians(18), 0, 0)
    elif room.shade == "curtain":
        box("curtain", (right - 0.35, 0.05, 0.05), (right + 0.3, 0.08, HEIGHT - 0.1), paint("curtain", (0.5, 0.2, 0.2)))
    else:
        middle = 0.5 * (left + right)
        box("muntin", (middle - 0.025, y0, low), (middle + 0.025, y1, high), white)
        box("transom", (left, y0, 1.7), (right, y1, 1.74), white)


def _sun_and_sky(room: SunlitRoom) -> None:
    data = bpy.data.lights.new("sun", "SUN")
    data.energy, data.angle = max(room.irradiance), math.radians(0.53)
    data.color = tuple(value / data.energy for value in room.irradiance)
    sun = bpy.data.objects.new("sun", data)
    sun.rotation_euler = Vector(direction_to_sun(room)).to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(sun)
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    tree = node_tree(world)
    coordinates, axes = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeSeparateXYZ")
    half, ramp = tree.nodes.new("ShaderNodeMapRange"), tree.nodes.new("ShaderNodeValToRGB")
    half.inputs["From Min"].default_value = -1.0
    stops = ramp.color_ramp.elements
    stops[0].position, stops[0].color = 0.0, (*GROUND, 1)
    stops[1].position, stops[1].color = 1.0, (*SKY[0], 1)
    for position, color in ((0.495, GROUND), (0.505, SKY[1])):
        stops.new(position).color = (*color, 1)
    tree.links.new(coordinates.outputs["Generated"], axes.inputs[0])
    tree.links.new(axes.outputs["Z"], half.inputs["Value"])
    tree.links.new(half.outputs["Result"], ramp.inputs["Fac"])
    background, output = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(ramp.outputs["Color"], background.inputs["Color"])
    tree.links.new(background.outputs[0], output.inputs["Surface"])


def _glass() -> bpy.types.Material:
    """A pane that lets 94 % of the light through each of its two sides."""
    material = bpy.data.materials.new("glass")
    tree = node_tree(material)
    clear = tree.nodes.new("ShaderNodeBsdfTransparent")
    clear.inputs["Color"].default_value = (0.94, 0.95, 0.94, 1)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(clear.outputs[0], output.inputs["Surface"])
    return material


def main() -> None:
    """Command line."""
    render_room(ROOMS, _walls_and_light, __doc__)


if __name__ == "__main__":
    main()
