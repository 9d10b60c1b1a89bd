"""Lights and objects of a job file, parsed: JSON values in, the records of :mod:`iris_addon.edits.scene_edit` out.

Values are checked one by one, and every error names the key that is wrong. Lights are area, point, spot and sun lights,
HDRI panoramas and emissive meshes, which may turn about the room's up axis; objects are simple shapes and files.
docs/relighting.md lists their keys.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.untrusted import finite
from ..model.capture import Camera
from ..model.corrections import rotation
from .scene_edit import (
    Light,
    Material,
    ObjectFile,
    Panorama,
    Placement,
    PointLight,
    Primitive,
    Quad,
    Shape,
    Snap,
    Sphere,
    SpotLight,
    SunLight,
    Vector,
)

FloatArray = NDArray[np.float64]
Json = Mapping[str, Any]
Choice = TypeVar("Choice")

LIGHT_KINDS = ("area", "point", "spot", "sun", "hdri", "mesh")
MATERIAL_KEYS = {"base_color", "roughness", "metallic", "specular", "emission"}
PLACEMENT_KEYS = {"location", "rotation", "scale", "height", "snap", "pixel", "turntable"}
LARGEST = 1e12
"""Largest magnitude of a number in a job: Blender multiplies several of them in single precision."""
SHORTEST = 1e-12
"""Least length of a direction."""
MAX_WHOLE = 1_000_000
"""Largest count of views or frames."""
SHAPES: tuple[Shape, ...] = get_args(Shape)
SNAPS: tuple[Snap, ...] = get_args(Snap)


# ---- Values ---------------------------------------------------------------------------------------------------------


def json_map(value: Any, where: str) -> Json:
    """``value`` if it is a JSON object; raises BadInput."""
    if not isinstance(value, Mapping):
        raise BadInput(f"'{where}' is {type(value).__name__}", "make it a JSON object in braces")
    return value


def json_list(value: Any, where: str) -> Sequence[Any]:
    """``value`` if it is a JSON list; raises BadInput."""
    if not isinstance(value, list | tuple):
        raise BadInput(f"'{where}' is {type(value).__name__}", "make it a JSON list in brackets")
    return value


def number(value: Any, where: str, *, above_zero: bool = False, at_most: float = np.inf) -> float:
    """``value`` as a finite number from 0 (or above it) to ``at_most``; raises BadInput."""
    found = finite(value, largest=LARGEST)
    if found is None or not 0 <= found <= at_most or (above_zero and found == 0):
        upper = "" if np.isinf(at_most) else f" to {at_most:g}"
        raise BadInput(
            f"'{where}' is {value!r}", f"give a number {'above 0' if above_zero else 'from 0'}{upper or ' up'}"
        )
    return float(found)


def whole(value: Any, where: str) -> int:
    """``value`` as a whole number from 0 up to a million; raises BadInput."""
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= MAX_WHOLE:
        raise BadInput(f"'{where}' is {value!r}", f"give a whole number from 0 to {MAX_WHOLE}")
    return value


def flag(value: Any, where: str) -> bool:
    """``value`` if it is true or false; raises BadInput."""
    if not isinstance(value, bool):
        raise BadInput(f"'{where}' is {value!r}", "give true or false")
    return value


def one_of(value: Any, choices: Sequence[Choice], where: str) -> Choice:
    """``value`` if it is one of ``choices``; raises BadInput."""
    if value not in choices:
        raise BadInput(f"'{where}' is {value!r}", f"use one of {', '.join(map(str, choices))}")
    return value


def array(value: Any, shape: tuple[int | None, ...], where: str) -> NDArray[np.float64]:
    """``value`` as finite float64 of ``shape`` (None: any length); raises BadInput."""
    values = finite(value, shape, LARGEST)
    if values is None:
        form = " x ".join("n" if side is None else str(side) for side in shape)
        raise BadInput(f"'{where}' is no list of {form} finite numbers", "correct it in the JSON file")
    return values


def vector(value: Any, where: str) -> tuple[float, float, float]:
    """``value`` as three finite numbers; raises BadInput."""
    x, y, z = array(value, (3,), where).tolist()
    return x, y, z


def color(value: Any, where: str) -> NDArray[np.float64]:
    """``value`` as (3,) numbers from 0 up, one number standing for three equal ones; raises BadInput."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        value = [value] * 3
    values = array(value, (3,), where)
    if values.min() < 0:
        raise BadInput(f"'{where}' is {values.tolist()}", "give numbers from 0 up")
    return values


