"""Looks: the recovered lamps, the sun and the light from outside, switched and dimmed together."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import bpy
import numpy as np
from mathutils import Quaternion
from numpy.typing import NDArray

from ...results.result import Result
from ..scene_out.backdrop import is_backdrop
from ..scene_out.lights import (
    is_on,
    is_recovered_sun,
    lamp_materials,
    reset,
    set_lamp,
    set_sun,
    switch,
)
from ..scene_out.materials import LAMP_ID
from ..scene_out.world import outside_light, set_gray, shines, sky_strength
from .applied_states import TINY, show_state, sky_level
from .saved_looks import SavedLook, look_of, show_look


class Look(NamedTuple):
    """``lamps`` and ``outside``, sun and sky, are shares of what was recovered.

    Where ``overcast`` the sun is off and the sky gray. Its luminance stays: clouds take the sun and spread its light,
    and outdoors the light of the sky alone, blue or overcast, is of one order (10 to 20 klx by day), so that what
    enters a room without sun becomes colorless before it becomes more or less.
    """

    label: str
    tooltip: str
    lamps: bool
    outside: float
    overcast: bool = False


LOOKS = {
    "PHOTOGRAPHED": Look("As Photographed", "All lamps and the light from outside as they were recovered", True, 1.0),
    "LAMPS": Look("Lamps Only", "The lamps, without any light from outside", True, 0.0),
    "EVENING": Look("Evening", "The lamps, with a twentieth of the light from outside", True, 0.05),
    "DAY": Look("Daylight", "The light from outside, without the lamps", False, 1.0),
    "OVERCAST": Look("Overcast", "A gray sky as bright as the recovered one, without sun and lamps", False, 1.0, True),
    "BLACKOUT": Look("Blackout", "Neither lamps nor light from outside, for lights of your own", False, 0.0),
}


def set_look(scene: bpy.types.Scene, key: str) -> None:
    """Give ``scene`` a look of :data:`LOOKS`; lamps that the artist has rebuilt stay as they are."""
    look = LOOKS[key]
    for material in lamp_materials(scene.objects):
        switch(material, True)
        reset(material)
        switch(material, look.lamps)
    level = sky_strength(scene.world)
    if level is not None:
        level.default_value = look.outside
    set_gray(scene.world, look.overcast)
    for thing in filter(is_recovered_sun, scene.objects):
        set_sun(thing, 0.0 if look.overcast else look.outside)
    show_state(scene, None)


def has_outside(scene: bpy.types.Scene) -> bool:
    """Whether there is light from outside to be dimmed, the sun's and the backdrop's included; also taken for granted
    where the artist has rebuilt the world."""
    if outside_light(scene.world) is None or shines(scene.world):
        return True
    return any(is_recovered_sun(thing) or is_backdrop(thing) for thing in scene.objects)


def offered_looks(scene: bpy.types.Scene) -> dict[str, Look]:
    """The looks that differ from each other in the room of ``scene``."""
    outside, lamps = has_outside(scene), bool(lamp_materials(scene.objects))
    sky = shines(scene.world)
    return {
        key: look
        for key, look in LOOKS.items()
        if (sky or not look.overcast)
        and (outside or look.outside == look.lamps)
        and (lamps or look.overcast or look.lamps == bool(look.outside))
    }


def solo(scene: bpy.types.Scene, lamp: bpy.types.Material) -> None:
    """Switch all other lamps of ``scene`` off; if they are off already, all on."""
    lamps = lamp_materials(scene.objects)
    alone = is_solo(scene, lamp)
    for material in lamps:
        switch(material, alone or material == lamp)


def is_solo(scene: bpy.types.Scene, lamp: bpy.types.Material) -> bool:
    """Whether ``lamp`` is the only lamp that is on."""
    return [material for material in lamp_materials(scene.objects) if is_on(material)] == [lamp]


# ---- looks of the artist's own -------------------------------------------------------------------------------------

OWN_LOOKS, STATE_LOOKS = "iris_own_looks", "iris_looks"
"""Custom properties of a scene: the artist's looks by name, JSON text of :mod:`.saved_looks`; and those of the light
states of the photos, which go with the result. The latter have by name "lamps", by id whether each shines, its
strength and colour; "outside", the strength of the light from outside; "sun", whether it shines, energy, colour and
turn; "state", the light state."""


def own_looks(scene: bpy.types.Scene) -> list[str]:
    """Names of the looks of light states, and of the artist's own in the order in which they were saved."""
    return list(dict.fromkeys(name for kind in (STATE_LOOKS, OWN_LOOKS) for name in (scene.get(kind) or {}).keys()))  # noqa: SIM118 - Blender's


