"""Lights of a relighting job: area, point, spot, sun, HDRI panorama, emissive mesh; turned about the room's up axis."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..model.corrections import rotation
from .objects import read_object
from .scene_edit import Light, Material, ObjectFile, Panorama, PointLight, Primitive, Quad, Sphere, SpotLight, SunLight
from .values import Json, array, color, direction, file_path, json_list, json_map, known_keys, number, one_of, vector

FloatArray = NDArray[np.float64]

KINDS = ("area", "point", "spot", "sun", "hdri", "mesh")


@dataclass(frozen=True)
class Turn:
    """A rotation (3, 3) about ``center``."""

    center: FloatArray
    rotation: FloatArray

    def point(self, at: FloatArray) -> FloatArray:
        """Where (..., 3) positions go."""
        return (at - self.center) @ self.rotation.T + self.center

    def vector(self, towards: FloatArray) -> FloatArray:
        """Where a (3,) direction points then."""
        return self.rotation @ towards


@dataclass(frozen=True)
class NewLights:
    """What a list of lights adds to the room."""

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
        BadInput: a key is missing, unknown or has no sense.
    """
    found: list[Light] = []
    objects: list[Primitive | ObjectFile] = []
    panoramas: list[Panorama] = []
    for k, light in enumerate(json_list(lights, where)):
        here = f"{where}[{k}]"
        light = json_map(light, here)
        kind = one_of(light.get("type", "area"), KINDS, f"{here}.type")
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
    """Turns over the whole animation, and (3,) what it turns about."""
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
        raise BadInput(f"'{where}.size' is {[width, height]}", "give metres above 0")
    # Any two sides across the normal will do; the axis least along it keeps them level where that is possible.
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
    # Black but for its light, as the lamps of the room are.
    return replace(
        thing,
        material=Material(base_color=(0.0, 0.0, 0.0), roughness=1.0, metallic=0.0, specular=0.0, emission=radiance),
    )
