"""Looks: the recovered lamps and the light from outside, switched and dimmed together."""

from __future__ import annotations

from typing import NamedTuple

import bpy

from ..scene_out.lights import is_on, lamp_materials, reset, switch


class Look(NamedTuple):
    """``lamps`` and ``outside`` are shares of what was recovered."""

    label: str
    tooltip: str
    lamps: bool
    outside: float


LOOKS = {
    "PHOTOGRAPHED": Look("As Photographed", "All lamps and the light from outside as they were recovered", True, 1.0),
    "LAMPS": Look("Lamps Only", "The lamps, without any light from outside", True, 0.0),
    "EVENING": Look("Evening", "The lamps, with a twentieth of the light from outside", True, 0.05),
    "DAY": Look("Daylight", "The light from outside, without the lamps", False, 1.0),
    "BLACKOUT": Look("Blackout", "Neither lamps nor light from outside, for lights of your own", False, 0.0),
}


def set_look(scene: bpy.types.Scene, key: str) -> None:
    """Give ``scene`` a look of :data:`LOOKS`; lamps that the artist has rebuilt stay as they are."""
    look = LOOKS[key]
    for material in lamp_materials(scene.objects):
        switch(material, True)
        reset(material)
        switch(material, look.lamps)
    background = outside_light(scene)
    if background is not None:
        background.inputs["Strength"].default_value = look.outside


def outside_light(scene: bpy.types.Scene) -> bpy.types.Node | None:
    """The node whose input Strength dims the light from outside; None where the artist has rebuilt the world."""
    nodes = scene.world.node_tree.nodes if scene.world is not None and scene.world.node_tree is not None else {}
    return nodes.get("Background")


def solo(scene: bpy.types.Scene, lamp: bpy.types.Material) -> None:
    """Switch all other lamps of ``scene`` off; if they are off already, all on."""
    lamps = lamp_materials(scene.objects)
    alone = is_solo(scene, lamp)
    for material in lamps:
        switch(material, alone or material == lamp)


def is_solo(scene: bpy.types.Scene, lamp: bpy.types.Material) -> bool:
    """Whether ``lamp`` is the only lamp that is on."""
    return [material for material in lamp_materials(scene.objects) if is_on(material)] == [lamp]
