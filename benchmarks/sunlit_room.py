"""Rooms lit by the sun and the sky through a window: a small capture with full ground truth, rendered by Cycles.

    python -m benchmarks.sunlit_room blind --out FOLDER [--resolution 240x180] [--samples 64] [--blend FILE]

Three rooms have no lamp of their own. ``blind``: the window is a hole in the mesh behind the slats of a blind, and the
sun draws stripes. ``pane``: a pane of glass stands in the window, beside a curtain. ``scan``: a hole behind muntins,
and a low sun that reaches the wall opposite. gt/meta_gt.json names the true direction and irradiance of the sun.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
from mathutils import Vector

from iris_addon.base.progress import Progress, console
from iris_addon.blender.synth.run import STAGE_WEIGHTS, TRUTH_RENDER, SynthConfig, synth
from iris_addon.blender.version import node_tree

WIDTH, DEPTH, HEIGHT = 4.2, 3.6, 2.6
"""Inside of the room along x, y and z, metres."""
WALL = 0.2
"""Thickness of walls, floor and ceiling, metres."""
WINDOW = (1.1, 2.8, 0.85, 2.25)
"""The opening in the wall y = 0: from x to x and from z to z, metres."""
SKY, GROUND = ((0.25, 0.45, 0.95), (0.85, 0.92, 1.0)), (0.16, 0.14, 0.11)
"""Radiance at the zenith and at the horizon, and of the ground."""
FIELD_OF_VIEW = math.radians(72)
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

# Position and point looked at, metres.
TRAIN = (
    ((3.9, 0.35, 1.5), (0.9, 3.0, 0.7)), ((3.8, 1.9, 1.4), (0.3, 1.4, 0.9)), ((3.8, 3.3, 1.6), (1.0, 0.9, 0.9)),
    ((2.1, 3.3, 1.5), (2.0, 0.0, 1.2)), ((0.4, 3.3, 1.6), (3.3, 0.5, 1.0)), ((0.4, 1.8, 1.4), (4.0, 2.0, 0.9)),
    ((0.35, 0.4, 1.6), (3.5, 2.9, 0.6)), ((2.0, 0.5, 1.5), (2.2, 3.5, 1.0)), ((2.0, 1.9, 1.7), (1.4, 3.2, 0.0)),
    ((2.4, 2.6, 1.6), (2.6, 0.9, 0.0)), ((1.2, 2.4, 1.0), (3.3, 1.6, 2.6)), ((3.2, 1.2, 1.0), (1.2, 2.4, 2.6)),
    ((3.5, 2.8, 1.2), (3.0, 0.2, 1.4)), ((0.9, 1.0, 1.2), (0.4, 3.2, 0.8)), ((3.0, 0.6, 1.3), (4.0, 3.0, 0.6)),
    ((1.5, 3.0, 1.3), (0.2, 1.0, 0.4)),
)  # fmt: skip
VALIDATION = (
    ((3.7, 0.9, 1.5), (0.8, 2.4, 0.8)), ((0.6, 2.6, 1.5), (3.4, 0.8, 0.8)), ((2.3, 3.2, 1.4), (1.6, 0.4, 0.8)),
    ((1.4, 0.7, 1.4), (2.9, 3.3, 0.7)),
)  # fmt: skip


def build(room: SunlitRoom, blend: Path) -> None:
    """Model the room in an empty file and save it as ``blend``."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.unit_settings.system = "METRIC"
    _shell(room)
    _furniture()
    _window(room)
    _sun_and_sky(room)
    for prefix, views in (("photo", TRAIN), ("val", VALIDATION)):
        for k, (position, target) in enumerate(views):
            data = bpy.data.cameras.new(f"{prefix} {k:02d}")
            data.sensor_fit, data.angle, data.clip_start = "HORIZONTAL", FIELD_OF_VIEW, 0.01
            camera = bpy.data.objects.new(data.name, data)
            bpy.context.scene.collection.objects.link(camera)
            camera.location = position
            camera.rotation_euler = (Vector(target) - Vector(position)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.camera = bpy.data.objects["photo 00"]
    bpy.ops.wm.save_as_mainfile(filepath=str(blend.absolute()), compress=True)


def direction_to_sun(room: SunlitRoom) -> Triple:
    """Unit vector towards the sun."""
    azimuth, elevation = math.radians(room.azimuth), math.radians(room.elevation)
    level = math.cos(elevation)
    return level * math.sin(azimuth), -level * math.cos(azimuth), math.sin(elevation)


# ---- the room ------------------------------------------------------------------------------------------------------


def _shell(room: SunlitRoom) -> None:
    wall = _paint("wall", room.wall)
    trim = _paint("white", (0.8, 0.8, 0.78))
    _box("floor", (-WALL, -WALL, -WALL), (WIDTH + WALL, DEPTH + WALL, 0), _paint("floor", room.floor))
    _box("ceiling", (-WALL, -WALL, HEIGHT), (WIDTH + WALL, DEPTH + WALL, HEIGHT + WALL), trim)
    _box("wall west", (-WALL, -WALL, 0), (0, DEPTH + WALL, HEIGHT), wall)
    _box("wall east", (WIDTH, -WALL, 0), (WIDTH + WALL, DEPTH + WALL, HEIGHT), wall)
    _box("wall north", (0, DEPTH, 0), (WIDTH, DEPTH + WALL, HEIGHT), _paint("feature wall", (0.25, 0.4, 0.42)))
    left, right, low, high = WINDOW
    around = (
        ((0, 0), (left, HEIGHT)),
        ((right, 0), (WIDTH, HEIGHT)),
        ((left, 0), (right, low)),
        ((left, high), (right, HEIGHT)),
    )
    for k, ((x0, z0), (x1, z1)) in enumerate(around):
        _box(f"wall south {k}", (x0, -WALL, z0), (x1, 0, z1), wall)
    _box("sill", (left - 0.05, -0.05, low - 0.04), (right + 0.05, 0.12, low), trim)
    for name, low_corner, high_corner in (
        ("skirting west", (0, 0.02, 0), (0.015, DEPTH, 0.09)),
        ("skirting east", (WIDTH - 0.015, 0.02, 0), (WIDTH, DEPTH, 0.09)),
    ):
        _box(name, low_corner, high_corner, trim)


def _furniture() -> None:
    oak, white = _paint("oak", (0.45, 0.3, 0.17), 0.35), _paint("chair", (0.78, 0.78, 0.76))
    red, blue, black = (
        _paint("rug", (0.42, 0.1, 0.08)),
        _paint("cloth", (0.14, 0.2, 0.42)),
        _paint("frame", (0.04,) * 3),
    )
    _box("table top", (1.5, 1.9, 0.70), (2.8, 2.7, 0.74), oak)
    for k, (x, y) in enumerate(((1.55, 1.95), (2.75, 1.95), (1.55, 2.65), (2.75, 2.65))):
        _box(f"table leg {k}", (x - 0.03, y - 0.03, 0), (x + 0.03, y + 0.03, 0.70), oak)
    for k, (x, y) in enumerate(((1.0, 2.1), (3.05, 2.3))):
        _box(f"seat {k}", (x - 0.2, y - 0.2, 0.42), (x + 0.2, y + 0.2, 0.46), white)
        _box(f"back {k}", (x - 0.2, y + 0.17, 0.46), (x + 0.2, y + 0.2, 0.95), white)
        for n, (dx, dy) in enumerate(((-0.18, -0.18), (0.18, -0.18), (-0.18, 0.18), (0.18, 0.18))):
            _box(f"chair leg {k} {n}", (x + dx - 0.02, y + dy - 0.02, 0), (x + dx + 0.02, y + dy + 0.02, 0.42), white)
    _box("rug", (1.2, 0.7, 0), (3.0, 1.6, 0.012), red)
    _box("cupboard", (0.05, 2.5, 0), (0.45, 3.5, 1.1), _paint("cupboard", (0.35, 0.42, 0.3), 0.5))
    _box("sofa seat", (3.3, 0.9, 0), (4.15, 2.0, 0.42), blue)
    _box("sofa back", (3.98, 0.9, 0.42), (4.15, 2.0, 0.85), blue)
    _box("picture", (1.6, DEPTH - 0.03, 1.3), (2.5, DEPTH, 1.9), black)
    _box("print", (1.66, DEPTH - 0.035, 1.36), (2.44, DEPTH - 0.03, 1.84), _paint("print", (0.6, 0.45, 0.2)))
    _box("vase", (2.0, 2.2, 0.74), (2.12, 2.32, 1.02), _paint("vase", (0.15, 0.35, 0.2), 0.3))


def _window(room: SunlitRoom) -> None:
    left, right, low, high = WINDOW
    white = _paint("window frame", (0.75, 0.75, 0.73))
    y0, y1, bar = -0.13, -0.07, 0.05
    for k, (x0, z0, x1, z1) in enumerate(
        (
            (left, low, left + bar, high),
            (right - bar, low, right, high),
            (left, low, right, low + bar),
            (left, high - bar, right, high),
        )
    ):
        _box(f"frame {k}", (x0, y0, z0), (x1, y1, z1), white)
    if room.glass:
        _box("pane", (left + bar, -0.102, low + bar), (right - bar, -0.098, high - bar), _glass())
    if room.shade == "blind":
        slat, count = _paint("slat", (0.7, 0.66, 0.58)), 10
        for k in range(count):
            z = high - 0.06 - 0.065 * k
            blade = _box(f"slat {k}", (left + 0.03, -0.025, -0.001), (right - 0.03, 0.025, 0.001), slat)
            blade.location, blade.rotation_euler = (0, -0.02, z), (math.radians(18), 0, 0)
    elif room.shade == "curtain":
        _box(
            "curtain", (right - 0.35, 0.05, 0.05), (right + 0.3, 0.08, HEIGHT - 0.1), _paint("curtain", (0.5, 0.2, 0.2))
        )
    else:
        middle = 0.5 * (left + right)
        _box("muntin", (middle - 0.025, y0, low), (middle + 0.025, y1, high), white)
        _box("transom", (left, y0, 1.7), (right, y1, 1.74), white)


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


# ---- shapes and materials ------------------------------------------------------------------------------------------


def _box(name: str, low: Sequence[float], high: Sequence[float], material: bpy.types.Material) -> bpy.types.Object:
    corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    data = bpy.data.meshes.new(name)
    data.from_pydata(corners, [], sides)
    data.materials.append(material)
    thing = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def _paint(name: str, color: Sequence[float], roughness: float = 1.0) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    tree = node_tree(material)
    shader, output = tree.nodes.new("ShaderNodeBsdfPrincipled"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    shader.distribution = "GGX"
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value = roughness
    return material


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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("room", choices=ROOMS)
    parser.add_argument("--out", type=Path, required=True, help="folder of the capture")
    parser.add_argument("--resolution", default="240x180", help="of the photos")
    parser.add_argument("--samples", type=int, default=64, help="samples per pixel before denoising")
    parser.add_argument("--blend", type=Path, help="keep the scene there")
    args = parser.parse_args()
    width, height = map(int, args.resolution.split("x"))
    with tempfile.TemporaryDirectory() as folder:
        blend = args.blend or Path(folder) / f"{args.room}.blend"
        build(ROOMS[args.room], blend)
        render = replace(TRUTH_RENDER, samples=args.samples)
        config = SynthConfig(resolution=(width, height), compact=True, render=render)
        synth(blend, args.out, config, Progress(console(), STAGE_WEIGHTS))


if __name__ == "__main__":
    main()
