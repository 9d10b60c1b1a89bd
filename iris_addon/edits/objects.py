"""Objects of an insertion job: shapes and files, and where they stand."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import numpy as np

from ..base.errors import BadInput
from ..model.capture import Camera
from .scene_edit import Material, ObjectFile, Placement, Primitive, Shape, Snap, Sphere, Vector
from .values import Json, array, color, file_path, json_map, known_keys, number, one_of, vector

MATERIAL_KEYS = {"base_color", "roughness", "metallic", "specular", "emission"}
PLACEMENT_KEYS = {"location", "rotation", "scale", "height", "snap", "pixel", "turntable"}
SHAPES: tuple[Shape, ...] = get_args(Shape)
SNAPS: tuple[Snap, ...] = get_args(Snap)


def read_object(
    thing: Any, where: str, folder: Path | None, camera: Camera | None = None, time: float = 0.0
) -> Sphere | Primitive | ObjectFile:
    """One entry of a list of objects.

    Args:
        folder: what relative paths are relative to.
        camera: the view that ``pixel`` refers to, if there is one.
        time: of an animation, 0 ... 1.

    Raises:
        BadInput: a key is missing, unknown or has no sense.
    """
    thing = json_map(thing, where)
    if "file" in thing:
        known_keys(thing, {"file", "id", "material", *PLACEMENT_KEYS}, where)
        material = read_material(thing["material"], f"{where}.material") if "material" in thing else None
        path = file_path(thing["file"], folder, f"{where}.file")
        return ObjectFile(path, read_placement(thing, where, camera, time), material)
    shape = one_of(thing.get("shape", "sphere"), SHAPES, f"{where}.shape")
    if shape == "sphere" and "center" in thing:
        return _ball(thing, where)
    known_keys(thing, {"shape", "id", "size", "radius", *MATERIAL_KEYS, *PLACEMENT_KEYS}, where)
    placement = read_placement(thing, where, camera, time)
    return Primitive(shape, _size(thing, shape, where), placement, read_material(thing, where))


def read_material(thing: Json, where: str) -> Material:
    """The Principled values among the keys of ``thing``."""
    thing = json_map(thing, where)
    return Material(
        base_color=vector(color(thing.get("base_color", 0.8), f"{where}.base_color"), f"{where}.base_color"),
        roughness=number(thing.get("roughness", 0.5), f"{where}.roughness", at_most=1),
        metallic=number(thing.get("metallic", 0.0), f"{where}.metallic", at_most=1),
        specular=number(thing.get("specular", 0.5), f"{where}.specular"),
        emission=vector(color(thing.get("emission", 0.0), f"{where}.emission"), f"{where}.emission"),
    )


def read_placement(thing: Json, where: str, camera: Camera | None, time: float) -> Placement:
    """Where ``thing`` stands; a pixel becomes the line of sight through it."""
    if ("location" in thing) == ("pixel" in thing):
        raise BadInput(f"'{where}' has {'both' if 'pixel' in thing else 'neither'} 'location' and 'pixel'", "give one")
    scale = thing.get("scale", 1.0)
    scale = [number(scale, f"{where}.scale", above_zero=True)] * 3 if not isinstance(scale, list) else scale
    rotation = np.array(vector(thing.get("rotation", [0, 0, 0]), f"{where}.rotation"))
    if "turntable" in thing:
        rotation[2] += 360.0 * _turns(thing["turntable"], f"{where}.turntable") * time
    height, ray = thing.get("height"), None
    if "pixel" in thing:
        ray = _line_of_sight(thing["pixel"], camera, f"{where}.pixel")
    return Placement(
        location=vector(thing.get("location", [0, 0, 0]), f"{where}.location"),
        scale=vector(scale, f"{where}.scale"),
        rotation=vector(rotation, f"{where}.rotation"),
        height=None if height is None else number(height, f"{where}.height", above_zero=True),
        snap=one_of(thing.get("snap", "none" if ray is None else "down"), SNAPS, f"{where}.snap"),
        ray=ray,
    )


def _turns(value: Any, where: str) -> float:
    value = json_map(value, where)
    known_keys(value, {"turns"}, where)
    return float(array(value.get("turns", 1.0), (), f"{where}.turns"))


def _line_of_sight(pixel: Any, camera: Camera | None, where: str) -> tuple[Vector, Vector]:
    i, j = array(pixel, (2,), where)
    if camera is None:
        raise BadInput(f"'{where}' needs a photo to point at", "give 'location' here")
    if not (0 <= i <= camera.width and 0 <= j <= camera.height):
        raise BadInput(f"'{where}' lies outside the photo of {camera.width}x{camera.height}", "give [column, row]")
    towards = camera.c2w[:3, :3] @ [(i - camera.cx) / camera.fx, -(j - camera.cy) / camera.fy, -1.0]
    return vector(camera.position, where), vector(towards / np.linalg.norm(towards), where)


def _ball(thing: Json, where: str) -> Sphere:
    return Sphere(
        center=array(thing.get("center"), (3,), f"{where}.center"),
        radius=number(thing.get("radius"), f"{where}.radius", above_zero=True),
        base_color=array(thing.get("base_color", [0.8, 0.8, 0.8]), (3,), f"{where}.base_color"),
        roughness=number(thing.get("roughness", 0.5), f"{where}.roughness"),
        metallic=number(thing.get("metallic", 0.0), f"{where}.metallic"),
        specular=number(thing.get("specular", 0.5), f"{where}.specular"),
    )


def _size(thing: Json, shape: str, where: str) -> Vector:
    if shape == "sphere" and "radius" in thing:
        diameter = 2 * number(thing["radius"], f"{where}.radius", above_zero=True)
        return diameter, diameter, diameter
    size = thing.get("size")
    if shape == "card" and isinstance(size, list | tuple) and len(size) == 2:
        size = [*size, 1.0]
    elif isinstance(size, int | float):
        size = [size] * 3
    sides = array(size, (3,), f"{where}.size")
    if sides.min() <= 0:
        raise BadInput(f"'{where}.size' is {sides.tolist()}", "give metres above 0")
    return vector(sides, f"{where}.size")