def kept_look_of(scene: bpy.types.Scene, name: str) -> tuple[SavedLook | None, Any]:
    """The look of :func:`own_looks` under ``name``: the artist's own, and that of a light state; None for what is
    not there."""
    saved = (scene.get(OWN_LOOKS) or {}).get(name)
    return None if saved is None else json.loads(saved), (scene.get(STATE_LOOKS) or {}).get(name)


def save_look(scene: bpy.types.Scene, name: str) -> SavedLook:
    """Keep how the lights of ``scene`` are set as a look of the artist's own, in place of one of that name."""
    look = look_of(scene)
    forget_look(scene, name)
    if OWN_LOOKS not in scene:
        scene[OWN_LOOKS] = {}
    scene[OWN_LOOKS][name] = json.dumps(look)
    return look


def set_own_look(scene: bpy.types.Scene, name: str) -> None:
    """Set the lights of ``scene`` as in a look of :func:`own_looks`; what the artist has rebuilt stays as it is."""
    saved, look = kept_look_of(scene, name)
    if saved is not None:
        show_look(scene, saved)
        return
    for material in lamp_materials(scene.objects):
        state = look["lamps"].get(str(material[LAMP_ID]))
        if state is None:
            continue
        on, level, red, green, blue = state
        set_lamp(material, (bool(on), level, (red, green, blue)))
    outside = sky_strength(scene.world)
    if outside is not None and "outside" in look:
        outside.default_value = look["outside"]
    set_gray(scene.world, False)
    for sun in filter(is_recovered_sun, scene.objects) if "sun" in look else ():
        on, sun.data.energy, *rest = look["sun"]
        sun.hide_render = sun.hide_viewport = not on
        sun.data.color = rest[:3]
        sun.matrix_basis = Quaternion(rest[3:]).to_matrix().to_4x4()
    show_state(scene, look.get("state") or None)


def keep_states(scene: bpy.types.Scene, result: Result) -> None:
    """Keep each light state that the room of ``result`` was photographed in as a look, by its name.

    The light from outside is dimmed to that of the state, and keeps the directions that it has in the first; a lamp
    that is off would have the radiance that it has where it is on.
    """
    for state in result.light_states:
        brightest = np.max([other.radiance for other in result.light_states], axis=0)
        lamps = {
            str(emitter.id): _kept(radiance, most)
            for emitter, radiance, most in zip(result.emitters, state.radiance, brightest, strict=True)
        }
        look: dict[str, Any] = {"lamps": lamps, "state": state.name}
        if result.outside is not None:
            look["outside"] = sky_level(state, result.outside)
        for thing in filter(is_recovered_sun, scene.objects):
            recovered = np.zeros(3) if state.sun is None else state.sun.irradiance
            energy = max(float(recovered.max()), TINY)
            turn = thing.matrix_basis.to_quaternion()
            look["sun"] = [float(state.sun is not None), energy, *(recovered / energy).tolist(), *turn]
        if STATE_LOOKS not in scene:
            scene[STATE_LOOKS] = {}
        scene[STATE_LOOKS][state.name] = look


def _kept(radiance: NDArray[np.floating], otherwise: NDArray[np.floating]) -> list[float]:
    """A lamp of a look: whether it shines, and strength and colour of its ``radiance`` (3,), or of ``otherwise``."""
    on = bool(radiance.max() > 0)
    shown = radiance if on else otherwise
    level = max(float(shown.max()), TINY)
    return [float(on), level, *(shown / level).tolist()]


def forget_look(scene: bpy.types.Scene, name: str) -> None:
    """Remove a look of :func:`own_looks`, if there is one of that name."""
    for kind in (STATE_LOOKS, OWN_LOOKS):
        if name in (scene.get(kind) or {}):
            del scene[kind][name]


def forget_states(scene: bpy.types.Scene) -> None:
    """Remove the looks of light states: those of another result are others. The artist's own stay."""
    scene.pop(STATE_LOOKS, None)
