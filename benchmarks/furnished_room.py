"""The furnished room that small captures with a question of their own are rendered from, out of boxes, by Cycles.

A room of :mod:`benchmarks.sunlit_room`, :mod:`benchmarks.mirror_room` or :mod:`benchmarks.pattern_room` is the
furniture and the cameras of this module with walls, light and a peculiarity of its own.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path

import bpy
from mathutils import Vector

from iris_addon.base.files import write_json
from iris_addon.base.progress import Progress, console
from iris_addon.blender.synth.run import STAGE_WEIGHTS, TRUTH_RENDER, SynthConfig, synth
from iris_addon.blender.version import node_tree

WIDTH, DEPTH, HEIGHT = 4.2, 3.6, 2.6
"""Inside of the room along x, y and z, metres."""
WALL = 0.2
"""Thickness of walls, floor and ceiling, metres."""
FIELD_OF_VIEW = math.radians(72)

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


def wall_in() -> None:
    """Floor, ceiling and four walls without an opening."""
    wall, trim = paint("wall", (0.72, 0.68, 0.6)), paint("white", (0.8, 0.8, 0.78))
    box("floor", (-WALL, -WALL, -WALL), (WIDTH + WALL, DEPTH + WALL, 0), paint("floor", (0.42, 0.27, 0.16)))
    box("ceiling", (-WALL, -WALL, HEIGHT), (WIDTH + WALL, DEPTH + WALL, HEIGHT + WALL), trim)
    box("wall west", (-WALL, -WALL, 0), (0, DEPTH + WALL, HEIGHT), wall)
    box("wall east", (WIDTH, -WALL, 0), (WIDTH + WALL, DEPTH + WALL, HEIGHT), wall)
    box("wall north", (0, DEPTH, 0), (WIDTH, DEPTH + WALL, HEIGHT), paint("feature wall", (0.25, 0.4, 0.42)))
    box("wall south", (0, -WALL, 0), (WIDTH, 0, HEIGHT), wall)


def furnish() -> None:
    """The furniture, without walls."""
    oak, white = paint("oak", (0.45, 0.3, 0.17), 0.35), paint("chair", (0.78, 0.78, 0.76))
    red, blue, black = (
        paint("rug", (0.42, 0.1, 0.08)),
        paint("cloth", (0.14, 0.2, 0.42)),
        paint("frame", (0.04,) * 3),
    )
    box("table top", (1.5, 1.9, 0.70), (2.8, 2.7, 0.74), oak)
    for k, (x, y) in enumerate(((1.55, 1.95), (2.75, 1.95), (1.55, 2.65), (2.75, 2.65))):
        box(f"table leg {k}", (x - 0.03, y - 0.03, 0), (x + 0.03, y + 0.03, 0.70), oak)
    for k, (x, y) in enumerate(((1.0, 2.1), (3.05, 2.3))):
        box(f"seat {k}", (x - 0.2, y - 0.2, 0.42), (x + 0.2, y + 0.2, 0.46), white)
        box(f"back {k}", (x - 0.2, y + 0.17, 0.46), (x + 0.2, y + 0.2, 0.95), white)
        for n, (dx, dy) in enumerate(((-0.18, -0.18), (0.18, -0.18), (-0.18, 0.18), (0.18, 0.18))):
            box(f"chair leg {k} {n}", (x + dx - 0.02, y + dy - 0.02, 0), (x + dx + 0.02, y + dy + 0.02, 0.42), white)
    box("rug", (1.2, 0.7, 0), (3.0, 1.6, 0.012), red)
    box("cupboard", (0.05, 2.5, 0), (0.45, 3.5, 1.1), paint("cupboard", (0.35, 0.42, 0.3), 0.5))
    box("sofa seat", (3.3, 0.9, 0), (4.15, 2.0, 0.42), blue)
    box("sofa back", (3.98, 0.9, 0.42), (4.15, 2.0, 0.85), blue)
    box("picture", (1.6, DEPTH - 0.03, 1.3), (2.5, DEPTH, 1.9), black)
    box("print", (1.66, DEPTH - 0.035, 1.36), (2.44, DEPTH - 0.03, 1.84), paint("print", (0.6, 0.45, 0.2)))
    box("vase", (2.0, 2.2, 0.74), (2.12, 2.32, 1.02), paint("vase", (0.15, 0.35, 0.2), 0.3))


def box(name: str, low: Sequence[float], high: Sequence[float], material: bpy.types.Material) -> bpy.types.Object:
    """A box between two corners, metres, in the scene."""
    corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    data = bpy.data.meshes.new(name)
    data.from_pydata(corners, [], sides)
    return place(data, material)


def square(name: str, corners: Sequence[Sequence[float]]) -> bpy.types.Mesh:
    """A mesh of one face with four ``corners``, metres."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(corners, [], [(0, 1, 2, 3)])
    return data


