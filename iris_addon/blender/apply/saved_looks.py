"""Looks of the artist's own: how the lights of a room are set, in shares of what was recovered, so that a look fits
another result and another room; and their files, the presets, of which only numbers and names are read.

A look is JSON::

    {"lamps": {"on": true, "strength": 0.5, "color": [1, 0.8, 0.6]},
     "named": [{"name": "IRIS Lamp 00", "on": false, "strength": 1}],
     "outside": 0.3, "overcast": false, "sun": {"on": true, "strength": 1}}

``lamps`` is what most lamps have, for those that ``named`` does not list; a name that the room lacks is skipped. A
color is linear, and stands there only where it is not the recovered one. In the scene, but not in files, are also the
"id" of a named lamp, for a result that gives its lamps other names, the "turn" of the sun, a quaternion, the light
"state", and the "radiance" (of the sun, irradiance) of what has no strength because nothing was recovered of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import bpy
import numpy as np
from mathutils import Quaternion
from numpy.typing import NDArray

from ...base.files import write_json
from ...base.untrusted import decoding, read_json
from ...edits import parsing
from ..scene_out.lights import (
    RECOVERED_TURN,
    LampSetting,
    is_plain,
    is_recovered_sun,
    lamp_materials,
    lamp_setting,
    set_lamp,
    set_sun,
)
from ..scene_out.materials import LAMP_ID, RECOVERED
from ..scene_out.world import is_gray, set_gray, sky_strength
from .applied_states import SAME_LIGHT, show_state, shown_state, state_names

SavedLook = dict[str, Any]
PRESET_BYTES = 1 << 20

# ---- of a scene ----------------------------------------------------------------------------------------------------


def look_of(scene: bpy.types.Scene) -> SavedLook:
    """How the lights of ``scene`` are set; lamps and worlds that the artist has rebuilt are not in it."""
    named = []
    for material in filter(is_plain, lamp_materials(scene.objects)):
        setting = _described(lamp_setting(material), material[RECOVERED])
        named.append({"name": material.name, "id": int(material[LAMP_ID]), **setting})
    look: SavedLook = {"named": named, "overcast": is_gray(scene.world), "state": shown_state(scene) or ""}
    common = _common([lamp for lamp in named if "strength" in lamp])
    if common is not None:
        look["lamps"] = common
    outside = sky_strength(scene.world)
    if outside is not None:
        look["outside"] = float(outside.default_value)
    for sun in filter(is_recovered_sun, scene.objects):
        shown = (not sun.hide_render, sun.data.energy, tuple(sun.data.color))
        look["sun"] = _described(shown, sun[RECOVERED])
        turn = sun.matrix_basis.to_quaternion()
        if abs(turn.dot(Quaternion(sun[RECOVERED_TURN]))) < 1 - SAME_LIGHT**2:
            look["sun"]["turn"] = list(turn)
    return look


def show_look(scene: bpy.types.Scene, look: Mapping[str, Any]) -> None:
    """Set the lights of ``scene`` as ``look`` has them; what the artist has rebuilt stays as it is."""
    for material in filter(is_plain, lamp_materials(scene.objects)):
        lamp = setting_of(look, material)
        if lamp is not None:
            set_lamp(material, light_setting(lamp, material[RECOVERED]))
    outside = sky_strength(scene.world)
    if outside is not None and "outside" in look:
        outside.default_value = look["outside"]
    set_gray(scene.world, look.get("overcast", False))
    for sun in filter(is_recovered_sun, scene.objects):
        _show_sun(sun, look)
    state = look.get("state")
    show_state(scene, state if state in state_names(scene) else None)


def setting_of(look: Mapping[str, Any], material: bpy.types.Material) -> Mapping[str, Any] | None:
    """What ``look`` says of the lamp of ``material``: by its name, else its id, else what most have; None without."""
    named = look.get("named", ())
    by_name = next((lamp for lamp in named if lamp["name"] == material.name), None)
    return by_name or next((lamp for lamp in named if lamp.get("id") == material[LAMP_ID]), look.get("lamps"))


def _show_sun(sun: bpy.types.Object, look: Mapping[str, Any]) -> None:
    """Set the sun; where the room of the look had none, it shines as the rest of the light from outside."""
    shown = look.get("sun")
    if shown is None:
        set_sun(sun, 0.0 if look.get("overcast") else look.get("outside", 1.0))
        return
    on, sun.data.energy, sun.data.color = light_setting(shown, sun[RECOVERED])
    sun.hide_render = sun.hide_viewport = not on
    sun.matrix_basis = Quaternion(shown.get("turn", sun[RECOVERED_TURN])).to_matrix().to_4x4()


def _described(setting: LampSetting, recovered: NDArray[np.float64]) -> dict[str, Any]:
    """A light in shares of the (3,) ``recovered``; absolute where that is black."""
    on, level, color = setting
    top, tint = _level_and_color(recovered)
    described: dict[str, Any] = {"on": bool(on)}
    described |= {"strength": level / top} if top else {"radiance": level}
    if not top or not np.allclose(color, tint, atol=SAME_LIGHT):
        described["color"] = list(color)
    return described


def light_setting(described: Mapping[str, Any], recovered: NDArray[np.float64]) -> LampSetting:
    """What :func:`_described` described, of a light of which (3,) ``recovered`` was recovered."""
    top, tint = _level_and_color(recovered)
    level = described["radiance"] if "radiance" in described else described["strength"] * top
    red, green, blue = described.get("color", tint)
    return described["on"], level, (red, green, blue)


def _level_and_color(radiance: NDArray[np.float64]) -> tuple[float, list[float]]:
    top = float(max(radiance))
    return top, [float(channel) / top for channel in radiance] if top else [1.0, 1.0, 1.0]


def _common(lamps: list[dict[str, Any]]) -> dict[str, Any] | None:
    """What other lamps get: on if any is, the middle strength of those that are, and the color that all have."""
    if not lamps:
        return None
    on = [lamp for lamp in lamps if lamp["on"]]
    like = on or lamps
    strengths = sorted(lamp["strength"] for lamp in like)
    common: dict[str, Any] = {"on": bool(on), "strength": strengths[len(strengths) // 2]}
    colors = [lamp["color"] for lamp in like if "color" in lamp]
    if len(colors) == len(like) and np.ptp(colors, axis=0).max() < SAME_LIGHT:
        common["color"] = colors[0]
    return common


# ---- presets -------------------------------------------------------------------------------------------------------


def preset_names(folder: Path) -> list[str]:
    """Names of the presets in ``folder``, by the alphabet; none where it is missing."""
    return sorted(unquote(path.stem) for path in folder.glob("[!.]*.json"))


def write_preset(folder: Path, name: str, look: SavedLook) -> None:
    """Write what other rooms can use of ``look``, in place of a preset of that name; raises IrisError."""
    kept = {key: look[key] for key in ("lamps", "outside", "overcast") if key in look}
    kept["named"] = [
        {key: value for key, value in lamp.items() if key != "id"} for lamp in look["named"] if "strength" in lamp
    ]
    if "strength" in look.get("sun", ()):
        kept["sun"] = {key: value for key, value in look["sun"].items() if key != "turn"}
    write_json(_preset(folder, name), kept)


def read_preset(folder: Path, name: str) -> SavedLook:
    """The look of a preset, which may come from a stranger; raises BadInput."""
    path = _preset(folder, name)
    mend = "remove the look, and save it again"
    content = read_json(path, PRESET_BYTES, mend)
    parsing.known_keys(content, {"lamps", "named", "outside", "overcast", "sun"}, path.name)
    with decoding(path, "is no look", mend):
        named = [
            {"name": str(lamp["name"]), **_read_light(lamp, "named")}
            for lamp in parsing.json_list(content.get("named", []), "named")
        ]
    read: dict[str, Callable[[Any, str], Any]] = {
        "lamps": _read_light,
        "sun": _read_light,
        "outside": parsing.number,
        "overcast": parsing.flag,
    }
    return {"named": named, **{key: value(content[key], key) for key, value in read.items() if key in content}}


def remove_preset(folder: Path, name: str) -> None:
    """Remove a preset, if there is one of that name."""
    _preset(folder, name).unlink(missing_ok=True)


def _preset(folder: Path, name: str) -> Path:
    return folder / f"{quote(name, safe=' ').replace('.', '%2E')}.json"


def _read_light(value: Any, where: str) -> dict[str, Any]:
    light = parsing.json_map(value, where)
    parsing.known_keys(light, {"name", "on", "strength", "color"}, where)
    read: dict[str, Any] = {
        "on": parsing.flag(light.get("on", True), f"{where}.on"),
        "strength": parsing.number(light.get("strength", 1.0), f"{where}.strength"),
    }
    if "color" in light:
        read["color"] = parsing.color(light["color"], f"{where}.color").tolist()
    return read
