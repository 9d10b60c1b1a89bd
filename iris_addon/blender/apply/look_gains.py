"""Pictures of looks out of light shares: how strong each recovered light is in a look, over what was recovered of it.

The shares are those of the room by its recovered light (:mod:`iris_addon.blender.insert.look_shares`). Light is linear,
so the picture of a look is their sum, each times its gain; nothing is rendered again.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import bpy
import numpy as np
from mathutils import Quaternion
from numpy.typing import NDArray

from ...edits.light_shares import mix_shares
from ..scene_out.lights import RECOVERED_TURN, LampSetting, is_plain, is_recovered_sun, lamp_materials
from ..scene_out.materials import LAMP_ID, RECOVERED
from .applied_states import SAME_LIGHT
from .looks import LOOKS, kept_look_of
from .saved_looks import light_setting, setting_of

OUTSIDE_SHARE, OVERCAST_SHARE, SUN_SHARE = "outside", "overcast", "sun"
"""Names of shares: the light from outside in its colors, the same without them, and the sun."""

Gains = dict[str, NDArray[np.float64]]
"""(3,) by the name of the share."""


def lamp_share(material: bpy.types.Material) -> str:
    """Name of the share of the lamp of ``material``: artists rename lamps."""
    return f"lamp {material[LAMP_ID]}"


def gains_of_look(scene: bpy.types.Scene, key: str) -> Gains:
    """The gains of a look of :data:`LOOKS`."""
    look = LOOKS[key]
    lamps = {
        lamp_share(material): np.full(3, float(look.lamps and any(material[RECOVERED])))
        for material in lamp_materials(scene.objects)
    }
    return lamps | _from_outside(scene, look.outside, overcast=look.overcast)


def gains_of_saved(scene: bpy.types.Scene, look: Mapping[str, Any]) -> Gains | None:
    """The gains of a look as :func:`iris_addon.blender.apply.saved_looks.show_look` sets it.

    None where no share shows it: it turns the sun, or lights what nothing was recovered of.
    """
    gains: Gains = {}
    for material in filter(is_plain, lamp_materials(scene.objects)):
        lamp = setting_of(look, material)
        setting = (True, 1.0, None) if lamp is None else light_setting(lamp, material[RECOVERED])
        if not _keep(gains, lamp_share(material), setting, material[RECOVERED]):
            return None
    gains |= _from_outside(scene, look.get("outside", 1.0), overcast=look.get("overcast", False))
    sun: Mapping[str, Any] = look.get("sun") or {}
    for thing in filter(is_recovered_sun, scene.objects) if sun else ():
        if "turn" in sun or not _keep(gains, SUN_SHARE, light_setting(sun, thing[RECOVERED]), thing[RECOVERED]):
            return None
    return gains


def gains_of_state(scene: bpy.types.Scene, look: Mapping[str, Any]) -> Gains | None:
    """The gains of the look of a light state, as :func:`iris_addon.blender.apply.looks.keep_states` keeps it; None
    where no share shows it: a light shines in it that is off in the first state."""
    gains: Gains = {}
    for material in lamp_materials(scene.objects):
        state = look["lamps"].get(str(material[LAMP_ID]))
        setting = (True, 1.0, None) if state is None else (bool(state[0]), state[1], tuple(state[2:]))
        if not _keep(gains, lamp_share(material), setting, material[RECOVERED]):
            return None
    gains |= _from_outside(scene, look.get("outside", 1.0), overcast=False)
    for thing in filter(is_recovered_sun, scene.objects) if "sun" in look else ():
        on, energy, red, green, blue, *turn = look["sun"]
        turned = abs(Quaternion(turn).dot(Quaternion(thing[RECOVERED_TURN]))) < 1 - SAME_LIGHT**2
        setting = bool(on), energy, (red, green, blue)
        if (on and turned) or not _keep(gains, SUN_SHARE, setting, thing[RECOVERED]):
            return None
    return gains


def gains_of_own(scene: bpy.types.Scene, name: str) -> Gains | None:
    """The gains of a look that ``scene`` keeps under ``name``; None where no share shows it, or there is none."""
    saved, state = kept_look_of(scene, name)
    if saved is not None:
        return gains_of_saved(scene, saved)
    return None if state is None else gains_of_state(scene, state)


def look_radiance(shares: Mapping[str, NDArray[np.floating]], gains: Gains | None) -> NDArray[np.float64] | None:
    """(H, W, 3) radiance in a look; None where ``shares`` lack a light that shines in it."""
    if gains is None or any(gain.any() for name, gain in gains.items() if name not in shares):
        return None
    shown = {name: shares[name] for name in gains if name in shares}
    return mix_shares(shown, gains) if shown else None


def _from_outside(scene: bpy.types.Scene, share: float, *, overcast: bool) -> Gains:
    """Gains of the sky and of the sun, where there are, at a ``share`` of both; of an ``overcast`` sky without sun."""
    gains: Gains = {}
    if scene.world is not None:
        gains[OVERCAST_SHARE if overcast else OUTSIDE_SHARE] = np.full(3, float(share))
    for thing in filter(is_recovered_sun, scene.objects):
        gains[SUN_SHARE] = np.full(3, 0.0 if overcast or not any(thing[RECOVERED]) else float(share))
    return gains


def _keep(
    gains: Gains,
    name: str,
    setting: LampSetting | tuple[bool, float, None],
    recovered: NDArray[np.floating],
) -> bool:
    """Put the gain of a light of a ``setting`` (without a colour: times what was recovered) into ``gains``; False
    where it shines in a channel of which nothing was recovered."""
    on, level, color = setting
    was = np.array(recovered, float)
    shown = (was * level if color is None else level * np.array(color)) * float(on)
    if ((was <= 0) & (shown > SAME_LIGHT)).any():
        return False
    gains[name] = np.divide(shown, was, out=np.zeros(3), where=was > 0)
    return True