def place(data: bpy.types.Mesh, material: bpy.types.Material) -> bpy.types.Object:
    """An object of ``data``, all of one material, in the scene."""
    data.materials.append(material)
    thing = bpy.data.objects.new(data.name, data)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def paint(name: str, color: Sequence[float], roughness: float = 1.0, metallic: float = 0.0) -> bpy.types.Material:
    """Principled paint or metal, of a scene-linear colour."""
    material = bpy.data.materials.new(name)
    tree = node_tree(material)
    shader, output = tree.nodes.new("ShaderNodeBsdfPrincipled"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    shader.distribution = "GGX"
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Metallic"].default_value = metallic
    return material


def glow(name: str, color: Sequence[float], strength: float) -> bpy.types.Material:
    """A lamp of radiance ``color`` times ``strength``."""
    material = bpy.data.materials.new(name)
    tree = node_tree(material)
    light, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    light.inputs["Color"].default_value = (*color, 1)
    light.inputs["Strength"].default_value = strength
    tree.links.new(light.outputs[0], output.inputs["Surface"])
    return material


def build(walls_and_light: Callable[[], None], blend: Path, photographed: Callable[[], None] | None = None) -> None:
    """Model a furnished room in an empty file, with its cameras, and save it as ``blend``.

    Args:
        photographed: tells the cameras how their photos are taken, where they differ.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.unit_settings.system = "METRIC"
    walls_and_light()
    furnish()
    for prefix, views in (("photo", TRAIN), ("val", VALIDATION)):
        for k, (position, target) in enumerate(views):
            data = bpy.data.cameras.new(f"{prefix} {k:02d}")
            data.sensor_fit, data.angle, data.clip_start = "HORIZONTAL", FIELD_OF_VIEW, 0.01
            camera = bpy.data.objects.new(data.name, data)
            bpy.context.scene.collection.objects.link(camera)
            camera.location = position
            camera.rotation_euler = (Vector(target) - Vector(position)).to_track_quat("-Z", "Y").to_euler()
    if photographed is not None:
        photographed()
    bpy.context.scene.camera = bpy.data.objects["photo 00"]
    bpy.ops.wm.save_as_mainfile(filepath=str(blend.absolute()), compress=True)


def render_room(
    names: Collection[str],
    walls_and_light: Callable[[str], None],
    description: str | None,
    photographed: Callable[[str], None] | None = None,
    hidden_states: Collection[str] = (),
) -> None:
    """Command line of a module that renders one of the rooms ``names`` as a capture.

    Args:
        photographed: tells the cameras how their photos are taken, where they differ.
        hidden_states: rooms whose capture does not say which light state its photos were taken in.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("room", choices=names)
    parser.add_argument("--out", type=Path, required=True, help="folder of the capture")
    parser.add_argument("--resolution", default="240x180", help="of the photos")
    parser.add_argument("--samples", type=int, default=64, help="samples per pixel before denoising")
    parser.add_argument("--blend", type=Path, help="keep the scene there")
    args = parser.parse_args()
    width, height = map(int, args.resolution.split("x"))
    with tempfile.TemporaryDirectory() as folder:
        blend = args.blend or Path(folder) / f"{args.room}.blend"
        build(lambda: walls_and_light(args.room), blend, photographed and (lambda: photographed(args.room)))
        config = SynthConfig(
            resolution=(width, height), compact=True, render=replace(TRUTH_RENDER, samples=args.samples)
        )
        synth(blend, args.out, config, Progress(console(), STAGE_WEIGHTS))
    if args.room in hidden_states:
        for split in ("train", "val"):
            _forget_states(args.out / split / "transforms.json")


def _forget_states(transforms: Path) -> None:
    """Remove the light states of all frames of ``transforms``."""
    content = json.loads(transforms.read_text(encoding="utf-8"))
    for frame in content["frames"]:
        frame.pop("light_state", None)
    write_json(transforms, content)