def direction(value: Any, where: str) -> NDArray[np.float64]:
    """``value`` as a (3,) unit vector; raises BadInput."""
    values = array(value, (3,), where)
    length = float(np.linalg.norm(values))
    if length < SHORTEST:
        raise BadInput(f"'{where}' is {values.tolist()}", f"give a direction longer than {SHORTEST:g}")
    return values / length


def file_path(value: Any, folder: Path | None, where: str) -> Path:
    """``value`` as a path, relative ones below ``folder``; raises BadInput."""
    if not isinstance(value, str):
        raise BadInput(f"'{where}' is {value!r}", "give a path")
    try:
        path = (folder or Path()) / Path(value).expanduser()
        path.lstat()
    except FileNotFoundError:
        pass  # told where it is read
    except (OSError, ValueError, RuntimeError) as error:  # an over-long name, a NUL byte, the home of nobody
        raise BadInput(f"'{where}' is {value[:80]!r}, which is not a usable path", "correct the path") from error
    return path


def known_keys(value: Json, known: set[str], where: str) -> None:
    """Raise BadInput if ``value`` has other keys than ``known``: a misspelt key must not be ignored."""
    unknown = sorted(set(value) - known)
    if unknown:
        raise BadInput(f"'{where}' has the unknown key '{unknown[0]}'", f"known keys: {', '.join(sorted(known))}")


# ---- Objects --------------------------------------------------------------------------------------------------------


