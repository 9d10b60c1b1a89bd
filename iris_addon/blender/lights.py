"""Lights an edit adds: one-sided quads as emissive meshes, the others as Blender's own lights.

Blender gives point and spot lights the watts that would leave to all sides, whatever their cone: energy E is the
radiant intensity E / 4π. A sun's energy is its irradiance.
"""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from ..result.edits import Light, Quad, SpotLight, SunLight
from .materials import black_material, one_sided_lamp_material

ENERGY_PER_INTENSITY = 4 * np.pi


def add_light(light: Light, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """An object named ``name`` that shines as ``light`` says."""
    if isinstance(light, Quad):
        return add_quad(light, name, collection)
    if isinstance(light, SunLight):
        data = _light_data(name, "SUN", light.irradiance, 1.0)
        data.angle = np.radians(light.angle)
        matrix = _aimed(light.direction)
    elif isinstance(light, SpotLight):
        data = _light_data(name, "SPOT", light.intensity, ENERGY_PER_INTENSITY)
        data.spot_size, data.spot_blend, data.shadow_soft_size = np.radians(light.angle), light.blend, light.radius
        matrix = Matrix.Translation(tuple(light.position)) @ _aimed(light.direction)
    else:
        data = _light_data(name, "POINT", light.intensity, ENERGY_PER_INTENSITY)
        data.shadow_soft_size = light.radius
        matrix = Matrix.Translation(tuple(light.position))
    thing = bpy.data.objects.new(name, data)
    thing.matrix_world = matrix
    collection.objects.link(thing)
    return thing


def add_quad(quad: Quad, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """A one-sided rectangular light; its winding is made to agree with ``quad.normal``."""
    corners = np.asarray(quad.corners, float)
    if np.cross(corners[1] - corners[0], corners[2] - corners[0]) @ quad.normal < 0:
        corners = corners[::-1]
    data = bpy.data.meshes.new(name)
    data.from_pydata(corners.tolist(), [], [(0, 1, 2, 3)])
    if np.max(quad.radiance) > 0:
        data.materials.append(one_sided_lamp_material(name, quad.radiance))
    else:
        data.materials.append(black_material(name))
    light = bpy.data.objects.new(name, data)
    collection.objects.link(light)
    return light


def _light_data(name: str, kind: str, power: NDArray[np.floating], factor: float) -> bpy.types.Light:
    """Blender's light whose colour times energy is ``power`` (3,) times ``factor``."""
    data = bpy.data.lights.new(name, kind)
    peak = float(np.max(power))
    data.energy = peak * factor
    data.color = tuple(np.asarray(power) / peak) if peak > 0 else (0.0, 0.0, 0.0)
    return data


def _aimed(direction: NDArray[np.floating]) -> Matrix:
    """Blender's lights shine along their -Z."""
    return Vector(tuple(direction)).to_track_quat("-Z", "Y").to_matrix().to_4x4()
