"""A recovered lamp is a plain emissive material; switching, dimming and tinting it is turning two of its sockets."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import bpy

from .materials import LAMP_ID, RECOVERED

OFF_STRENGTH = "iris_strength"
"""Custom property: the strength of a lamp that is switched off."""


def lamp_materials(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Material]:
    """The materials of lamps on ``objects``, by the id of their emitter."""
    used = {slot.material for thing in objects for slot in thing.material_slots if slot.material is not None}
    lamps = [material for material in used if LAMP_ID in material]
    return sorted(lamps, key=lambda material: (material[LAMP_ID], material.name))


def is_plain(material: bpy.types.Material | None) -> bool:
    """Whether it is as it was made, so that it can be turned here."""
    return _shader(material) is not None


def is_on(material: bpy.types.Material | None) -> bool:
    """Whether it shines."""
    return material is not None and OFF_STRENGTH not in material


def switch(material: bpy.types.Material | None, on: bool) -> None:
    """Let it shine with the strength it had, or not at all."""
    shader = _shader(material)
    if material is None or shader is None or on == is_on(material):
        return
    socket = shader.inputs["Emission Strength"]
    if on:
        socket.default_value = material[OFF_STRENGTH]
        del material[OFF_STRENGTH]
    else:
        material[OFF_STRENGTH] = socket.default_value
        socket.default_value = 0.0


def strength(material: bpy.types.Material | None) -> float:
    """Radiance of the brightest channel, also of a lamp that is off."""
    shader = _shader(material)
    if material is None or shader is None:
        return 0.0
    return float(material.get(OFF_STRENGTH, shader.inputs["Emission Strength"].default_value))


def set_strength(material: bpy.types.Material | None, value: float) -> None:
    """Set the radiance of the brightest channel; a lamp that is off stays off."""
    shader = _shader(material)
    if material is None or shader is None:
        return
    if OFF_STRENGTH in material:
        material[OFF_STRENGTH] = value
    else:
        shader.inputs["Emission Strength"].default_value = value


def color(material: bpy.types.Material | None) -> tuple[float, float, float]:
    """Linear colour of its light."""
    shader = _shader(material)
    if material is None or shader is None:
        return (0.0, 0.0, 0.0)
    red, green, blue, _ = shader.inputs["Emission Color"].default_value
    return (red, green, blue)


def set_color(material: bpy.types.Material | None, value: Sequence[float]) -> None:
    """Set the linear colour of its light."""
    shader = _shader(material)
    if shader is not None:
        shader.inputs["Emission Color"].default_value = (*value, 1.0)


@contextmanager
def as_recovered(materials: Iterable[bpy.types.Material]) -> Iterator[None]:
    """Lamps shine inside as they did when they were made; those that the artist has built anew stay as they are."""
    before = []
    for material in materials:
        shader = _shader(material)
        if shader is None or RECOVERED not in material:
            continue
        tint, level = shader.inputs["Emission Color"], shader.inputs["Emission Strength"]
        before.append((tint, tuple(tint.default_value), level, level.default_value))
        radiance = [float(value) for value in material[RECOVERED]]
        level.default_value = max(radiance)
        tint.default_value = (*(value / max(radiance) for value in radiance), 1.0)
    try:
        yield
    finally:
        for tint, color_before, level, strength_before in before:
            tint.default_value, level.default_value = color_before, strength_before


def _shader(material: bpy.types.Material | None) -> bpy.types.Node | None:
    """The Principled BSDF; None without a material, and where the artist has built the lamp anew."""
    nodes = material.node_tree.nodes if material is not None and material.node_tree is not None else ()
    return next((node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"), None)