def read_object(
    thing: Any, where: str, folder: Path | None, camera: Camera | None = None, time: float = 0.0
) -> Sphere | Primitive | ObjectFile:
    """One entry of a list of objects.

    Args:
        folder: what relative paths are relative to.
        camera: the view that ``pixel`` refers to, if there is one.
        time: of an animation, 0 ... 1.

    Raises:
        BadInput: a key is missing or unknown, or its value is not valid.
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
    """The placement of ``thing``; a pixel becomes the line of sight through it."""
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
        raise BadInput(f"'{where}.size' is {sides.tolist()}", "give meters above 0")
    return vector(sides, f"{where}.size")


# ---- Lights ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Turn:
    """A rotation (3, 3) about ``center`` (3,), metres."""

    center: FloatArray
    rotation: FloatArray

    def point(self, at: FloatArray) -> FloatArray:
        """Positions (..., 3) after the turn."""
        return (at - self.center) @ self.rotation.T + self.center

    def vector(self, towards: FloatArray) -> FloatArray:
        """A direction (3,) after the turn."""
        return self.rotation @ towards


@dataclass(frozen=True)
class NewLights:
    """Lights, emissive objects and panoramas that a list of lights adds to the room."""

    lights: tuple[Light, ...] = ()
    objects: tuple[Primitive | ObjectFile, ...] = ()
    panoramas: tuple[Panorama, ...] = ()


def read_lights(
    lights: Any, where: str, *, folder: Path | None = None, up: tuple[float, ...] = (0, 0, 1), time: float = 0.0
) -> NewLights:
    """The lights of a list ``lights``; each has a ``type``, an area light where none is given.

    Args:
        folder: what relative paths are relative to.
        up: unit up vector of the capture.
        time: of an animation, 0 ... 1.

    Raises:
        BadInput: a key is missing or unknown, or its value is not valid.
    """
    found: list[Light] = []
    objects: list[Primitive | ObjectFile] = []
    panoramas: list[Panorama] = []
    for k, light in enumerate(json_list(lights, where)):
        here = f"{where}[{k}]"
        light = json_map(light, here)
        kind = one_of(light.get("type", "area"), LIGHT_KINDS, f"{here}.type")
        turns, center = _turntable(light.get("turntable"), f"{here}.turntable")
        turn = Turn(center, rotation(np.asarray(up, float) * 2 * np.pi * turns * time))
        if kind == "mesh":
            objects.append(_emissive_mesh(light, here, folder, time))
        elif kind == "hdri":
            known_keys(light, {"type", "file", "scale", "rotation", "turntable"}, here)
            angle = float(array(light.get("rotation", 0.0), (), f"{here}.rotation"))
            path = file_path(light.get("file"), folder, f"{here}.file")
            scale = number(light.get("scale", 1.0), f"{here}.scale")
            panoramas.append(Panorama(path, scale, angle + 360.0 * turns * time))
        else:
            found.append({"area": _area, "point": _point, "spot": _spot, "sun": _sun}[kind](light, here, turn))
    return NewLights(tuple(found), tuple(objects), tuple(panoramas))


def _turntable(turntable: Any, where: str) -> tuple[float, FloatArray]:
    """Turns over the whole animation, and (3,) their centre."""
    if turntable is None:
        return 0.0, np.zeros(3)
    turntable = json_map(turntable, where)
    known_keys(turntable, {"turns", "center"}, where)
    turns = float(array(turntable.get("turns", 1.0), (), f"{where}.turns"))
    return turns, array(turntable.get("center", [0, 0, 0]), (3,), f"{where}.center")


def _area(light: Json, where: str, turn: Turn) -> Quad:
    radiance = color(light.get("radiance"), f"{where}.radiance")
    if "corners" in light:
        normal = direction(light.get("normal"), f"{where}.normal")
        corners = array(light["corners"], (4, 3), f"{where}.corners")
    else:
        known_keys(light, {"type", "center", "direction", "size", "radiance", "turntable"}, where)
        normal = direction(light.get("direction"), f"{where}.direction")
        corners = _rectangle(light, normal, where)
    return Quad(turn.point(corners), turn.vector(normal), radiance)


def _rectangle(light: Json, normal: FloatArray, where: str) -> FloatArray:
    width, height = array(light.get("size", [0.5, 0.5]), (2,), f"{where}.size")
    if min(width, height) <= 0:
        raise BadInput(f"'{where}.size' is {[width, height]}", "give meters above 0")
    # Any two sides perpendicular to the normal are right; the axis least along it keeps them level where possible.
    right = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
    right /= np.linalg.norm(right)
    above = np.cross(normal, right)
    center = array(light.get("center"), (3,), f"{where}.center")
    return np.array(
        [center + a * width / 2 * right + b * height / 2 * above for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )


def _point(light: Json, where: str, turn: Turn) -> PointLight:
    known_keys(light, {"type", "position", "intensity", "radius", "turntable"}, where)
    return PointLight(
        turn.point(array(light.get("position"), (3,), f"{where}.position")),
        color(light.get("intensity"), f"{where}.intensity"),
        number(light.get("radius", 0.05), f"{where}.radius"),
    )


def _spot(light: Json, where: str, turn: Turn) -> SpotLight:
    known_keys(
        light,
        {"type", "position", "direction", "target", "intensity", "angle", "blend", "radius", "turntable"},
        where,
    )
    position = array(light.get("position"), (3,), f"{where}.position")
    if ("direction" in light) == ("target" in light):
        raise BadInput(f"'{where}' needs 'direction' or 'target'", "give one of the two")
    towards = light["direction"] if "direction" in light else array(light["target"], (3,), f"{where}.target") - position
    return SpotLight(
        position=turn.point(position),
        direction=turn.vector(direction(towards, f"{where}.direction")),
        intensity=color(light.get("intensity"), f"{where}.intensity"),
        angle=number(light.get("angle", 45.0), f"{where}.angle", above_zero=True, at_most=180),
        blend=number(light.get("blend", 0.15), f"{where}.blend", at_most=1),
        radius=number(light.get("radius", 0.02), f"{where}.radius"),
    )


def _sun(light: Json, where: str, turn: Turn) -> SunLight:
    known_keys(light, {"type", "direction", "irradiance", "angle", "turntable"}, where)
    return SunLight(
        turn.vector(direction(light.get("direction"), f"{where}.direction")),
        color(light.get("irradiance"), f"{where}.irradiance"),
        number(light.get("angle", 0.53), f"{where}.angle", at_most=180),
    )


def _emissive_mesh(light: Json, where: str, folder: Path | None, time: float) -> Primitive | ObjectFile:
    radiance = vector(color(light.get("radiance"), f"{where}.radiance"), f"{where}.radiance")
    thing = read_object({k: v for k, v in light.items() if k not in ("type", "radiance")}, where, folder, time=time)
    if isinstance(thing, Sphere):
        raise BadInput(f"'{where}' has 'center'", "give 'location' and 'radius'")
    # It reflects nothing, like the recovered lamps.
    return replace(
        thing,
        material=Material(base_color=(0.0, 0.0, 0.0), roughness=1.0, metallic=0.0, specular=0.0, emission=radiance),
    )
