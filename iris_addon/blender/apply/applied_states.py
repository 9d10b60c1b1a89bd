"""The light states of a room that is applied to a scene: lamps, sky and sun of each, kept on the scene.

The lights of the scene stand as one of the states has them: the first, until the look of another is chosen. What the
artist changes then is changed in every state: a lamp at half its strength stands at that strength, whatever the state.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

import bpy
import numpy as np
from mathutils import Quaternion
from numpy.typing import NDArray

from ...base.errors import BadInput
from ...model.recovered import LightState, OutsideLight, Sunlight
from ...model.response import LUMINANCE
from ...results.result import Result
from ..scene_out.lights import (
    RECOVERED_TURN,
    add_sun,
    emitted,
    is_on,
    is_plain,
    is_recovered_sun,
    lamp_materials,
    lamp_setting,
    recover_sun,
    reset,
    set_lamp,
    set_sun,
    switch,
)
from ..scene_out.materials import LAMP_ID, RECOVERED
from ..scene_out.world import is_gray, make_world, sky_strength

STATES, SHOWN, SURFACE, SKY = "iris_light_states", "iris_shown_state", "iris_surface", "iris_sky_"
"""Custom properties of a scene: its light states as JSON text, the name of that in which its lights stand (missing for
the first), the material of surfaces, and the world of each state by its number."""
TINY = 1e-9
"""Light that stands for none."""
SAME_LIGHT = 1e-3
"""Relative difference up to which a light stands as it was recovered: Blender keeps strengths as single floats."""


def keep_light_states(
    scene: bpy.types.Scene, result: Result, to_blender: NDArray[np.floating], surface: bpy.types.Material
) -> list[bpy.types.World]:
    """Keep the light states of ``result`` on ``scene``, whose world is that of the first; nothing where there is one.

    Args:
        to_blender: (3, 3) rotation from the axes of the capture to those of ``scene``.
        surface: the material of the room, which lamps that are off have.

    Returns:
        The worlds that were made.
    """
    if not result.light_states:
        return []
    skies = [scene.world, *(make_world(state.outside, 1.0, to_blender) for state in result.light_states[1:])]
    kept = {}
    for state, sky, number in zip(result.light_states, skies, range(len(skies)), strict=True):
        scene[f"{SKY}{number}"] = sky
        lamps = {emitter.id: own.tolist() for emitter, own in zip(result.emitters, state.radiance, strict=True)}
        kept[state.name] = {"lamps": lamps, "sky": sky_level(state, result.outside), "sun": None}
        if state.sun is not None:
            direction = to_blender @ state.sun.direction
            kept[state.name]["sun"] = {"direction": direction.tolist(), "irradiance": state.sun.irradiance.tolist()}
    scene[STATES], scene[SURFACE] = json.dumps(kept), surface
    return skies[1:]


def forget_light_states(scene: bpy.types.Scene) -> None:
    """Remove what :func:`keep_light_states` kept."""
    for name in [name for name in scene.keys() if name in (STATES, SHOWN, SURFACE) or name.startswith(SKY)]:  # noqa: SIM118 - Blender's
        del scene[name]


def sky_level(state: LightState, first: OutsideLight | None) -> float:
    """Strength at which the sky of the ``first`` state is as bright as that of ``state``; 1 where that has none."""
    if first is None:
        return 1.0
    if state.outside is None:
        return 0.0
    return float(state.outside.mean @ LUMINANCE / max(first.mean @ LUMINANCE, TINY))


def has_light_states(scene: bpy.types.Scene) -> bool:
    """Whether the room that is applied to ``scene`` was photographed in several light states."""
    return STATES in scene


def state_names(scene: bpy.types.Scene) -> list[str]:
    """Names of the light states that ``scene`` keeps."""
    return list(json.loads(scene.get(STATES, "{}")))


def light_state_of(camera: bpy.types.Object, scene: bpy.types.Scene) -> str:
    """The light state that ``camera`` names for its photo or plate; "" where the room of ``scene`` has one only."""
    return camera.data.iris_light_state.strip() if has_light_states(scene) else ""


def shown_state(scene: bpy.types.Scene) -> str | None:
    """The light state in which the lights of ``scene`` stand, but for what the artist changed; None for the first."""
    return scene.get(SHOWN)


def show_state(scene: bpy.types.Scene, name: str | None) -> None:
    """Remember that the lights of ``scene`` stand as the light state ``name`` has them, None being the first."""
    scene.pop(SHOWN, None)
    if name is not None:
        scene[SHOWN] = name


@contextmanager
def in_light_state(scene: bpy.types.Scene, name: str | None, *, everything: bool = False) -> Iterator[None]:
    """Inside, what was recovered is the light of the state ``name``, and lights that the artist has not changed shine
    so; with ``everything`` those that he has changed too. None leaves all as it is.

    Raises:
        BadInput: the lights of that state are not kept in ``scene``.
    """
    if name is None:
        yield
        return
    kept: dict[str, dict[str, Any]] = json.loads(scene.get(STATES, "{}"))
    if name not in kept:
        known = ", ".join(kept) or "none"
        what = f"the scene keeps no light state {name!r} of the room (it has: {known})"
        raise BadInput(what, "apply the result again", bpy.data.filepath or None)
    first, state = next(iter(kept.values())), kept[name]
    shown = kept.get(scene.get(SHOWN, ""), first)
    sky = scene[f"{SKY}{list(kept).index(name)}"]
    with ExitStack() as undo:
        for material in lamp_materials(scene.objects):
            was, own = (np.array(each["lamps"].get(str(material[LAMP_ID]), (0, 0, 0))) for each in (shown, state))
            undo.enter_context(_lamp_in_state(scene, material, was, own, everything=everything))
        # Where no sun shines in the first state there is none to be dimmed: another state's is dimmed with the sky.
        gone = first["sun"] is not None or _sky_is_changed(scene, shown["sky"])
        if everything or not gone or any(map(is_recovered_sun, scene.objects)):
            undo.enter_context(_sun_in_state(scene, shown["sun"], state["sun"], everything=everything))
        undo.enter_context(_sky_in_state(scene, sky, shown["sky"], state["sky"], everything=everything))
        yield


@contextmanager
def _lamp_in_state(
    scene: bpy.types.Scene,
    material: bpy.types.Material,
    was: NDArray[np.floating],
    own: NDArray[np.floating],
    *,
    everything: bool,
) -> Iterator[None]:
    """Inside, the radiance (3,) that was recovered of a lamp is ``own`` in place of ``was``; off, it is a surface."""
    recovered, before = list(material[RECOVERED]), lamp_setting(material)
    # The look of a state switches off what is dark in it; else the artist has, also what is dark anyway.
    put_out = not is_on(material) and (bool(was.any()) or SHOWN not in scene)
    follows = everything or (not put_out and np.allclose(emitted(material), was, rtol=SAME_LIGHT, atol=TINY))
    material[RECOVERED] = own.tolist()
    slots: list[bpy.types.MaterialSlot] = []
    if follows:
        switch(material, True)
        reset(material)
        if not own.any() and is_plain(material):
            slots = [slot for thing in scene.objects for slot in thing.material_slots if slot.material == material]
    for slot in slots:
        slot.material = scene[SURFACE]
    try:
        yield
    finally:
        for slot in slots:
            slot.material = material
        material[RECOVERED] = recovered
        if follows:
            set_lamp(material, before)


@contextmanager
def _sun_in_state(
    scene: bpy.types.Scene, was: Mapping[str, Any] | None, own: Mapping[str, Any] | None, *, everything: bool
) -> Iterator[None]:
    """Inside, the sun that was recovered is ``own`` in place of ``was``, as the scene keeps them."""
    sun = None if own is None else Sunlight(np.array(own["direction"]), np.array(own["irradiance"]))
    thing = next(filter(is_recovered_sun, scene.objects), None)
    if thing is None:
        added = add_sun(sun, scene.collection)
        try:
            yield
        finally:
            if added is not None:
                bpy.data.lights.remove(added.data)  # and its object
        return
    recovered, turn = list(thing[RECOVERED]), list(thing[RECOVERED_TURN])
    before = thing.hide_render, thing.hide_viewport, thing.data.energy, tuple(thing.data.color)
    matrix = thing.matrix_basis.copy()
    shining = np.zeros(3) if thing.hide_render else thing.data.energy * np.array(thing.data.color)
    unturned = abs(Quaternion(turn).dot(thing.matrix_basis.to_quaternion())) > 1 - SAME_LIGHT**2
    irradiance = np.zeros(3) if was is None else np.array(was["irradiance"])
    follows = everything or (unturned and np.allclose(shining, irradiance, rtol=SAME_LIGHT, atol=2 * TINY))
    recover_sun(thing, sun)
    if follows:
        thing.matrix_basis = Quaternion(thing[RECOVERED_TURN]).to_matrix().to_4x4()
        set_sun(thing, float(sun is not None))
    try:
        yield
    finally:
        thing[RECOVERED], thing[RECOVERED_TURN] = recovered, turn
        thing.hide_render, thing.hide_viewport, thing.data.energy, thing.data.color = before
        thing.matrix_basis = matrix


def _sky_is_changed(scene: bpy.types.Scene, was: float) -> bool:
    """Whether the artist has set the light from outside to another strength than ``was``, or to gray."""
    strength = sky_strength(scene[f"{SKY}0"])
    if is_gray(scene[f"{SKY}0"]):
        return True
    return strength is not None and abs(strength.default_value - was) > SAME_LIGHT * max(was, TINY)


@contextmanager
def _sky_in_state(
    scene: bpy.types.Scene, sky: bpy.types.World, was: float, own: float, *, everything: bool
) -> Iterator[None]:
    """Inside, the world is ``sky``, and the strength of the first state's, which the backdrop follows, is ``own`` in
    place of ``was``; a world that the artist has made or dimmed stays."""
    world, first = scene.world, scene[f"{SKY}0"]
    strength = sky_strength(first)
    if world != first or strength is None:
        yield
        return
    if not everything and _sky_is_changed(scene, was):
        yield
        return
    before = strength.default_value
    strength.default_value = 1.0 if sky == first else own
    scene.world = sky
    try:
        yield
    finally:
        scene.world = first
        strength.default_value = before
